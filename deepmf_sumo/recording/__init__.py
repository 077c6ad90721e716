"""Recording of SUMO traffic as scenes to train on."""
