"""The motion of a vehicle that neither a plan, nor the log, nor SUMO can drive from where it is.

It turns onto the nearest lane of its direction and follows it, as gently as a person would, to a
stop or at a low speed. Without a lane it stops straight ahead.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.scene import DT_S, Floats, Lane, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.scene.geometry.lane_map import LaneMap
from deepmf_sumo.scene.geometry.road import lanes_for_cars
from deepmf_sumo.sumo.simulation.frame import Pose

_BRAKES_MPS2: Final = 3.0
_BRAKES_FOR_OTHERS_MPS2: Final = 6.0
_STARTS_MPS2: Final = 1.5
_REACH_M: Final = 30.0
"""A lane farther off is not looked for."""
_LARGEST_TURN_RAD: Final = np.radians(100.0)
_TURN_COSTS_M: Final = 5.0
"""A radian of turning costs as much as this many metres."""
_LINE_M: Final = 300.0
_MOST_LANES: Final = 40
_STEEPEST_RAD: Final = 0.5
"""Largest angle to the lane on the way to its middle."""
_SHARPEST_PER_M: Final = 0.18
"""Curvature of a car's narrowest turn."""
_ASIDE_MPS2: Final = 3.0
"""Largest lateral acceleration."""
_SETTLES_S: Final = 1.0
_SETTLES_M: Final = 3.0
"""The offset from the middle of the lane falls to a third within this time, or this way."""
_LOOKS_S: Final = 1.0
_LOOKS_M: Final = 2.0

Cost = Callable[[str], float | None]
"""Of a lane by id: see `ownership.NextOwner.lane_cost`."""


class WayOn:
    """Poses of a vehicle that is left to itself.

    Args:
        road: the lanes.
        pose: where it is. z_m: its height there.
        creep_mps: speed at which it goes back to a lane; 0: it stops.
        cost: of lanes.
        lanes: those of the road that it may be on.
    """

    def __init__(
        self,
        road: RoadMap,
        pose: Pose,
        z_m: float,
        creep_mps: float,
        cost: Cost,
        lanes: Callable[[RoadMap], LaneMap] = lanes_for_cars,
    ) -> None:
        self._line = _line_ahead(road, lanes(road), pose, z_m, cost)
        self._creep_mps = 0.0 if self._line is None else creep_mps
        self._pose = _signed(pose)

    def next(self, clear: Callable[[Sequence[Pose]], bool]) -> Pose:
        """The pose one step later; ``clear``: whether nothing is in the way at poses."""
        braking = _BRAKES_MPS2
        target = self._creep_mps
        if target > 0 and not clear(self._look_ahead()):
            target, braking = 0.0, _BRAKES_FOR_OTHERS_MPS2
        self._pose = self._moved(self._pose, _approached(self._pose.speed_mps, target, braking))
        return self._pose

    def _look_ahead(self) -> list[Pose]:
        """Where it is in a moment if it goes on."""
        pose = self._pose
        speed = max(pose.speed_mps, self._creep_mps)
        reach_m = _LOOKS_M + _LOOKS_S * speed
        seen: list[Pose] = []
        while len(seen) * DT_S * speed < reach_m:
            pose = self._moved(pose, speed)
            seen.append(pose)
        return seen

    def _moved(self, pose: Pose, speed_mps: float) -> Pose:
        """One step with a speed at its end, steered towards the line."""
        mean = (pose.speed_mps + speed_mps) / 2
        turn = self._turn_rad(pose, mean)
        x, y = mean * DT_S * frames.unit(np.array(pose.heading_rad + turn / 2))
        return Pose(
            x_m=pose.x_m + float(x),
            y_m=pose.y_m + float(y),
            heading_rad=float(frames.wrap(pose.heading_rad + turn)),
            speed_mps=speed_mps,
        )

    def _turn_rad(self, pose: Pose, speed_mps: float) -> float:
        """Change of the heading within a step; none backwards, and none without a lane."""
        if self._line is None or speed_mps <= 0:
            return 0.0
        foot = polylines.project(self._line, np.array([pose.x_m, pose.y_m]))
        settles_m = max(_SETTLES_M, _SETTLES_S * speed_mps)
        aside = np.clip(-np.arctan(foot.left_m / settles_m), -_STEEPEST_RAD, _STEEPEST_RAD)
        wanted = float(frames.difference(float(foot.heading_rad + aside), pose.heading_rad))
        sharpest = min(_SHARPEST_PER_M, _ASIDE_MPS2 / speed_mps**2)
        most = sharpest * speed_mps * DT_S
        return min(max(wanted, -most), most)


