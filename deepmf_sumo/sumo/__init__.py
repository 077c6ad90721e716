"""Everything that touches SUMO: networks built and read, configurations, and the episode.

SUMO has its own frame (front bumper, degrees from north), its own words for what went wrong, and
one simulation a process. All of that stays behind this room: what leaves it are the types of
`deepmf_sumo.scene`.
"""
