"""The shown pose of a vehicle that SUMO drives: SUMO's own, without its jumps to the side.

Without its sublane model SUMO changes lanes within one step. SUMO's own remedy
(`lanechange.duration`) makes a vehicle that starts off-centre inside a junction stop there for
ever. So SUMO changes lanes in one step, and the vehicle that planners, policies and judges see
moves from lane to lane within 3 s. Every other jump to the side is spread over 1.5 s: onto the
opposite lane and back, onto the next edge or a junction, and that with which SUMO begins to drive a
vehicle that was not on the middle of its lane. Apart from that a vehicle is shown where SUMO has
it.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np

from deepmf_sumo.scene import DT_S, AgentId, Floats
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_STEPS: Final = 30
"""A lane change is shown within 3 s. It goes on while the vehicle stands: SUMO has already given
its position on the old lane to the vehicles behind it."""
_TELEPORT_M: Final = 1.0
"""A step that is longer than speed and lane change explain by more than this is a teleport."""
_ASKEW_RAD: Final = 0.6
"""A vehicle that is turned against its lane by more than this is still in a turn, beside both lanes
of a change: that change is shown as SUMO makes it."""


_SETTLING_STEPS: Final = 15
"""A vehicle that comes back from the opposite lane has not more time: another one is coming."""
_JUMP_M: Final = 0.5
"""SUMO's vehicles move to the side of their lane by more than motion explains where they jump."""
FARTHEST_JUMP_M: Final = 6.0
_STOOD_M: Final = 0.05
_ALIGNED_M, _ALIGNED_RAD = 0.2, 0.1
"""Below these an offset and an angle with which SUMO begins to drive a vehicle are not spread."""


class Jump(NamedTuple):
    """How far left of SUMO's front and rear those are from which a vehicle comes, in metres."""

    front_m: float
    rear_m: float


@dataclass(slots=True, kw_only=True)
class _Settling:
    """A jump of which ``share`` is still to be shown; ``origin``: the lane before it, or empty."""

    jump: Jump
    origin: str
    share: float = 1.0


@dataclass(slots=True, kw_only=True)
class _Change:
    """A lane change that is still shown: ``share`` of the distance from lane to lane is left.

    ``across_m``: from lane to lane.
    ``rear_over``: whether SUMO's rear bumper has followed. Until it reaches the edge it stays on
    the lane that leads to the origin, and SUMO's vehicle is askew.
    """

    origin: str
    target: str
    share: float = 1.0
    across_m: float = 0.0
    rear_over: bool = False


class _Shown(NamedTuple):
    lane: str
    front_m: Floats
    rear_m: Floats
    speed_mps: float


