"""Scene -> SUMO network, and SUMO network -> RoadMap."""
