"""Changes to a SUMO network that could make it safer, e.g. a longer yellow, and the network built.

`document` reads the file of changes, `signals` changes signal programs, `building` writes the
configurations with and without the changes, and the patch for netconvert and netedit.
"""
