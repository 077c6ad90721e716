"""Heights: which of two vehicles passes above the other, and how high the road is at a position.

A vehicle's z is that of the ground under it. It does not say how high the vehicle reaches, so two
vehicles meet if their heights differ by less than `CLEARANCE_M`, whatever they are: roads that
cross leave each other more room than that.
"""

from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, Lane, RoadMap
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.scene.geometry.lane_map import per_road, reach_m

CLEARANCE_M: Final = 2.5
"""Vehicles whose heights differ by at least this pass over each other."""
_CELL_M: Final = 4.0
_SPACING_M: Final = 2.8
"""Of points on lanes: every cell of a lane has one."""
_APART_M: Final = CLEARANCE_M / 2
"""Lanes in one cell whose heights differ by more are two levels; others are one surface."""
_MOST_STEPS: Final = 64
_ROW: Final = 1 << 32
"""Cells of a column are numbered one after the other."""


def clear(z_m: Floats | float, other_m: Floats | float) -> Bools:
    """(...) whether vehicles at these two heights pass above or below each other."""
    return np.asarray(np.abs(np.asarray(z_m, float) - other_m) >= CLEARANCE_M)


def on_level(road: RoadMap, z_m: Floats | float, other_m: Floats | float) -> Bools:
    """(...) whether two heights are of one level of a road; all are if it never passes over itself.

    Heights of recordings may count from elsewhere than those of their maps: where there is one
    level they are not compared.
    """
    level: Bools = ~clear(np.asarray(z_m, float), np.asarray(other_m, float))
    return level | (not ground_of(road).has_levels)


def on_nearest_level(group: Ints, heights_m: Floats, z_m: Floats) -> Bools:
    """(K) which heights of roads are of that level of their group which is nearest to a height.

    ``group`` (K): rows with the same number belong together, e.g. all lanes under one vehicle,
    whose height is ``z_m`` (K). Nearest, not near: heights of recordings may have another origin.
    """
    heights, away = np.asarray(heights_m, float), np.abs(np.asarray(heights_m, float) - z_m)
    order = np.lexsort((away, group))
    _, first, member = np.unique(group[order], return_index=True, return_inverse=True)
    nearest = np.empty(len(heights))
    nearest[order] = heights[order][first][member]
    return ~clear(heights, nearest)


def distance_m(gap_m: Floats, z_m: Floats, other_m: Floats) -> Floats:
    """(...) distance of vehicles with a gap in the plane, in metres; 0 if they meet.

    A difference in height counts as far as it exceeds the clearance.
    """
    above = np.maximum(np.abs(np.asarray(z_m, float) - other_m) - CLEARANCE_M, 0.0)
    return np.where(clear(z_m, other_m), np.hypot(gap_m, above), gap_m)


@per_road
def ground_of(road: RoadMap) -> "Ground":
    """The ground of a road."""
    return Ground(road)


def off_level(
    road: RoadMap, position_m: Floats, z_m: float, others_m: Floats, others_z_m: Floats
) -> Bools:
    """(N) which of others (N, 2), (N) are on a level that no straight drive from a pose reaches.

    True for a vehicle on the bridge ahead, False for one farther up on the same slope. False for
    all where the road passes nowhere over itself.
    """
    ground, others = ground_of(road), np.asarray(others_m, float)
    start = np.broadcast_to(np.asarray(position_m, float), others.shape)
    return ground.apart(start, np.full(len(others), float(z_m)), others, others_z_m)


