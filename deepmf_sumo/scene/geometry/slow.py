"""Speeds below which a vehicle counts as standing, or as having no direction of motion.

Other thresholds in the package mean something else: what a network was trained with
(`deepmf.networks`), one component of a motion (`judge.avoidability.reference_drivers`), a rolling
stop at a sign (`deepmf.traffic_rules`), the slip angle between heading and motion (`feasible`,
`tracking`), and the definitions of published metrics (`wrong_way_share`).
"""

from typing import Final

STANDING_MPS: Final = 0.1
"""Slower stands, where the fault depends on it. As in SUMO; recorded speeds are not quite 0."""
WAITING_MPS: Final = 0.5
"""Slower waits, where traffic goes around it or on without it: vehicles that wait creep."""
STOOD_MPS: Final = 1.0
"""Slower stands for others, which have to stop for it."""
WALKING_MPS: Final = 1.4
"""Slower creeps: an AV can be walked past."""
DIRECTION_MPS: Final = 0.5
"""Slower, the difference of two positions gives no direction."""

__all__ = ["DIRECTION_MPS", "STANDING_MPS", "STOOD_MPS", "WAITING_MPS", "WALKING_MPS"]