class ShownMotion:
    """The shown pose of a vehicle that SUMO drives: SUMO's own, with jumps spread over time.

    A change of lanes on one edge ends after 3 s, or with the edge if that comes first: there the
    two lanes may part. Until then the vehicle is between the two. Other jumps are spread in the
    frame of the vehicle.

    Args:
        api: a running SUMO.
        vehicle_id: the vehicle.
        length_m: of its box.
    """

    def __init__(self, api: SumoApi, vehicle_id: AgentId, length_m: float) -> None:
        self._api = api
        self._id = vehicle_id
        self._length_m = length_m
        self._shapes: dict[str, Floats] = {}
        self._lengths_m: dict[str, float] = {}
        self._before: _Shown | None = None
        self._changes: list[_Change] = []
        self._handed: Pose | None = None
        self._last: tuple[Pose, str] | None = None
        self._earlier: Pose | None = None
        self._settling: _Settling | None = None
        self._before_shown: Pose | None = None

    def restart(self, pose: Pose | None = None) -> None:
        """Forget the past: the vehicle was placed somewhere else.

        ``pose``: where SUMO takes it over, if it does so in the next step.
        """
        self._before, self._changes = None, []
        self._last, self._earlier, self._settling, self._handed = None, None, None, pose
        self._before_shown = None

    @property
    def begun(self) -> Jump | None:
        """The jump with which SUMO began to drive the vehicle, while it is spread."""
        settling = self._settling
        return None if settling is None or settling.origin else settling.jump

    def leaving(self) -> dict[str, float]:
        """The lanes that the vehicle is shown leaving, and how far it is from their centres."""
        found = {one.origin: (1.0 - one.share) * one.across_m for one in self._changes}
        one = self._settling
        if one is not None and one.origin:
            found[one.origin] = (1.0 - one.share) * abs(one.jump.front_m)
        return found

    def along(self, lane: str) -> float | None:
        """Metres from the begin of a lane that it leaves to its front; None if that is oncoming."""
        assert self._before is not None
        foot = polylines.project(self._line(lane), self._before.front_m)
        heading_rad = np.arctan2(*(self._before.front_m - self._before.rear_m)[::-1])
        if abs(frames.difference(foot.heading_rad, heading_rad)) > np.pi / 2:
            return None
        shape_m = max(float(polylines.arc_lengths(self._line(lane))[-1]), 1e-6)
        return float(foot.along_m) * float(self._api.lane.getLength(lane)) / shape_m

    def advance(self, pose: Pose) -> Pose:
        """The pose to show for SUMO's pose after a step; called once a step."""
        return self._settled(self._spread(pose))

    def _settled(self, pose: Pose) -> Pose:
        """The pose with what is left of jumps."""
        lane, last, earlier, handed = self._lane(), self._last, self._earlier, self._handed
        self._last, self._earlier, self._handed = (
            (pose, lane),
            None if last is None else last[0],
            None,
        )
        aside = frames.unit(np.array(self._direction_rad(lane, pose) + np.pi / 2))
        if last is not None:
            jump = _jump(earlier, last[0], pose, self._length_m, aside)
        elif handed is not None:
            jump = _begin(handed, pose, self._length_m, aside)
        else:
            jump = None
        if jump == "teleport":
            self._settling = None
        before = self._shown(pose, aside)
        if isinstance(jump, Jump):
            kept = self._settling
            rest = (0.0, 0.0) if kept is None else [one * kept.share for one in kept.jump]
            jump = Jump(jump.front_m + rest[0], jump.rear_m + rest[1])
            origin = "" if last is None or last[1] == lane else last[1]
            self._settling = _Settling(jump=jump, origin=origin)
            if last is not None and not self._milder(self._shown(pose, aside), before, pose):
                self._settling = (
                    kept  # where SUMO's vehicle turns in a step, its bumpers jump alone
                )
        if self._settling is not None:
            self._settling.share -= 1.0 / _SETTLING_STEPS
            if self._settling.share < 1e-9:
                self._settling = None
        self._before_shown = self._shown(pose, aside)
        return self._before_shown

    def _shown(self, pose: Pose, aside: Floats) -> Pose:
        return pose if self._settling is None else self._moved(pose, aside, self._settling)

    def _milder(self, one: Pose, other: Pose, pose: Pose) -> bool:
        """Whether a pose is less to the side of the last shown one than another."""
        last = self._before_shown
        if last is None:
            return True
        turn = frames.difference(pose.heading_rad, last.heading_rad)
        left = frames.unit(np.array(pose.heading_rad - turn / 2 + np.pi / 2))
        sides = [
            abs(float(np.array([to.x_m - last.x_m, to.y_m - last.y_m]) @ left))
            for to in (one, other)
        ]
        return sides[0] < sides[1]

    def _moved(self, pose: Pose, aside: Floats, settling: _Settling) -> Pose:
        """The pose with both bumpers to the side, by what is left of a jump."""
        front, rear = (
            one + settling.share * jump_m * aside
            for one, jump_m in zip(_bumpers(pose, self._length_m), settling.jump, strict=True)
        )
        heading = float(np.arctan2(*(front - rear)[::-1]))
        centre = front - self._length_m / 2 * frames.unit(np.array(heading))
        return replace(pose, x_m=float(centre[0]), y_m=float(centre[1]), heading_rad=heading)

    def _direction_rad(self, lane: str, pose: Pose) -> float:
        """Direction of travel of the lane at the front; the heading where that tells nothing."""
        if not lane or self._line_m(lane) < self._length_m:
            return pose.heading_rad  # a lane shorter than the vehicle may have any direction
        line = self._line(lane)
        front, _ = _bumpers(pose, self._length_m)
        along = float(polylines.project(line, front).heading_rad)
        against = np.cos(along - pose.heading_rad) < 0
        return along + np.pi * against

    def _spread(self, pose: Pose) -> Pose:
        """The pose in a change of lanes on one edge."""
        ahead = frames.unit(np.array(pose.heading_rad)) * self._length_m
        front = np.array([pose.x_m, pose.y_m]) + ahead / 2
        lane = self._lane()
        now = _Shown(lane, front, front - ahead, pose.speed_mps)
        before, self._before = self._before, now
        if before is None or not lane or _edge(lane) != _edge(before.lane):
            self._changes = []
            return pose
        if lane != before.lane:
            self._begin(before, now)
        if not self._changes:
            return pose
        self._go_on(lane, pose.speed_mps * DT_S)
        return self._between(before, now, pose)

    def _lane(self) -> str:
        """Empty off every lane, and where another client has removed the vehicle meanwhile."""
        try:
            return str(self._api.vehicle.getLaneID(self._id))
        except self._api.TraCIException:
            return ""

    def _begin(self, before: _Shown, now: _Shown) -> None:
        """Note a change, unless SUMO spreads it itself or has teleported the vehicle."""
        across = self._across(before.lane, now.lane, now.front_m)
        moved = before.front_m - now.front_m
        explained = np.hypot(*across) + (before.speed_mps + now.speed_mps) * DT_S + _TELEPORT_M
        if _jumped(moved, across) and np.hypot(*moved) < explained and not self._askew(before):
            self._changes.append(_Change(origin=before.lane, target=now.lane))

    def _askew(self, state: _Shown) -> bool:
        lane_rad = polylines.project(self._line(state.lane), state.front_m).heading_rad
        heading_rad = np.arctan2(*(state.front_m - state.rear_m)[::-1])
        return bool(abs(frames.difference(heading_rad, lane_rad)) > _ASKEW_RAD)

    def _go_on(self, lane: str, step_m: float) -> None:
        left_m = float(self._api.lane.getLength(lane))
        left_m -= float(self._api.vehicle.getLanePosition(self._id))
        by_room = left_m / max(left_m + step_m, 1e-6)
        for change in self._changes:
            change.share = min(change.share - 1.0 / _STEPS, change.share * by_room)
        self._changes = [change for change in self._changes if change.share > 1e-9]

    def _between(self, before: _Shown, now: _Shown, pose: Pose) -> Pose:
        """The pose with each bumper at its share of the distance from lane to lane."""
        front, rear = now.front_m.copy(), now.rear_m.copy()
        for change in self._changes:
            across = self._across(change.origin, change.target, now.front_m)
            change.across_m = float(np.hypot(*across))
            change.rear_over |= _jumped(before.rear_m - now.rear_m, across)
            front += change.share * across
            rear += change.share * across * change.rear_over
        heading = float(np.arctan2(*(front - rear)[::-1]))
        centre = front - self._length_m / 2 * frames.unit(np.array(heading))
        return replace(pose, x_m=float(centre[0]), y_m=float(centre[1]), heading_rad=heading)

    def _across(self, origin: str, target: str, at_m: Floats) -> Floats:
        """(2) from one lane to the other, between their points that are nearest."""
        start = self._foot(target, at_m)
        return self._foot(origin, start) - start

    def _foot(self, lane: str, at_m: Floats) -> Floats:
        line = self._line(lane)
        return polylines.points_at(line, polylines.project(line, at_m).along_m)[0]

    def _line_m(self, lane: str) -> float:
        """Length of a lane's shape; 0 of a single point."""
        if lane not in self._lengths_m:
            self._lengths_m[lane] = float(polylines.arc_lengths(self._line(lane))[-1])
        return self._lengths_m[lane]

    def _line(self, lane: str) -> Floats:
        if lane not in self._shapes:
            self._shapes[lane] = np.array(self._api.lane.getShape(lane), float)[:, :2]
        return self._shapes[lane]


