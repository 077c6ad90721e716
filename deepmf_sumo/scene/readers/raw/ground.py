"""Heights of tracks and lanes that have none.

Where roads lie above each other, the nearest lane may be the wrong one: a vehicle below a bridge
would jump onto it for a few steps. Of the levels near a track the one is taken that leads the way
it drives and that it comes from.
"""

import itertools
from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.scene import Bools, Floats, Lane, RoadMap
from deepmf_sumo.scene.readers.raw.motion import FARTHEST_M

_POINTS_M: Final = 1.0
"""Distance of points on lanes."""
_MOST_POINTS: Final = 1_000_000
"""On lanes of more than 1000 km, which no recording has, they are farther apart."""
_REACH_M: Final = 5.0
"""Lanes farther away count only where there is none within this."""
_LEVEL_M: Final = 2.5
"""Two roads can lie above each other with this distance; a lorry is higher."""
_ACROSS_M: Final = 3.0
"""A lane across the way of a road user counts as this much farther away than a lane along it."""
_CLIMB: Final = 0.3
"""Rise per metre that no road exceeds."""
_JUMP: Final = 2.0
"""Metres of distance that one metre of another height costs."""


def ground_m(road: RoadMap, position_m: Floats, heading_rad: Floats, valid: Bools) -> Floats:
    """(A, T) heights of the road below agents at (A, T, 2); 0 where they are not valid."""
    ground = np.zeros(valid.shape)
    points, height, direction = _points(road)
    known = valid & np.isfinite(position_m).all(-1)
    if not len(points) or not known.any():
        return ground
    states = np.asarray(shapely.points(position_m[known]))
    tree = shapely.STRtree(np.asarray(shapely.points(points)))
    ground[known] = height[tree.nearest(states)]
    state, point = tree.query(states, predicate="dwithin", distance=_REACH_M)
    cost = np.linalg.norm(points[point] - position_m[known][state], axis=1)
    cost += _ACROSS_M * np.abs(np.sin(direction[point] - heading_rad[known][state]))
    levels = _levels(state, height[point], cost, len(states))
    number = np.full(valid.shape, -1)
    number[known] = np.arange(len(states))
    for row in np.flatnonzero(known.any(axis=1)):
        steps = np.flatnonzero(known[row])
        its = [levels[one] for one in number[row, steps]]
        if any(len(one) > 1 for one in its):
            far = [np.array([[z, 0.0]]) for z in ground[row, steps]]
            its = [one if len(one) else other for one, other in zip(its, far, strict=True)]
            ground[row, steps] = _way(its, position_m[row, steps])
    return ground


def lanes_with_heights(road: RoadMap, unknown: Collection[str]) -> dict[str, Lane]:
    """Lanes whose heights are not all finite: with that of the nearest point of any lane.

    0 where no lane has a height.
    """
    points, height, _ = _points(road)
    tree = shapely.STRtree(np.asarray(shapely.points(points)))
    filled = {}
    for name in unknown:
        lane = road.lanes[name]
        bare = ~np.isfinite(lane.z_m) & np.isfinite(lane.centre_m).all(-1)
        z_m = np.where(np.isfinite(lane.z_m), lane.z_m, 0.0)
        if len(points) and bare.any():
            z_m[bare] = height[tree.nearest(shapely.points(lane.centre_m[bare]))]
        filled[name] = replace(lane, z_m=z_m)
    return filled


def _points(road: RoadMap) -> tuple[Floats, Floats, Floats]:
    """Points (N, 2) along all lanes, their heights (N), and directions (N) in rad."""
    found = [np.zeros((0, 4))]
    known = []
    for lane in road.lanes.values():
        # false for NaN; lanes farther away are refused
        good = (np.abs(lane.centre_m) < FARTHEST_M).all(-1) & np.isfinite(lane.z_m)
        known.append(np.column_stack([lane.centre_m, lane.z_m])[good])
    metres = sum(float(np.linalg.norm(np.diff(xyz[:, :2], axis=0), axis=1).sum()) for xyz in known)
    apart_m = max(_POINTS_M, metres / _MOST_POINTS)
    for xyz in known:
        if len(xyz) < 2:  # of one point no direction is known
            found.append(np.column_stack([xyz, np.zeros(len(xyz))]))
            continue
        step = np.diff(xyz[:, :2], axis=0)
        along = np.concatenate([[0.0], np.linalg.norm(step, axis=1).cumsum()])
        at = np.linspace(0.0, along[-1], max(2, int(np.ceil(along[-1] / apart_m)) + 1))
        segment = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(step) - 1)
        columns = [np.interp(at, along, xyz[:, axis]) for axis in range(3)]
        found.append(np.column_stack([*columns, np.arctan2(*step[segment].T[::-1])]))
    points = np.concatenate(found)
    return points[:, :2], points[:, 2], points[:, 3]


def _levels(state: Floats, height: Floats, cost: Floats, count: int) -> list[Floats]:
    """Of each of ``count`` states, (L, 2) heights and costs of the levels of road near it."""
    order = np.lexsort([height, state])
    state, height, cost = state[order], height[order], cost[order]
    begins = (np.diff(state, prepend=-1) > 0) | (np.diff(height, prepend=-np.inf) > _LEVEL_M)
    level = begins.cumsum() - 1
    best = np.lexsort([cost, level])
    best = best[np.unique(level[best], return_index=True)[1]]
    parts = np.searchsorted(state[best], np.arange(count + 1))
    each = np.column_stack([height[best], cost[best]])
    return [each[first:last] for first, last in itertools.pairwise(parts)]


def _way(levels: list[Floats], position_m: Floats) -> Floats:
    """(T) heights of the sequence of levels that costs least (Viterbi)."""
    total, back = levels[0][:, 1], []
    moved = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    for (before, now), metres in zip(itertools.pairwise(levels), moved, strict=True):
        rise = np.abs(before[:, None, 0] - now[None, :, 0])
        through = total[:, None] + _JUMP * np.maximum(rise - _CLIMB * metres, 0.0)
        back.append(through.argmin(axis=0))
        total = through.min(axis=0) + now[:, 1]
    place = int(total.argmin())
    heights = [levels[-1][place, 0]]
    for step, came in zip(levels[-2::-1], back[::-1], strict=True):
        place = int(came[place])
        heights.append(step[place, 0])
    return np.array(heights[::-1])
