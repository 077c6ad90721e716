"""Which lane follows which, inferred from their ends."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Lane
from deepmf_sumo.geometry import angles

END_GAP_M: Final = 0.3
HEIGHT_GAP_M: Final = 1.5
TURN_RAD: Final = 0.8
DIRECTION_OVER_M: Final = 1.0
"""Length over which a lane's direction at its end is taken: single segments can be noise."""


def connections(lanes: Sequence[Lane]) -> list[tuple[str, str]]:
    """Pairs (lane, lane that follows), in the order of ``lanes``.

    A lane follows another where it starts at most 0.3 m from the other's end, at most 1.5 m higher
    or lower, in a direction that differs by less than 0.8 rad; bike lanes follow bike lanes only.
    A lane with a single point has no direction and takes any.
    """
    usable = [lane for lane in lanes if len(lane.centre_m)]
    if not usable:
        return []
    start = np.array([lane.centre_m[0] for lane in usable])
    end = np.array([lane.centre_m[-1] for lane in usable])
    rise = np.array([lane.z_m[0] for lane in usable]) - np.array(
        [[lane.z_m[-1]] for lane in usable]
    )
    away = start[None] - end[:, None]
    heading_in = np.array([_heading(lane.centre_m, at_end=True) for lane in usable])
    heading_out = np.array([_heading(lane.centre_m, at_end=False) for lane in usable])
    turn = angles.difference(heading_out[None], heading_in[:, None])
    bike = np.array([lane.kind == "bike" for lane in usable])
    follows = (
        (np.hypot(away[..., 0], away[..., 1]) <= END_GAP_M)
        & (np.abs(rise) <= HEIGHT_GAP_M)
        & ~(np.abs(turn) >= TURN_RAD)
        & (bike[:, None] == bike[None])
        & ~np.eye(len(usable), dtype=bool)
    )
    return [(usable[row].id, usable[column].id) for row, column in np.argwhere(follows)]


def _heading(points_m: Floats, *, at_end: bool) -> float:
    """Direction over the last (or first) metre; NaN where all points are one."""
    points = points_m[::-1] if at_end else points_m
    distance = np.hypot(*(points - points[0]).T)
    far = np.flatnonzero(distance >= DIRECTION_OVER_M)
    other = int(far[0]) if len(far) else int(distance.argmax())
    if distance[other] < 1e-3:
        return float("nan")
    step = points[0] - points[other] if at_end else points[other] - points[0]
    return float(np.arctan2(step[1], step[0]))