class Ground:
    """The surface of all lanes of a road, in cells of 4 m; several where roads cross.

    Attributes:
        has_levels: whether the road passes over itself anywhere with room for a vehicle.
    """

    def __init__(self, road: RoadMap) -> None:
        lanes = [lane for lane in road.lanes.values() if len(lane.centre_m) > 1]
        heights = np.concatenate([np.zeros(0), *(lane.z_m for lane in lanes)])
        self._flat = not len(heights) or float(np.ptp(heights)) == 0.0
        self.has_levels = False
        if not self._flat:
            self._fill(np.concatenate([_surface(lane) for lane in lanes]))

    def follow(self, paths_m: Floats, z_m: Floats) -> Floats:
        """(N, P) heights along paths (N, P, 2) that start at heights (N).

        Vehicles climb and descend with the road below them. They keep their height off the road,
        and where the road below is out of reach.
        """
        points = np.asarray(paths_m, float)
        found = np.repeat(np.asarray(z_m, float)[:, None], points.shape[1], axis=1)
        if self._flat:
            return found
        surface = self._surfaces(points)
        for at in range(1, points.shape[1]):
            here = _nearest(surface[:, at - 1], found[:, at - 1])
            climb = _nearest(surface[:, at], here) - here
            follows = np.abs(climb) < CLEARANCE_M  # False where there is no road
            found[:, at] = found[:, at - 1] + np.where(follows, climb, 0.0)
        return found

    def arrived(self, start_m: Floats, z_m: Floats, end_m: Floats) -> Floats:
        """(N) heights at ends (N, 2) of straight paths from starts (N, 2) at heights (N)."""
        start, way = np.asarray(start_m, float), np.asarray(end_m, float) - start_m
        farthest = float(np.hypot(way[:, 0], way[:, 1]).max(initial=0.0))
        steps = int(np.clip(np.ceil(farthest / _CELL_M), 1, _MOST_STEPS))
        share = np.linspace(0.0, 1.0, steps + 1)[:, None]
        return self.follow(start[:, None] + share * way[:, None], z_m)[:, -1]

    def apart(self, start_m: Floats, z_m: Floats, end_m: Floats, end_z_m: Floats) -> Bools:
        """(N) which ends (N, 2), (N) lie on a level that no straight drive from the start reaches.

        None where the road passes nowhere over itself.
        """
        if not self.has_levels:
            return np.zeros(len(end_m), bool)
        return clear(self.arrived(start_m, z_m, end_m), end_z_m)

    def _fill(self, samples: Floats) -> None:
        """Fill the cells from points and slopes of the surface (S, 5)."""
        key = _cells(samples[:, :2])
        order = np.lexsort((samples[:, 2], key))
        key, samples = key[order], samples[order]
        new_cell = np.diff(key, prepend=key[0] - 1) != 0
        new = new_cell | (np.diff(samples[:, 2], prepend=0.0) > _APART_M)
        begin = np.flatnonzero(new)
        count = np.diff(np.append(begin, len(samples)))
        self._level = np.add.reduceat(samples, begin) / count[:, None]
        self._key, self._first = np.unique(key[begin], return_index=True)
        self._count = np.diff(np.append(self._first, len(begin)))
        highest = self._level[self._first + self._count - 1, 2]
        self.has_levels = bool((highest - self._level[self._first, 2] >= CLEARANCE_M).any())

    def _surfaces(self, points: Floats) -> Floats:
        """(..., L) heights of the road's levels at points (..., 2); nan fills up to L levels."""
        key = _cells(points)
        cell = np.minimum(np.searchsorted(self._key, key), len(self._key) - 1)
        each = np.arange(int(self._count.max()))
        known = (self._key[cell] == key)[..., None] & (each < self._count[cell][..., None])
        level = self._level[np.where(known, self._first[cell][..., None] + each, 0)]
        offset = points[..., None, :] - level[..., :2]
        return np.where(known, level[..., 2] + (offset * level[..., 3:]).sum(-1), np.nan)


def _surface(lane: Lane) -> Floats:
    """(S, 5) x, y, z of points on a lane, 2.8 m apart at most, and its slope along x and y."""
    length = polylines.arc_lengths(lane.centre_m)
    along = np.linspace(0.0, length[-1], 2 + int(length[-1] / _SPACING_M))
    line = np.stack(
        [np.interp(along, length, part) for part in (*lane.centre_m.T, lane.z_m)], axis=1
    )
    step = np.diff(line, axis=0, append=2 * line[-1:] - line[-2:-1])
    run = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)[:, None]
    course = step[:, :2] / run
    half = reach_m(lane)
    asides = np.linspace(-half, half, 2 + int(2 * half / _SPACING_M))
    normal = np.stack([-course[:, 1], course[:, 0]], axis=-1)
    points = line[:, None, :2] + asides[:, None] * normal[:, None]
    rest = np.concatenate([line[:, 2:], step[:, 2:] / run * course], axis=1)
    spread = np.broadcast_to(rest[:, None], (*points.shape[:2], 3))
    return np.concatenate([points, spread], axis=-1).reshape(-1, 5)


def _cells(points: Floats) -> Ints:
    column, row = np.moveaxis(np.floor(points / _CELL_M).astype(np.int64), -1, 0)
    return column * _ROW + row


def _nearest(surface: Floats, z_m: Floats) -> Floats:
    """(N) the height of surfaces (N, L) that is nearest to (N); nan without a surface."""
    away = np.abs(surface - z_m[:, None])
    best = np.where(np.isnan(away), np.inf, away).argmin(axis=1)
    return surface[np.arange(len(surface)), best]
