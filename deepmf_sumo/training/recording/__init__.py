"""Recording of SUMO traffic: scenes to train on, and its conflicts."""
