"""The AV's path: as driven, its route ahead, and the road beside it."""

from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from deepmf_sumo.scene import (
    Bools,
    Case,
    Floats,
    Ints,
    Lane,
    RecordedCase,
    RoadMap,
    Rollout,
    frozen,
)
from deepmf_sumo.scene.geometry import frames, polylines, road
from deepmf_sumo.scene.geometry.ground import ground_of, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import MARGIN_M

BEHIND_M: Final = 100.0
AHEAD_M: Final = 400.0
"""A path is extended straight by these lengths behind its first and past its last point."""
BORDER_M: Final = 0.2
"""A car that crosses its lane's border by at most this distance keeps its lane."""
_STEP_M = 1e-3
_FIRST_M = 3.0
_TURN_RAD = 0.1  # 6 cm of sagitta on a curve of 50 m
_REACH_M = 150.0
_BESIDE_M = 2.0
_CHORD_M = 0.5
"""Farthest that a line of points a metre apart is from the line that they are on."""
_TURNED_RAD = np.pi / 6
_ALONG_M = 4.0
_ASIDE_M = 1.0
_FARTHEST_M = 5.0
_ALIGNED_RAD = np.pi / 4


class VehicleState(NamedTuple):
    """Position (2) of the box centre, heading and speed of a vehicle at one step."""

    position_m: Floats
    heading_rad: float
    speed_mps: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AvPath:
    """P poses by arc length, which is 0 at the first given pose.

    Attributes:
        along_m: (P). position_m: (P, 2). heading_rad: (P) of the box, without jumps of 2 pi.
    """

    along_m: Floats
    position_m: Floats
    heading_rad: Floats

    @classmethod
    def through(cls, position_m: Floats, heading_rad: Floats, ahead_m: Floats) -> Self:
        """A path through poses (K, 2), (K), K >= 1, then points (Q, 2), then straight on."""
        position = np.asarray(position_m, float)
        keep = np.concatenate([[0], 1 + _moving(position)])
        position, heading = position[keep], np.asarray(heading_rad, float)[keep]
        ahead = _in_front(np.asarray(ahead_m, float).reshape(-1, 2), position[-1], heading[-1])
        joined = np.concatenate([position[-1:], ahead])
        ahead = joined[np.concatenate([[0], 1 + _moving(joined)])]
        courses = np.arctan2(*np.diff(ahead, axis=0).T[::-1])
        headings = np.concatenate([heading, courses])
        whole = np.concatenate([position, ahead[1:]])
        first, last = frames.unit(headings[0]), frames.unit(headings[-1])
        whole = np.concatenate([whole[:1] - BEHIND_M * first, whole, whole[-1:] + AHEAD_M * last])
        headings = np.unwrap(np.concatenate([headings[:1], headings, headings[-1:]]))
        along = polylines.arc_lengths(whole) - BEHIND_M
        return cls(along_m=frozen(along), position_m=frozen(whole), heading_rad=frozen(headings))

    def at(self, along_m: Floats) -> tuple[Floats, Floats]:
        """Centres (..., 2) and headings (...) of the box at arc lengths (...)."""
        x = np.interp(along_m, self.along_m, self.position_m[:, 0])
        y = np.interp(along_m, self.along_m, self.position_m[:, 1])
        heading = np.interp(along_m, self.along_m, self.heading_rad)
        return np.stack([x, y], axis=-1), heading

    def project(self, points_m: Floats) -> polylines.Projection:
        """Feet of points (..., 2) on the path, simplified to centimetres."""
        turned = np.abs(np.diff(self.heading_rad)).cumsum() / _TURN_RAD
        keep = np.flatnonzero(np.diff(np.floor(turned)) > 0) + 1
        last = len(self.along_m) - 1
        ends = np.unique(np.concatenate([[0, 1], keep, [last - 1, last]]))
        foot = polylines.project(self.position_m[ends], points_m)
        scale = polylines.arc_lengths(self.position_m[ends])
        return foot._replace(along_m=np.interp(foot.along_m, scale, self.along_m[ends]))


