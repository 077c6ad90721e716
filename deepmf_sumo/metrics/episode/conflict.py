"""Time to collision of boxes that keep their velocities and headings."""

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry import angles


def time_to_collision(
    position_a: Floats,
    heading_a: Floats,
    velocity_a: Floats,
    size_a: Floats,
    position_b: Floats,
    heading_b: Floats,
    velocity_b: Floats,
    size_b: Floats,
) -> Floats:
    """(T) seconds until two boxes overlap at constant velocity; inf where they never do, 0 if now.

    Positions and velocities are (T, 2), headings (T), sizes (2). On each of the four box axes the
    projections overlap during one interval of time; the boxes overlap while all four do.
    """
    offset = np.asarray(position_b, float) - position_a
    relative = np.asarray(velocity_b, float) - velocity_a
    enter, leave = np.full(len(offset), -np.inf), np.full(len(offset), np.inf)
    for heading in (heading_a, heading_a + np.pi / 2, heading_b, heading_b + np.pi / 2):
        axis = angles.unit(heading)
        reach = _half(axis, heading_a, size_a) + _half(axis, heading_b, size_b)
        distance, speed = (offset * axis).sum(-1), (relative * axis).sum(-1)
        still = np.abs(speed) < 1e-9
        divisor = np.where(still, 1.0, speed)
        ends = np.sort([(-reach - distance) / divisor, (reach - distance) / divisor], axis=0)
        inside = np.where(np.abs(distance) < reach, -np.inf, np.inf)
        enter = np.maximum(enter, np.where(still, inside, ends[0]))
        leave = np.minimum(leave, np.where(still, np.inf, ends[1]))
    met = (enter < leave) & (leave > 0)
    seconds: Floats = np.where(met, np.maximum(enter, 0.0), np.inf)
    return seconds


def _half(axis: Floats, heading: Floats, size: Floats) -> Floats:
    """(T) half the extent of boxes on axes (T, 2)."""
    along = np.abs((axis * angles.unit(heading)).sum(-1))
    across = np.abs((axis * angles.unit(heading + np.pi / 2)).sum(-1))
    half: Floats = (size[0] * along + size[1] * across) / 2
    return half
