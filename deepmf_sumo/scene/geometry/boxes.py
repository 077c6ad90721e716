"""Oriented boxes: corners, overlap by the separating-axis theorem, gaps. All broadcast.

A box is (centre (..., 2), heading (...), size (..., 2): length, width).
"""

import numpy as np

from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.scene.geometry import frames

_SIGNS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])


def corners(centre_m: Floats, heading_rad: Floats, size_m: Floats) -> Floats:
    """(..., 4, 2) corners, counter-clockwise from front left."""
    heading = np.asarray(heading_rad, float)[..., None]
    local = _SIGNS * np.asarray(size_m, float)[..., None, :]
    cos, sin = np.cos(heading), np.sin(heading)
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y], axis=-1) + np.asarray(centre_m, float)[..., None, :]


def overlap(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Bools:
    """(...) whether two boxes share interior points (touching is not overlap).

    Separating-axis test on the four box axes, by closed forms of the projections, which need no
    arrays of shape (4, 2).
    """
    offset = np.asarray(centre_b, float) - centre_a
    heading_a, heading_b = np.asarray(heading_a, float), np.asarray(heading_b, float)
    half_a, half_b = np.asarray(size_a, float) / 2, np.asarray(size_b, float) / 2
    cos_a, sin_a = np.cos(heading_a), np.sin(heading_a)
    cos_b, sin_b = np.cos(heading_b), np.sin(heading_b)
    turn_cos = np.abs(cos_a * cos_b + sin_a * sin_b)
    turn_sin = np.abs(sin_a * cos_b - cos_a * sin_b)
    x, y = offset[..., 0], offset[..., 1]
    la, wa, lb, wb = half_a[..., 0], half_a[..., 1], half_b[..., 0], half_b[..., 1]
    return (
        (np.abs(x * cos_a + y * sin_a) < la + lb * turn_cos + wb * turn_sin)
        & (np.abs(y * cos_a - x * sin_a) < wa + lb * turn_sin + wb * turn_cos)
        & (np.abs(x * cos_b + y * sin_b) < lb + la * turn_cos + wa * turn_sin)
        & (np.abs(y * cos_b - x * sin_b) < wb + la * turn_sin + wa * turn_cos)
    )


def touching(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Bools:
    """(...) as `overlap` for centres (..., 2) and headings (...), which broadcast.

    Sizes are (2). Only pairs whose centres are nearer than the half diagonals reach are tested.
    """
    offset = centre_b - centre_a
    reach = (np.hypot(*size_a) + np.hypot(*size_b)) / 2
    hit: Bools = np.asarray((offset**2).sum(-1) < reach**2)
    near = np.nonzero(hit)
    pairs = hit.shape
    hit[near] = overlap(
        np.broadcast_to(centre_a, offset.shape)[near],
        np.broadcast_to(heading_a, pairs)[near],
        size_a,
        np.broadcast_to(centre_b, offset.shape)[near],
        np.broadcast_to(heading_b, pairs)[near],
        size_b,
    )
    return hit


def gap(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Floats:
    """(...) distance between two boxes in metres; 0 where they touch or overlap."""
    hit = overlap(centre_a, heading_a, size_a, centre_b, heading_b, size_b)
    corners_a = corners(centre_a, heading_a, size_a)
    corners_b = corners(centre_b, heading_b, size_b)
    distance = np.minimum(
        _points_to_box(corners_a, centre_b, heading_b, size_b),
        _points_to_box(corners_b, centre_a, heading_a, size_a),
    )
    return np.where(hit, 0.0, distance)


def end_to_end(
    centre_a: Floats,
    heading_a: float,
    size_a: Floats,
    centre_b: Floats,
    heading_b: float,
    size_b: Floats,
) -> bool:
    """Whether b lies farther from a along a's axis than across it: before or behind, not beside."""
    x, y = np.abs(frames.to_local(np.asarray(centre_b), np.asarray(centre_a), heading_a))
    turn = heading_b - heading_a
    cos, sin = abs(np.cos(turn)), abs(np.sin(turn))
    length, width = size_b
    along = x - (size_a[0] + length * cos + width * sin) / 2
    across = y - (size_a[1] + length * sin + width * cos) / 2
    return bool(along >= across)


def _points_to_box(points: Floats, centre: Floats, heading: Floats, size: Floats) -> Floats:
    """(...) least distance of points (..., P, 2) to a box."""
    offset = points - np.asarray(centre, float)[..., None, :]
    heading = np.asarray(heading, float)[..., None]
    cos, sin = np.cos(heading), np.sin(heading)
    half = np.asarray(size, float)[..., None, :] / 2
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin) - half[..., 0]
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin) - half[..., 1]
    return np.hypot(np.maximum(along, 0), np.maximum(across, 0)).min(axis=-1)
