"""Where a car may swerve to beside the AV's path, and who keeps to a lane."""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.avoidance.path import Path
from deepmf_sumo.datatypes import Bools, Floats, RoadMap
from deepmf_sumo.geometry import angles

WIDTH_M: Final = 3.7
"""Width of a lane whose source says nothing."""
MARGIN_M: Final = 0.5
"""A point is on the road half a lane's width and so much from a centre line."""
BORDER_M: Final = 0.2
"""A car that is so far over its lane's border still keeps to the lane."""
_SPACING_M = 1.0
_BLOCK = 44  # points tested together: four cross-sections of the path's surroundings
_ALONG_M = 4.0
_ASIDE_M = 1.0
_FARTHEST_M = 5.0
_ALIGNED_RAD = np.pi / 4


class _Centres(NamedTuple):
    """Points on centre lines of lanes for cars: (P, 2), directions (P), half widths (P)."""

    points_m: Floats
    course_rad: Floats
    half_m: Floats


def _centres(road: RoadMap, points_m: Floats) -> _Centres:
    """Points every metre on those parts of all centre lines that may be near points (N, 2)."""
    lanes = [lane for lane in road.lanes.values() if lane.kind != "bike" and len(lane.centre_m) > 1]
    if not lanes:
        return _Centres(np.empty((0, 2)), np.empty(0), np.empty(0))
    line = np.concatenate([lane.centre_m for lane in lanes])
    lane_of = np.repeat(np.arange(len(lanes)), [len(lane.centre_m) for lane in lanes])
    half = np.array([(lane.width_m or WIDTH_M) / 2 for lane in lanes])
    start, end = line[:-1], line[1:]
    reach = half.max() + WIDTH_M
    low, high = points_m.min(axis=0) - reach, points_m.max(axis=0) + reach
    near = ((np.maximum(start, end) >= low) & (np.minimum(start, end) <= high)).all(axis=1)
    near &= lane_of[:-1] == lane_of[1:]
    start, delta, lane_of = start[near], (end - start)[near], lane_of[:-1][near]
    count = np.maximum(np.ceil(np.hypot(*delta.T) / _SPACING_M), 1).astype(int)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - (np.cumsum(count) - count)[segment]) / count[segment]
    return _Centres(
        points_m=start[segment] + share[:, None] * delta[segment],
        course_rad=np.arctan2(delta[:, 1], delta[:, 0])[segment],
        half_m=half[lane_of[segment]],
    )


def on_road(road: RoadMap, points_m: Floats) -> Bools:
    """(N) whether points (N, 2) are within half a lane's width and 0.5 m of a centre line."""
    centres = _centres(road, points_m)
    limit = np.hypot(centres.half_m + MARGIN_M, _SPACING_M / 2)
    reach = limit.max(initial=0.0)
    inside = [
        _within(block, centres.points_m, limit, reach)
        for block in np.array_split(points_m, max(1, len(points_m) // _BLOCK))
    ]
    return np.concatenate(inside)


def _within(points_m: Floats, centres_m: Floats, limit_m: Floats, reach_m: float) -> Bools:
    """(N) whether one of the centres (P, 2) is within its limit (P), at most ``reach_m``."""
    low, high = points_m.min(axis=0) - reach_m, points_m.max(axis=0) + reach_m
    near = ((centres_m >= low) & (centres_m <= high)).all(axis=1)
    x = points_m[:, :1] - centres_m[near, 0]
    y = points_m[:, 1:] - centres_m[near, 1]
    return np.asarray((x * x + y * y <= limit_m[near] ** 2).any(axis=1))


def stays_on_road(
    road: RoadMap, path: Path, along_m: Floats, left_m: Floats, half_width_m: float
) -> Bools:
    """(M) whether the outer side of a car at (M, K) along and left of the path keeps to the road.

    Where the path itself is off all lanes (a car park, a driveway) the map does not know the road,
    and nothing is said against leaving it.
    """
    ways = np.arange(along_m.min(), along_m.max() + _ALONG_M, _ALONG_M)
    asides = np.arange(-_FARTHEST_M, _FARTHEST_M + _ASIDE_M / 2, _ASIDE_M)
    centre, heading = path.at(ways)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    grid = centre[:, None] + asides[:, None] * normal[:, None]
    known = on_road(road, grid.reshape(-1, 2)).reshape(len(ways), len(asides))
    middle = len(asides) // 2
    allowed = known | ~known[:, middle : middle + 1]
    outer = left_m + np.sign(left_m) * half_width_m
    row = np.clip(np.rint((along_m - ways[0]) / _ALONG_M).astype(int), 0, len(ways) - 1)
    column = np.rint((outer + _FARTHEST_M) / _ASIDE_M).astype(int).clip(0, len(asides) - 1)
    swerved = np.abs(left_m) > _ASIDE_M / 2
    return np.asarray((allowed[row, column] | ~swerved).all(axis=1))


def keeps_lane(road: RoadMap, position_m: Floats, heading_rad: float, width_m: float) -> bool:
    """Whether a car drives within one lane of its direction, 0.2 m over the border at most."""
    centre, course, half = _centres(road, position_m[None])
    aligned = np.abs(angles.difference(course, heading_rad)) < _ALIGNED_RAD
    near = aligned & (np.hypot(*(position_m - centre).T) < WIDTH_M)
    left = ((position_m - centre)[near] * angles.unit(course[near] + np.pi / 2)).sum(-1)
    return bool((np.abs(left) + width_m / 2 <= half[near] + BORDER_M).any())