def _in_front(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points from the first one that a car at the origin can reach without turning on the spot."""
    if len(points_m) == 0:
        return points_m
    ahead = frames.to_local(points_m, origin_m, heading_rad)[:, 0] >= _FIRST_M
    return points_m[int(ahead.argmax()) :] if ahead.any() else points_m[:0]


def _moving(position_m: Floats) -> Ints:
    """Indices of the steps of a path (K, 2) in which it moves."""
    return np.flatnonzero(np.hypot(*np.diff(position_m, axis=0).T) > _STEP_M)


def route_ahead(rollout: Rollout, case: Case, step: int) -> Floats:
    """(P, 2) points ahead of the AV's pose at a step; empty if no route is known.

    These are on the path of the recorded AV, if the AV is within 2 m and 30 degrees of it; else on
    the centre line of the lane that the AV is on by the same measure, and of the following lanes
    with the least turn.
    """
    row = rollout.tracks.row(rollout.av_id)
    position, heading = rollout.tracks.position_m[row, step], rollout.tracks.heading_rad[row, step]
    if isinstance(case, RecordedCase):
        recorded = case.scene.tracks
        av = recorded.row(case.scene.av_id)
        path = _rest(recorded.position_m[av, recorded.valid[av]], position, float(heading))
        if path is not None:
            return path
    return along_lanes(case.road, position, float(heading), float(rollout.tracks.z_m[row, step]))


def _rest(line_m: Floats, position_m: Floats, heading_rad: float) -> Floats | None:
    """The part of a line (P, 2) ahead of a pose; None if the pose is not on the line."""
    if len(line_m) < 2 or polylines.arc_lengths(line_m)[-1] < 1.0:
        return None
    line = polylines.resample(line_m, 1.0)
    foot = polylines.project(line, position_m)
    turn = abs(float(frames.difference(foot.heading_rad, heading_rad)))
    if foot.distance_m > _BESIDE_M or turn > _TURNED_RAD:
        return None
    return line[polylines.arc_lengths(line) > foot.along_m]


def along_lanes(road_map: RoadMap, position_m: Floats, heading_rad: float, z_m: float) -> Floats:
    """The rest of the nearest lane, and the lanes after it, until the route is 150 m long.

    Where roads cross at different heights, the nearest lane of the level nearest to ``z_m``.
    """
    lanes = road.lanes_for_cars(road_map)
    found: list[tuple[float, Lane, Floats]] = []
    heights: list[float] = []
    for row in np.unique(lanes.lane[lanes.around(position_m, _BESIDE_M + _CHORD_M)]):
        lane = lanes.lanes[row]
        rest = _rest(lane.centre_m, position_m, heading_rad)
        if rest is None:
            continue
        foot = polylines.project(lane.centre_m, position_m)
        found.append((float(foot.distance_m), lane, rest))
        length = polylines.arc_lengths(lane.centre_m)
        heights.append(float(np.interp(foot.along_m, length, lane.z_m)))
    if not found:
        return np.empty((0, 2))
    if ground_of(road_map).has_levels:
        one = np.zeros(len(found), np.int64)
        level = on_nearest_level(one, np.array(heights), np.array(z_m))
        found = [each for each, same in zip(found, level, strict=True) if same]
    _, lane, path = min(found, key=lambda each: each[0])
    seen = {lane.id}
    while polylines.arc_lengths(path)[-1] < _REACH_M:
        following = [
            lanes.lanes[lanes.row[name]]
            for name in lane.next
            if name in lanes.row and name not in seen
        ]
        if not following:
            break
        lane = min(following, key=lambda after: abs(_turn(after)))
        seen.add(lane.id)
        path = np.concatenate([path, polylines.resample(lane.centre_m, 1.0)])
    return path


def _turn(lane: Lane) -> float:
    """Radians between a lane's first and last direction."""
    first, last = lane.centre_m[1] - lane.centre_m[0], lane.centre_m[-1] - lane.centre_m[-2]
    return float(frames.difference(np.arctan2(*last[::-1]), np.arctan2(*first[::-1])))


def stays_on_road(
    road_map: RoadMap,
    path: AvPath,
    along_m: Floats,
    left_m: Floats,
    half_width_m: float,
    z_m: float = 0.0,
) -> Bools:
    """(M) whether the outer side of a car at (M, K) along and left of the path stays on the road.

    Where the path itself is off all lanes (a car park, a driveway), the map does not contain the
    road, and leaving it is allowed. ``z_m`` is the height of the car at the least of ``along_m``;
    roads above or below its path do not count.
    """
    stations = np.arange(along_m.min(), along_m.max() + _ALONG_M, _ALONG_M)
    asides = np.arange(-_FARTHEST_M, _FARTHEST_M + _ASIDE_M / 2, _ASIDE_M)
    centre, heading = path.at(stations)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    grid = centre[:, None] + asides[:, None] * normal[:, None]
    heights = ground_of(road_map).follow(centre[None], np.array([z_m]))[0].repeat(len(asides))
    known = road.on_road(road_map, grid.reshape(-1, 2), heights).reshape(len(stations), len(asides))
    middle = len(asides) // 2
    allowed = known | ~known[:, middle : middle + 1]
    outer = left_m + np.sign(left_m) * half_width_m
    row = np.clip(np.rint((along_m - stations[0]) / _ALONG_M).astype(int), 0, len(stations) - 1)
    column = np.rint((outer + _FARTHEST_M) / _ASIDE_M).astype(int).clip(0, len(asides) - 1)
    swerved = np.abs(left_m) > _ASIDE_M / 2
    return np.asarray((allowed[row, column] | ~swerved).all(axis=1))


def keeps_lane(
    road_map: RoadMap, position_m: Floats, heading_rad: float, width_m: float, z_m: float = 0.0
) -> bool:
    """Whether a car is within a lane of its direction, or crosses its border by at most 0.2 m."""
    under = road.covering(road_map, position_m[None], np.array([z_m]))
    aligned = np.abs(frames.difference(under.heading_rad, heading_rad)) < _ALIGNED_RAD
    normal = frames.unit(under.heading_rad + np.pi / 2)
    left = np.abs(((position_m - under.start_m) * normal).sum(-1))
    within = left + width_m / 2 <= under.reach_m - MARGIN_M + BORDER_M
    return bool((aligned & within).any())