def _jumped(moved_m: Floats, across_m: Floats) -> bool:
    """Whether a bumper has left the origin for the target; ``moved_m``: from now to before."""
    return bool(moved_m @ across_m > (across_m @ across_m) / 2)


def _bumpers(pose: Pose, length_m: float) -> tuple[Floats, Floats]:
    """(2) middle of the front, and of the rear."""
    centre = np.array([pose.x_m, pose.y_m])
    ahead = frames.unit(np.array(pose.heading_rad)) * length_m / 2
    return centre + ahead, centre - ahead


def _jump(
    earlier: Pose | None, before: Pose, now: Pose, length_m: float, aside: Floats
) -> Jump | Literal["teleport"] | None:
    """What of a step is a jump to the side; None if motion explains all of it.

    A bumper jumps that moves to the side of its lane and of its last step: at a kink of its lane it
    moves to the side of the lane alone. While the front does not jump, a turn explains as much of
    the rear as the vehicle drives: the rear of a train swings far out where its locomotive turns.
    ``aside`` (2): left of the lane.
    """
    way_m = (abs(before.speed_mps) + abs(now.speed_mps)) / 2 * DT_S
    starts, ends = _bumpers(before, length_m), _bumpers(now, length_m)
    moved = [end - start for start, end in zip(starts, ends, strict=True)]
    sides = [float(one @ aside) for one in moved]
    ahead = abs(float(moved[0] @ np.array([aside[1], -aside[0]])))
    if ahead > way_m + _TELEPORT_M or max(map(abs, sides)) > FARTHEST_JUMP_M + way_m:
        return "teleport"
    least_m = _JUMP_M + min(way_m / 2, _JUMP_M)
    last = [None, None] if earlier is None else _bumpers(earlier, length_m)
    jumps = [
        -side if min(abs(side), _off_course(origin, start, end)) > least_m else 0.0
        for side, origin, start, end in zip(sides, last, starts, ends, strict=True)
    ]
    swings = jumps[0] == 0.0 and abs(sides[1]) <= way_m
    return Jump(*jumps) if any(jumps) and not swings else None


