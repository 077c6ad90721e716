"""How attacks in the traffic of SUMO are judged, now and before."""
