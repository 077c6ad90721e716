"""Which lanes cross each other on one level."""

from typing import Final

import numpy as np
import shapely

from deepmf_sumo.datatypes import Floats

OVERPASS_M: Final = 2.5
"""Lanes farther apart in height are a road and its overpass."""
END_M: Final = 0.5
"""Lanes that meet nearer to an end join there; they do not cross."""
PARALLEL_SINE: Final = 0.09
"""Centre lines that meet at less than 5 degrees diverge or merge; they do not cross."""


def crossings(shapes: dict[str, Floats]) -> list[tuple[str, str]]:
    """Pairs of lanes (P, 3) whose centre lines cross away from their ends, each once, in order."""
    names = [lane_id for lane_id, xyz in shapes.items() if len(xyz) > 1]
    if len(names) < 2:
        return []
    start = np.concatenate([shapes[name][:-1] for name in names])
    delta = np.concatenate([np.diff(shapes[name], axis=0) for name in names])
    owner = np.repeat(np.arange(len(names)), [len(shapes[name]) - 1 for name in names])
    before, after = _distances_to_ends(delta, owner)
    ends = np.stack([start[:, :2], start[:, :2] + delta[:, :2]], axis=1)
    lines = np.asarray(shapely.linestrings(ends))
    one, two = shapely.STRtree(lines).query(lines)
    later = owner[one] < owner[two]
    one, two = one[later], two[later]
    share_one, share_two, sine = _intersections(start, delta, one, two)
    hit = (sine > PARALLEL_SINE) & _inside(share_one) & _inside(share_two)
    for segment, share in ((one, share_one), (two, share_two)):
        length = np.hypot(delta[segment, 0], delta[segment, 1])
        hit &= before[segment] + share * length > END_M
        hit &= after[segment] + (1 - share) * length > END_M
    height_one = start[one, 2] + share_one * delta[one, 2]
    height_two = start[two, 2] + share_two * delta[two, 2]
    hit &= np.abs(height_one - height_two) <= OVERPASS_M
    pairs = np.unique(np.stack([owner[one[hit]], owner[two[hit]]], axis=1), axis=0)
    return [(names[first], names[second]) for first, second in pairs]


def _distances_to_ends(delta: Floats, owner: np.ndarray) -> tuple[Floats, Floats]:
    """(S) lane length before the segment's start, and after its end."""
    length = np.hypot(delta[:, 0], delta[:, 1])
    total = np.bincount(owner, length)
    offset = np.concatenate([[0.0], np.cumsum(total)])[owner]
    before = np.cumsum(length) - length - offset
    return before, total[owner] - before - length


def _intersections(
    start: Floats, delta: Floats, one: np.ndarray, two: np.ndarray
) -> tuple[Floats, Floats, Floats]:
    """Shares along two segments at which their lines meet, and the sine of their angle."""
    a, b = delta[one, :2], delta[two, :2]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    sine = np.abs(cross) / np.maximum(np.hypot(*a.T) * np.hypot(*b.T), 1e-12)
    safe = np.where(np.abs(cross) < 1e-12, 1.0, cross)
    gap = start[two, :2] - start[one, :2]
    share_one = (gap[:, 0] * b[:, 1] - gap[:, 1] * b[:, 0]) / safe
    share_two = (gap[:, 0] * a[:, 1] - gap[:, 1] * a[:, 0]) / safe
    return share_one, share_two, sine


def _inside(share: Floats) -> np.ndarray:
    return (share >= 0.0) & (share <= 1.0)