def _off_course(origin: Floats | None, start: Floats, end: Floats) -> float:
    """Distance of an end from the line on which a point came to its start; inf if it stood."""
    course = np.zeros(2) if origin is None else start - origin
    length = float(np.hypot(*course))
    if length < _STOOD_M:
        return np.inf
    moved = end - start
    return abs(float(moved[0] * course[1] - moved[1] * course[0])) / length


def _begin(
    before: Pose, now: Pose, length_m: float, aside: Floats
) -> Jump | Literal["teleport"] | None:
    """The jump with which SUMO begins to drive a vehicle that moved along its heading before."""
    way = (before.speed_mps + now.speed_mps) / 2 * DT_S * frames.unit(np.array(before.heading_rad))
    pairs = zip(_bumpers(before, length_m), _bumpers(now, length_m), strict=True)
    sides = [float((start + way - end) @ aside) for start, end in pairs]
    if max(map(abs, sides)) > FARTHEST_JUMP_M:
        return "teleport"
    turned = abs(float(frames.difference(now.heading_rad, before.heading_rad)))
    small = abs(sum(sides)) / 2 <= _ALIGNED_M and turned <= _ALIGNED_RAD
    return None if small else Jump(*sides)


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]


def read_pose(api: SumoApi, vehicle_id: str, length_m: float) -> Pose:
    """Box centre of a vehicle."""
    vehicle = api.vehicle
    x_m, y_m, z_m = vehicle.getPosition3D(vehicle_id)
    centre, heading = frames.from_sumo((x_m, y_m), vehicle.getAngle(vehicle_id), length_m)
    return Pose(
        x_m=float(centre[0]),
        y_m=float(centre[1]),
        heading_rad=float(heading),
        speed_mps=float(vehicle.getSpeed(vehicle_id)),
        z_m=float(z_m),
    )
