"""Accelerations and steering from poses.

Over 0.2 s, so that noise of a centimetre stays below 1 m/s2.
"""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats
from deepmf_sumo.geometry import angles
from deepmf_sumo.geometry.slow import DIRECTION_MPS

SPAN = 2
"""Steps on each side of a second difference."""


class Accelerations(NamedTuple):
    """(K) accelerations along and across the direction of motion, in m/s2."""

    along: Floats
    across: Floats


def accelerations(position_m: Floats, heading_rad: Floats, dt_s: float) -> Accelerations:
    """Second differences of box centres (T, 2); K = T - 4, empty for fewer than 5 poses.

    The direction is that of the motion, below 0.5 m/s the heading.
    """
    position = np.asarray(position_m, float)
    if len(position) <= 2 * SPAN:
        return Accelerations(np.empty(0), np.empty(0))
    span = SPAN * dt_s
    before, here, after = position[: -2 * SPAN], position[SPAN:-SPAN], position[2 * SPAN :]
    second = (after - 2 * here + before) / span**2
    velocity = (after - before) / (2 * span)
    course = np.where(
        np.hypot(*velocity.T) > DIRECTION_MPS,
        np.arctan2(velocity[:, 1], velocity[:, 0]),
        np.asarray(heading_rad, float)[SPAN:-SPAN],
    )
    ahead = angles.unit(course)
    along = (second * ahead).sum(-1)
    across = ahead[:, 0] * second[:, 1] - ahead[:, 1] * second[:, 0]
    return Accelerations(along, across)


class Steering(NamedTuple):
    """(K) motion of boxes over 0.4 s; ``sideways`` is the sine of heading to motion, unsigned."""

    speed_mps: Floats
    way_m: Floats
    turn_rad: Floats
    sideways: Floats


def steering(position_m: Floats, heading_rad: Floats, dt_s: float) -> Steering:
    """Of box centres (T, 2) and headings (T); K = T - 4, empty for fewer than 5 poses."""
    position, heading = np.asarray(position_m, float), np.asarray(heading_rad, float)
    if len(position) <= 2 * SPAN:
        return Steering(*(np.empty(0) for _ in Steering._fields))
    moved = position[2 * SPAN :] - position[: -2 * SPAN]
    way = np.hypot(*moved.T)
    course = np.arctan2(moved[:, 1], moved[:, 0])
    return Steering(
        speed_mps=way / (2 * SPAN * dt_s),
        way_m=way,
        turn_rad=np.abs(angles.difference(heading[2 * SPAN :], heading[: -2 * SPAN])),
        sideways=np.abs(np.sin(course - heading[SPAN:-SPAN])),
    )


def runs(mask: Bools) -> list[slice]:
    """Uninterrupted stretches of a mask (T)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]
