"""Classes of road users: what a recorded or simulated box is.

Recordings and SUMO agree on four kinds; a finer class follows from the size, which is all that both
know of a vehicle. One table, so that a van is not a car in one file and a truck in another.
"""

from typing import Final, Literal

from deepmf_sumo.scene._arrays import Floats
from deepmf_sumo.scene.scene import AgentKind

RoadUserClass = Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "other"]
"""``truck``: buses, too, which have the same sizes. ``other``: trams, trains, animals, objects."""

LONGEST_CAR_M: Final = 6.5
"""SUMO's delivery vans have this length; its smallest trucks are 7.1 m long."""
_LONGEST_MOTORCYCLE_M: Final = 3.0
_WIDEST_MOTORCYCLE_M: Final = 1.2
"""SUMO's motorcycles are 2.2 m by 0.9 m; the narrowest cars on sale are 1.2 m to 1.3 m wide."""

_BY_KIND: Final[dict[AgentKind, RoadUserClass]] = {
    "cyclist": "bicycle",
    "pedestrian": "pedestrian",
    "other": "other",
}


def class_of(kind: AgentKind, size_m: Floats) -> RoadUserClass:
    """The class of an agent of a kind, with its size (length, width, ...)."""
    if kind != "vehicle":
        return _BY_KIND[kind]
    length, width = float(size_m[0]), float(size_m[1])
    if length > LONGEST_CAR_M:
        return "truck"
    narrow = length < _LONGEST_MOTORCYCLE_M and width < _WIDEST_MOTORCYCLE_M
    return "motorcycle" if narrow else "car"
