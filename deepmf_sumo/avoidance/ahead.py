"""Where the AV was going to drive after a step: the recorded way, its lane, or straight on."""

import numpy as np

from deepmf_sumo.datatypes import Case, Floats, Lane, RoadMap, Rollout
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.geometry.ground import ground_of, on_nearest_level

_REACH_M = 150.0
_BESIDE_M = 2.0
_TURNED_RAD = np.pi / 6


def way_ahead(rollout: Rollout, case: Case, step: int) -> Floats:
    """(P, 2) points ahead of the AV's pose at a step; none where it can only go straight on.

    The path that the recorded AV took, if the AV is within 2 m and 30 degrees of it; else the
    centre line of the lane that it is on by the same measure, and of those that follow with the
    least turn.
    """
    row = rollout.tracks.row(rollout.av_id)
    position, heading = rollout.tracks.position_m[row, step], rollout.tracks.heading_rad[row, step]
    scene = case.scene
    if scene is not None:
        recorded = scene.tracks.row(scene.av_id)
        there = scene.tracks.valid[recorded]
        way = _rest(scene.tracks.position_m[recorded, there], position, float(heading))
        if way is not None:
            return way
    return _along_lanes(case.road, position, float(heading), float(rollout.tracks.z_m[row, step]))


def _rest(line_m: Floats, position_m: Floats, heading_rad: float) -> Floats | None:
    """The part of a line (P, 2) ahead of a pose on it; None where the pose is not on it."""
    if len(line_m) < 2 or polylines.arc_lengths(line_m)[-1] < 1.0:
        return None
    line = polylines.resample(line_m, 1.0)
    foot = polylines.project(line, position_m)
    turn = abs(float(angles.difference(foot.heading_rad, heading_rad)))
    if foot.distance_m > _BESIDE_M or turn > _TURNED_RAD:
        return None
    return line[polylines.arc_lengths(line) > foot.along_m]


def _along_lanes(road: RoadMap, position_m: Floats, heading_rad: float, z_m: float) -> Floats:
    """The rest of the nearest lane that leads on, and lanes after it until they are 150 m long.

    Where roads cross the nearest lane of those on the level nearest to the height ``z_m``.
    """
    found: list[tuple[float, Lane, Floats]] = []
    heights: list[float] = []
    for lane in road.lanes.values():
        rest = None if lane.kind == "bike" else _near(lane, position_m, heading_rad)
        if rest is None:
            continue
        foot = polylines.project(lane.centre_m, position_m)
        found.append((float(foot.distance_m), lane, rest))
        length = polylines.arc_lengths(lane.centre_m)
        heights.append(float(np.interp(foot.along_m, length, lane.z_m)))
    if not found:
        return np.empty((0, 2))
    if ground_of(road).has_levels:
        one = np.zeros(len(found), np.int64)
        level = on_nearest_level(one, np.array(heights), np.array(z_m))
        found = [each for each, same in zip(found, level, strict=True) if same]
    _, lane, way = min(found, key=lambda each: each[0])
    seen = {lane.id}
    while polylines.arc_lengths(way)[-1] < _REACH_M:
        following = [road.lanes[name] for name in lane.next if name in road.lanes]
        following = [after for after in following if after.id not in seen and _drawn(after)]
        if not following:
            break
        lane = min(following, key=lambda after: abs(_turn(after)))
        seen.add(lane.id)
        way = np.concatenate([way, polylines.resample(lane.centre_m, 1.0)])
    return way


def _near(lane: Lane, position_m: Floats, heading_rad: float) -> Floats | None:
    """As `_rest`, for lanes whose bounds are near the position."""
    if not _drawn(lane):
        return None
    low, high = lane.centre_m.min(axis=0) - _BESIDE_M, lane.centre_m.max(axis=0) + _BESIDE_M
    inside = bool(((position_m >= low) & (position_m <= high)).all())
    return _rest(lane.centre_m, position_m, heading_rad) if inside else None


def _drawn(lane: Lane) -> bool:
    return len(lane.centre_m) > 1 and lane.kind != "bike"


def _turn(lane: Lane) -> float:
    """Radians between a lane's first and last direction."""
    first, last = lane.centre_m[1] - lane.centre_m[0], lane.centre_m[-1] - lane.centre_m[-2]
    return float(angles.difference(np.arctan2(*last[::-1]), np.arctan2(*first[::-1])))