def _signed(pose: Pose) -> Pose:
    """A pose that moves along its heading; backwards if that is what its course says."""
    if pose.course_rad is None:
        return pose
    backwards = np.cos(pose.course_rad - pose.heading_rad) < 0
    return replace(
        pose, course_rad=None, speed_mps=-pose.speed_mps if backwards else pose.speed_mps
    )


def _approached(speed_mps: float, target_mps: float, braking_mps2: float) -> float:
    """A speed one step nearer to the target."""
    if speed_mps < 0:
        return min(speed_mps + braking_mps2 * DT_S, 0.0)
    if speed_mps > target_mps:
        return max(speed_mps - braking_mps2 * DT_S, target_mps)
    return min(speed_mps + _STARTS_MPS2 * DT_S, target_mps)


def _line_ahead(road: RoadMap, lanes: LaneMap, pose: Pose, z_m: float, cost: Cost) -> Floats | None:
    """(P, 2) centre line from the nearest lane on; None if no lane is near."""
    feet = lanes.feet(np.array([[pose.x_m, pose.y_m]]), _REACH_M)
    x, y = lanes.vector_m[feet.segment].T
    turned = np.abs(frames.difference(np.arctan2(y, x), pose.heading_rad))
    away = np.hypot(*feet.away_m.T)
    worse = away + _TURN_COSTS_M * turned
    able = (away <= _REACH_M) & (turned <= _LARGEST_TURN_RAD)
    if ground_of(road).has_levels:
        able &= ~clear(lanes.heights_m(feet), np.array(z_m))
    best: tuple[float, Lane] | None = None
    for row in np.flatnonzero(able)[np.argsort(worse[able], kind="stable")]:
        if best is not None and worse[row] >= best[0]:
            break  # another lane costs nothing or more
        lane = lanes.lanes[lanes.lane[feet.segment[row]]]
        more = cost(lane.id)
        if more is not None and (best is None or worse[row] + more < best[0]):
            best = float(worse[row]) + more, lane
    return None if best is None else _joined(road, best[1], cost)


def _joined(road: RoadMap, lane: Lane, cost: Cost) -> Floats:
    """The lane's line, and those of the lanes that follow it, the best and straightest first."""
    parts, seen = [lane.centre_m], {lane.id}
    length = float(polylines.arc_lengths(lane.centre_m)[-1])
    while length < _LINE_M and len(seen) < _MOST_LANES:
        follows: list[tuple[float, float, str]] = []
        for name in lane.next:
            more = cost(name) if name in road.lanes and name not in seen else None
            if more is not None and len(road.lanes[name].centre_m) > 1:
                follows.append((more, _bend_rad(lane, road.lanes[name]), name))
        if not follows:
            break
        lane = road.lanes[min(follows)[2]]
        seen.add(lane.id)
        parts.append(lane.centre_m)
        length += float(polylines.arc_lengths(lane.centre_m)[-1])
    return np.concatenate(parts)


def _bend_rad(lane: Lane, following: Lane) -> float:
    """Angle from the end of a lane to the end of one that follows it."""
    ends = [np.arctan2(*(one.centre_m[-1] - one.centre_m[-2])[::-1]) for one in (lane, following)]
    return abs(float(frames.difference(float(ends[1]), float(ends[0]))))
