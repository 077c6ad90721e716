"""Where on a box another one touches it: the middle of their overlap, and its sector of eight.

A box is (centre (..., 2), heading (...), size (..., 2): length, width); all arguments broadcast.
"""

from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints
from deepmf_sumo.scene.geometry import boxes

SECTORS: Final = (
    "front",
    "front_left",
    "left",
    "rear_left",
    "rear",
    "rear_right",
    "right",
    "front_right",
)
"""Names of the eight sectors of 45 degrees, counter-clockwise."""

_WITHIN = 1e-9  # a corner this little outside (relative) still belongs to the overlap


def sectors(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Ints:
    """(...) sector of box a, 0..7, in which the middle of its overlap with box b lies.

    0 is the front, 2 the left. Of boxes that do not overlap it is the sector of b's centre.
    """
    x, y = np.moveaxis(
        overlap_middle(centre_a, heading_a, size_a, centre_b, heading_b, size_b), -1, 0
    )
    return np.round(np.arctan2(y, x) / (np.pi / 4)).astype(np.int64) % 8


def delta_v(relative_mps: Floats, area_m2: float, other_m2: float) -> Floats:
    """Change of velocity in m/s of a road user of an area that another hits, and sticks to.

    Masses are taken to be as areas: results name no mass.
    """
    change: Floats = relative_mps * other_m2 / (area_m2 + other_m2)
    return change


def overlap_middle(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Floats:
    """(..., 2) centroid of the overlap in the frame of box a; b's centre where there is none."""
    heading_a = np.asarray(heading_a, float)
    half_a = np.asarray(size_a, float)[..., None, :] / 2
    half_b = np.asarray(size_b, float)[..., None, :] / 2
    offset = _turned(np.asarray(centre_b, float) - centre_a, -heading_a)
    turn = np.asarray(heading_b, float) - heading_a
    own = boxes.corners(np.zeros(2), np.zeros(()), size_a)
    other = boxes.corners(offset, turn, size_b)
    shape = np.broadcast_shapes(own.shape, other.shape)
    own, other = np.broadcast_to(own, shape), np.broadcast_to(other, shape)
    own_in_b = _turned(own - offset[..., None, :], -turn[..., None])
    inside = np.concatenate([_within(own_in_b, half_b), _within(other, half_a)], axis=-1)
    crossing, crosses = _crossings(own, other)
    points = np.concatenate([own, other, crossing], axis=-2)
    valid = np.concatenate([inside, crosses], axis=-1)
    return _centroid(points, valid, np.broadcast_to(offset, (*shape[:-2], 2)))


def _turned(vectors: Floats, angle_rad: Floats) -> Floats:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def _within(points: Floats, half: Floats) -> Bools:
    """(..., 4) whether points lie in a box that is centred and aligned."""
    return np.all(np.abs(points) <= half * (1 + _WITHIN), axis=-1)


def _crossings(a: Floats, b: Floats) -> tuple[Floats, Bools]:
    """(..., 16, 2) points where edges of two quadrangles (..., 4, 2) cross, (..., 16) whether."""
    start, other = a[..., :, None, :], b[..., None, :, :]
    along = (np.roll(a, -1, axis=-2) - a)[..., :, None, :]
    across = (np.roll(b, -1, axis=-2) - b)[..., None, :, :]
    area = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    parallel = np.abs(area) < 1e-12
    area = np.where(parallel, 1.0, area)
    apart = other - start
    share = (apart[..., 0] * across[..., 1] - apart[..., 1] * across[..., 0]) / area
    other_share = (apart[..., 0] * along[..., 1] - apart[..., 1] * along[..., 0]) / area
    hits: Bools = ~parallel & (share >= 0) & (share <= 1) & (other_share >= 0) & (other_share <= 1)
    points = start + share[..., None] * along
    return points.reshape(*points.shape[:-3], 16, 2), hits.reshape(*hits.shape[:-2], 16)


def _centroid(points: Floats, valid: Bools, otherwise: Floats) -> Floats:
    """(..., 2) centroids of the convex polygons of the valid points, in any order."""
    # A point that is none of the polygon's repeats one that is: it adds no area.
    first = np.take_along_axis(points, valid.argmax(axis=-1)[..., None, None], axis=-2)
    points = np.where(valid[..., None], points, first)
    middle = points.mean(axis=-2, keepdims=True)
    local = points - middle
    order = np.argsort(np.arctan2(local[..., 1], local[..., 0]), axis=-1)
    local = np.take_along_axis(local, order[..., None], axis=-2)
    ahead = np.roll(local, -1, axis=-2)
    area = local[..., 0] * ahead[..., 1] - local[..., 1] * ahead[..., 0]
    total = area.sum(axis=-1)
    weighted = ((local + ahead) * area[..., None]).sum(axis=-2)
    usable: Bools = np.logical_and(np.any(valid, axis=-1), total >= 1e-12)
    centroid = middle[..., 0, :] + weighted / np.where(usable, 3 * total, 1.0)[..., None]
    return np.where(usable[..., None], centroid, otherwise)
