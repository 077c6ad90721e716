"""Assignment of candidates to lanes, step by step, and the lanes that lead on from there."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.candidates import Candidates
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import DT_S, Bools, Floats, Ints, Lane, RoadMap
from deepmf_sumo.scene.geometry import boxes, polylines
from deepmf_sumo.scene.geometry.ground import clear, ground_of, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road, reach_m

EVERY_STEPS: Final = 2
"""Futures are examined every 0.2 s."""
OFF: Final = -1
"""Row of a pose that is on none of the lanes."""
_SPACING_M = 4.0
_BEYOND_M = 300.0  # a lane that leaves the map is taken to go on straight for this length
_SAME_WAY = 0.5  # cosine: within 60 degrees of the lane


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneAssignment:
    """Futures (N) at S times on L lanes.

    Attributes:
        lanes: (L) reachable lanes. begins: (L) the vehicle is on the lane now.
        straight: (L) the lane is reached without a lane change.
        on: (N, S, L) the centre of the box is on the lane, in its direction.
        left_m: (N, S, L) offset to the left of the lane's centre line.
        nearest: (N, S) row of the assigned lane, the nearest one; or `OFF`.
        driven: (N, L) the future uses the lane; of lanes that branch off one lane only one.
    """

    lanes: tuple[Lane, ...]
    begins: Bools
    straight: Bools
    on: Bools
    left_m: Floats
    nearest: Ints
    driven: Bools

    @classmethod
    def of(
        cls,
        road: RoadMap,
        now: tuple[Floats, float],
        futures: tuple[Floats, Floats],
        ahead_m: float,
        z_m: float = 0.0,
    ) -> "LaneAssignment":
        """Assignment for a pose now, (2) and heading, and futures (N, S, 2), (N, S) from there.

        Lanes are searched for ``ahead_m``. Where roads cross, they start on the level that is
        nearest to the height ``z_m``.
        """
        first = lanes_at(road, *now, z_m)
        straight = _within(road, first, ahead_m, beside=False)
        lanes = tuple(road.lanes[name] for name in _within(road, first, ahead_m, beside=True))
        shape = (*futures[1].shape, len(lanes))
        on, left_m = np.zeros(shape, bool), np.full(shape, np.inf)
        for row, lane in enumerate(lanes):
            endless = _leaves(road, lane)
            near = np.ones(futures[1].shape, bool) if endless else _around(lane, futures[0])
            poses = futures[0][near], futures[1][near]
            on[near, row], left_m[near, row] = on_lane(road, lane, *poses, endless=endless)
        off = np.where(on, np.abs(left_m), np.inf)
        nearest = np.full(shape[:2], OFF)
        if lanes:
            nearest = np.where(on.any(axis=-1), off.argmin(axis=-1), OFF)
        return cls(
            lanes=lanes,
            begins=np.array([lane.id in first for lane in lanes], bool),
            straight=np.array([lane.id in straight for lane in lanes], bool),
            on=on,
            left_m=left_m,
            nearest=nearest,
            driven=_driven(lanes, nearest),
        )


def lanes_at(
    road: RoadMap, position_m: Floats, heading_rad: float, z_m: float = 0.0
) -> tuple[str, ...]:
    """Ids of the lanes for cars under a pose, (2) and heading, that run in its direction.

    Where roads cross, only those of the level nearest to the height ``z_m``.
    """
    lanes, point = coarse_lanes(road), np.asarray(position_m, float)[None]
    near = np.unique(lanes.lane[lanes.around(point[0], lanes.widest_m)])
    heading = np.array([heading_rad])
    found = [
        lane
        for lane in (lanes.lanes[row] for row in near)
        if lane.kind != "bike" and on_lane(road, lane, point, heading)[0][0]
    ]
    if len(found) > 1 and ground_of(road).has_levels:
        heights = np.array([_height_m(lane, point) for lane in found])
        level = on_nearest_level(np.zeros(len(found), np.int64), heights, np.array(z_m))
        found = [lane for lane, same in zip(found, level, strict=True) if same]
    return tuple(lane.id for lane in found)


@per_road
def coarse_lanes(road: RoadMap) -> LaneMap:
    """All lanes along lines with few points: recorded ones have one every half metre."""
    lanes = tuple(road.lanes.values())
    lines = [_coarse(lane.centre_m) for lane in lanes]
    return LaneMap.of(lanes, lines, [np.zeros(len(line)) for line in lines])


def _coarse(line_m: Floats) -> Floats:
    """The line with a point every 4 m, if these are fewer."""
    if polylines.arc_lengths(line_m)[-1] > _SPACING_M * (len(line_m) - 2):
        return line_m
    return polylines.resample(line_m, _SPACING_M)


def _height_m(lane: Lane, point_m: Floats) -> float:
    """Height of a lane at its foot of a point (1, 2)."""
    along = polylines.project(lane.centre_m, point_m).along_m[0]
    return float(np.interp(along, polylines.arc_lengths(lane.centre_m), lane.z_m))


def on_lane(
    road: RoadMap, lane: Lane, position_m: Floats, heading_rad: Floats, *, endless: bool = False
) -> tuple[Bools, Floats]:
    """(...) whether poses are on a lane and in its direction, and their offsets to its left.

    An ``endless`` lane goes on straight beyond its last point.
    """
    lanes = coarse_lanes(road)
    line = lanes.line_m[lanes.row[lane.id]]
    if len(line) < 2:
        return np.zeros(np.shape(heading_rad), bool), np.full(np.shape(heading_rad), np.inf)
    if endless:
        last = line[-1] - line[-2]
        line = np.concatenate([line, [line[-1] + _BEYOND_M * last / max(np.hypot(*last), 1e-9)]])
    foot = polylines.project(line, position_m)
    near = foot.distance_m <= reach_m(lane)
    on: Bools = near & (np.cos(heading_rad - foot.heading_rad) > _SAME_WAY)
    return on, foot.left_m


def _leaves(road: RoadMap, lane: Lane) -> bool:
    """Whether a lane leads out of the map: it ends, and so do the lanes beside it."""
    beside = [one.lane_id for one in (*lane.left, *lane.right)]
    return not lane.next and not any(road.lanes[one].next for one in beside if one in road.lanes)


def _around(lane: Lane, point_m: Floats) -> Bools:
    """(...) whether points (..., 2) can be on a lane, by its bounding box."""
    low, high = lane.centre_m.min(axis=0) - reach_m(lane), lane.centre_m.max(axis=0) + reach_m(lane)
    return np.asarray(((point_m >= low) & (point_m <= high)).all(axis=-1))


def _within(road: RoadMap, first: Iterable[str], ahead_m: float, *, beside: bool) -> list[str]:
    """Lanes ahead within a distance from the start of the first ones; also those beside."""
    lanes = coarse_lanes(road)

    def length_m(name: str) -> float:
        line = lanes.line_m[lanes.row[name]]
        return float(np.hypot(*np.diff(line, axis=0).T).sum()) if len(line) > 1 else 0.0

    left_m = {name: ahead_m + length_m(name) for name in first}
    queue = list(left_m)
    while queue:
        lane = road.lanes[queue.pop(0)]
        rest = left_m[lane.id] - length_m(lane.id)
        after = [(name, rest) for name in lane.next]
        if beside:
            after += [(one.lane_id, left_m[lane.id]) for one in (*lane.left, *lane.right)]
        for name, more in after:
            if name in road.lanes and more > left_m.get(name, 0.0):
                left_m[name] = more
                queue.append(name)
    return [name for name in left_m if road.lanes[name].kind != "bike"]


def _driven(lanes: tuple[Lane, ...], nearest: Ints) -> Bools:
    """(N, L) see `LaneAssignment`: where lanes branch off, the one with the most poses."""
    count = (nearest[..., None] == np.arange(len(lanes))).sum(axis=1)
    row = {lane.id: index for index, lane in enumerate(lanes)}
    driven: Bools = count > 0
    for lane in lanes:
        branches = [row[name] for name in lane.next if name in row]
        if len(branches) > 1:
            driven[:, branches] &= count[:, branches] == count[:, branches].max(
                axis=1, keepdims=True
            )
    return driven


PACE_S = DT_S * EVERY_STEPS
_AHEAD_M = 20.0  # lanes are searched this far beyond what is driven
_LIKELY = 0.1  # the rules hold towards futures of the AV with at least this probability


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneFutures:
    """N futures of an opponent at S times, every 0.2 s, up to the end of the case.

    Attributes:
        position_m: (N, S, 2). heading_rad, speed_mps: (N, S). size_m: (2) length, width.
        start: its pose now. assignment: of the futures to lanes.
        av_position_m: (K, R, 2), av_heading_rad: (K, R), R >= S: likely futures of the unattacked
            AV. av_size_m: (2).
        z_m, av_z_m: (N, S), (K, R) heights; z_now_m: the opponent's now. Zeros on one level.
    """

    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    size_m: Floats
    start: Start
    assignment: LaneAssignment
    av_position_m: Floats
    av_heading_rad: Floats
    av_size_m: Floats
    z_m: Floats
    av_z_m: Floats
    z_now_m: float

    @classmethod
    def of(cls, situation: Situation, own: Candidates) -> "LaneFutures":
        """The futures of N candidates; the situation needs the unattacked AV."""
        view, start, alone = situation.view, situation.start, situation.unattacked
        futures, levels = own.forecast.futures, situation.levels
        assert alone is not None
        left = max(view.steps_left, EVERY_STEPS)  # at least one time, even in the case's last step
        steps = slice(EVERY_STEPS - 1, min(left, own.speed_mps.shape[1]), EVERY_STEPS)
        position, heading = futures.position_m[:, steps], futures.heading_rad[:, steps]
        along = np.hypot(*np.moveaxis(position - start.position_m, -1, 0))
        ahead_m = float(along.max(initial=0.0)) + _AHEAD_M
        now = start.position_m, start.heading_rad
        likely = alone.probability >= min(_LIKELY, float(alone.probability.max()))
        every = slice(EVERY_STEPS - 1, None, EVERY_STEPS)
        av_m = alone.futures.position_m[likely]
        z_m, av_z_m, z_now_m = np.zeros(heading.shape), np.zeros(av_m[:, every].shape[:2]), 0.0
        if levels is not None:
            z_m = levels.opponent_z_m(futures.position_m)[:, steps]
            av_z_m, z_now_m = levels.av_z_m(av_m)[:, every], float(levels.opponent[2])
        return cls(
            position_m=position,
            heading_rad=heading,
            speed_mps=own.speed_mps[:, steps],
            size_m=situation.size_m,
            start=start,
            assignment=LaneAssignment.of(view.road, now, (position, heading), ahead_m, z_now_m),
            av_position_m=av_m[:, every],
            av_heading_rad=alone.futures.heading_rad[likely, every],
            av_size_m=situation.av_size_m,
            z_m=z_m,
            av_z_m=av_z_m,
            z_now_m=z_now_m,
        )

    def meets(self, later_s: float) -> Bools:
        """(N, S, K) the AV is at the opponent's pose ``later_s`` later; negative: earlier."""
        times = np.arange(self.position_m.shape[1]) + round(later_s / PACE_S)
        row = np.clip(times, 0, self.av_position_m.shape[1] - 1)
        hit = boxes.overlap(
            self.position_m[:, :, None],
            self.heading_rad[:, :, None],
            self.size_m,
            np.swapaxes(self.av_position_m[:, row], 0, 1)[None],
            self.av_heading_rad[:, row].T[None],
            self.av_size_m,
        )
        hit &= ~clear(self.z_m[:, :, None], self.av_z_m[:, row].T[None])
        return hit & (times == row)[None, :, None]

    def av_comes(self, within_s: float) -> Bools:
        """(N, S, K) the AV is at the opponent's pose then, or at most ``within_s`` later."""
        later = np.append(np.arange(0.0, within_s, 2 * PACE_S), within_s)
        return np.any([self.meets(float(one)) for one in later], axis=0)
