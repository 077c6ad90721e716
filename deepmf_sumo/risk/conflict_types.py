"""Attacks in the words of a conflict study: what kind of conflict each was.

The kinds are those of traffic conflict studies (Parker and Zegeer, FHWA-IP-88-027, 1989; Gettman et
al., FHWA-HRT-08-051, 2008). A kind is told from the movements of the two vehicles where these are
known, else from how they stood to each other.
"""

from collections.abc import Mapping
from math import pi
from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry import frames
from deepmf_sumo.risk.places import Movement, Places, Spot

ConflictType = Literal[
    "rear-end", "crossing", "left turn across path", "merging", "sideswipe or lane change",
    "head-on",
]  # fmt: skip
TYPES: Final[tuple[ConflictType, ...]] = get_args(ConflictType)
DEFINITIONS: Final[Mapping[ConflictType, str]] = {
    "rear-end": "in one direction, one behind the other",
    "crossing": "ways that cross, from two sides (right angle)",
    "left turn across path": "a left turn before an oncoming vehicle that does not turn left",
    "merging": "ways from two edges onto one",
    "sideswipe or lane change": "in one direction, one beside the other",
    "head-on": "in opposite directions on one way",
}
_ALONG_RAD: Final = pi / 4
_ONCOMING_RAD: Final = 3 * pi / 4

Pose = tuple[Floats, float, Floats]
"""Centre (2), heading, and size (2): length, width."""


def conflict_type(
    places: Places, spots: tuple[Spot, Spot], poses: tuple[Pose, Pose]
) -> ConflictType:
    """The kind of a conflict of two vehicles, from their spots and poses, the AV's first."""
    av, opponent = (places.movements.get(spot.movement) for spot in spots)
    return _by_movements(places, av, opponent) or _by_poses(*poses)


def _by_movements(
    places: Places, av: Movement | None, opponent: Movement | None
) -> ConflictType | None:
    """What two movements over one junction make of it; None from one edge, or of one unknown."""
    if av is None or opponent is None or av.junction != opponent.junction:
        return None
    if av.origin == opponent.origin:
        return None
    if av.target == opponent.target:
        return "merging"
    opposite = (
        _turn(places.heading_rad(av.origin), places.heading_rad(opponent.origin)) > _ONCOMING_RAD
    )
    across = "right" if places.net.left_hand else "left"
    turns = {av.turn, opponent.turn}
    if opposite and across in turns:
        return "left turn across path" if len(turns) > 1 else "crossing"
    return None if opposite else "crossing"


def _turn(one_rad: float, other_rad: float) -> float:
    return abs(float(frames.difference(one_rad, other_rad)))


def _by_poses(av: Pose, opponent: Pose) -> ConflictType:
    """By the angle between them; in one direction, by whether one is behind or beside the other."""
    (av_m, av_rad, av_size), (other_m, other_rad, other_size) = av, opponent
    turn = _turn(other_rad, av_rad)
    if turn > _ONCOMING_RAD:
        return "head-on"
    if turn > _ALONG_RAD:
        return "crossing"
    x, y = np.abs(frames.to_local(other_m, av_m, av_rad))
    cos, sin = abs(np.cos(turn)), abs(np.sin(turn))
    length, width = other_size
    along = x - (av_size[0] + length * cos + width * sin) / 2
    across = y - (av_size[1] + length * sin + width * cos) / 2
    return "rear-end" if along >= across else "sideswipe or lane change"
