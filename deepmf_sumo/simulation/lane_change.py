"""Lane changes of SUMO: shown over several steps, or ended before a vehicle is taken over.

Without its sublane model SUMO changes lanes within one step. SUMO's own remedy
(`lanechange.duration`) makes a vehicle that starts beside the middle of a lane inside a junction
stop there for ever. So SUMO changes lanes at once, and what planners, policies and judges see moves
from lane to lane within 3 s. In everything else a vehicle is shown where SUMO has it.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Floats
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.sumo_api import SumoApi

_AT_ONCE_MPS: Final = 1000.0
_STEPS: Final = 30
"""A lane change is shown within 3 s. It goes on while the vehicle stands: SUMO has already given
its place on the old lane to the vehicles behind it."""
_TELEPORT_M: Final = 1.0
"""A step that is so much longer than speed and lane change explain is a teleport."""


class LaneChangeEnd:
    """Ends the lane change of a vehicle that is about to be put somewhere.

    With `lanechange.duration` SUMO moves a vehicle over by time, even while a client puts it
    elsewhere. A vehicle that is put beyond the border of its lane before SUMO has it half way
    across crashes SUMO 1.28, which looks for one more lane to move it to.
    """

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._hurried: tuple[AgentId, float] | None = None

    def end(self, vehicle_id: AgentId) -> None:
        """End it in the coming step, if one is under way.

        The sublane model has none: there a vehicle moves sideways as it likes.
        """
        vehicle = self._api.vehicle
        if float(vehicle.getLateralSpeed(vehicle_id)) == 0.0:
            return
        if float(self._api.simulation.getOption("lateral-resolution")) > 0:
            return
        self._hurried = vehicle_id, float(vehicle.getMaxSpeedLat(vehicle_id))
        vehicle.setMaxSpeedLat(vehicle_id, _AT_ONCE_MPS)

    def after_step(self) -> None:
        """Restore the vehicle's own lateral speed."""
        if self._hurried is None:
            return
        vehicle_id, speed_mps = self._hurried
        self._hurried = None
        if vehicle_id in self._api.vehicle.getIDList():
            self._api.vehicle.setMaxSpeedLat(vehicle_id, speed_mps)


@dataclass(slots=True, kw_only=True)
class _Change:
    """A lane change that is still shown: ``share`` of the way from lane to lane is left.

    ``rear_over``: whether SUMO's rear bumper has followed. Until it reaches the edge it stays on
    the lane that leads to the origin, and SUMO's vehicle is askew.
    """

    origin: str
    target: str
    share: float = 1.0
    rear_over: bool = False


class _State(NamedTuple):
    lane: str
    front_m: Floats
    rear_m: Floats
    speed_mps: float


class ShownMotion:
    """What is shown of a vehicle that SUMO drives: SUMO's own pose, lane changes spread over time.

    A change is spread where SUMO's lane index changes on an edge and the vehicle jumps sideways for
    it. It ends after 3 s, or with the edge if that comes first: there the two lanes may part. Until
    then the vehicle is between the two.

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
        self._before: _State | None = None
        self._changes: list[_Change] = []

    def restart(self) -> None:
        """Forget the past: the vehicle was put somewhere else."""
        self._before, self._changes = None, []

    def advance(self, pose: Pose) -> Pose:
        """What to show for the pose that SUMO has after a step; to be called once a step."""
        ahead = angles.unit(np.array(pose.heading_rad)) * self._length_m
        front = np.array([pose.x_m, pose.y_m]) + ahead / 2
        lane = self._lane()
        now = _State(lane, front, front - ahead, pose.speed_mps)
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

    def _begin(self, before: _State, now: _State) -> None:
        """Note a change, unless SUMO spreads it itself or has teleported the vehicle."""
        across = self._across(before.lane, now.lane, now.front_m)
        moved = before.front_m - now.front_m
        explained = np.hypot(*across) + (before.speed_mps + now.speed_mps) * DT_S + _TELEPORT_M
        if _jumped(moved, across) and np.hypot(*moved) < explained:
            self._changes.append(_Change(origin=before.lane, target=now.lane))

    def _go_on(self, lane: str, step_m: float) -> None:
        left_m = float(self._api.lane.getLength(lane))
        left_m -= float(self._api.vehicle.getLanePosition(self._id))
        by_room = left_m / max(left_m + step_m, 1e-6)
        for change in self._changes:
            change.share = min(change.share - 1.0 / _STEPS, change.share * by_room)
        self._changes = [change for change in self._changes if change.share > 1e-9]

    def _between(self, before: _State, now: _State, pose: Pose) -> Pose:
        """The pose with each bumper at the share of its way from lane to lane."""
        front, rear = now.front_m.copy(), now.rear_m.copy()
        for change in self._changes:
            across = self._across(change.origin, change.target, now.front_m)
            change.rear_over |= _jumped(before.rear_m - now.rear_m, across)
            front += change.share * across
            rear += change.share * across * change.rear_over
        heading = float(np.arctan2(*(front - rear)[::-1]))
        centre = front - self._length_m / 2 * angles.unit(np.array(heading))
        return replace(pose, x_m=float(centre[0]), y_m=float(centre[1]), heading_rad=heading)

    def _across(self, origin: str, target: str, at_m: Floats) -> Floats:
        """(2) from a lane to another, at the points of both that are nearest."""
        start = self._foot(target, at_m)
        return self._foot(origin, start) - start

    def _foot(self, lane: str, at_m: Floats) -> Floats:
        if lane not in self._shapes:
            self._shapes[lane] = np.array(self._api.lane.getShape(lane), float)[:, :2]
        line = self._shapes[lane]
        point: Floats = polylines.points_at(line, polylines.project(line, at_m).along_m)[0]
        return point


def _jumped(moved_m: Floats, across_m: Floats) -> bool:
    """Whether a bumper has left the origin for the target; ``moved_m``: from now to before."""
    return bool(moved_m @ across_m > (across_m @ across_m) / 2)


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]
