"""The AV in SUMO: how its speed and lane are commanded, and where it is shown.

Lane changes of SUMO are shown over several steps, and are ended before a vehicle is taken over.

Without its sublane model SUMO changes lanes within one step. SUMO's own remedy
(`lanechange.duration`) makes a vehicle that starts off-centre inside a junction stop there for
ever. So SUMO changes lanes at once, and the vehicle that planners, policies and judges see moves
from lane to lane within 3 s. Apart from that a vehicle is shown where SUMO has it.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Command, Floats
from deepmf_sumo.geometry import frames, polylines
from deepmf_sumo.geometry.slow import STANDING_MPS
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.simulation.vehicle_control import MATCH_M, HandOver, has_stops, move


class RouteAhead:
    """Lanes and centre line ahead of a vehicle; lane shapes are read once."""

    def __init__(self, api: SumoApi, vehicle_id: str) -> None:
        self._api = api
        self._id = vehicle_id
        self._shapes: dict[str, Floats] = {}
        self._lengths_m: dict[str, float] = {}
        self._lanes: tuple[str, ...] = ()
        self._line: polylines.Measured | None = None

    def centre_line(self, length_m: float = 120.0) -> Floats | None:
        """(P, 2) from the front bumper on, P >= 2, or None off every lane.

        SUMO keeps a lateral offset while it follows a lane; so does the line.
        """
        vehicle = self._api.vehicle
        lane = vehicle.getLaneID(self._id)
        if not lane:
            return None
        lanes = (lane, *self._lanes_ahead(lane))
        if lanes != self._lanes:
            self._lanes = lanes
            line = np.concatenate([self._shape(one) for one in lanes])
            moved = np.hypot(*np.diff(line, axis=0).T) > 1e-3
            self._line = polylines.Measured(line[np.concatenate([[True], moved])])
        assert self._line is not None
        along = self._line.along_m
        lane_m = max(float(self._api.lane.getLength(lane)), 1e-6)
        begin = float(vehicle.getLanePosition(self._id)) * self._shape_m(lane) / lane_m
        # at least a metre, so that the line has a direction
        end = max(min(along[-1], begin + length_m), begin + 1.0)
        inner = along[(along > begin + 1e-3) & (along < end - 1e-3)]
        points, heading = self._line.at(np.array([begin, *inner, end]))
        left = float(vehicle.getLateralLanePosition(self._id))
        if abs(left) > 0.01:
            points = points + left * np.stack([-np.sin(heading), np.cos(heading)], -1)
        return points

    def _lanes_ahead(self, lane: str) -> list[str]:
        # on a junction's lane SUMO lists only the links after the junction
        lanes = self._through_junction(lane) if lane.startswith(":") else []
        for link in self._api.vehicle.getNextLinks(self._id):
            following, via = str(link[0]), str(link[4])
            lanes += [via, *self._through_junction(via)] if via else [following]
        return lanes

    def _through_junction(self, lane: str) -> list[str]:
        lanes: list[str] = []
        while lane.startswith(":"):
            links = self._api.lane.getLinks(lane)
            if not links:
                break
            lane = str(links[0][4] or links[0][0])
            lanes.append(lane)
        return lanes

    def _shape(self, lane: str) -> Floats:
        if lane not in self._shapes:
            self._shapes[lane] = np.array(self._api.lane.getShape(lane), float)[:, :2]
        return self._shapes[lane]

    def _shape_m(self, lane: str) -> float:
        """Length of a lane's shape, which need not be what SUMO takes the lane's length for."""
        if lane not in self._lengths_m:
            self._lengths_m[lane] = float(polylines.arc_lengths(self._shape(lane))[-1])
        return self._lengths_m[lane]


_STEPS: Final = 30
"""A lane change is shown within 3 s. It goes on while the vehicle stands: SUMO has already given
its position on the old lane to the vehicles behind it."""
_TELEPORT_M: Final = 1.0
"""A step that is longer than speed and lane change explain by more than this is a teleport."""
_ASKEW_RAD: Final = 0.6
"""A vehicle that is turned against its lane by more than this is still in a turn, beside both lanes
of a change: that change is shown as SUMO makes it."""


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


class _State(NamedTuple):
    lane: str
    front_m: Floats
    rear_m: Floats
    speed_mps: float


class ShownMotion:
    """The shown pose of a vehicle that SUMO drives: SUMO's own, with lane changes spread over time.

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
        """Forget the past: the vehicle was placed somewhere else."""
        self._before, self._changes = None, []

    def leaving(self) -> dict[str, float]:
        """The lanes that the vehicle is shown leaving, and how far it is from their centres."""
        return {one.origin: (1.0 - one.share) * one.across_m for one in self._changes}

    def advance(self, pose: Pose) -> Pose:
        """The pose to show for SUMO's pose after a step; called once a step."""
        ahead = frames.unit(np.array(pose.heading_rad)) * self._length_m
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
        if _jumped(moved, across) and np.hypot(*moved) < explained and not self._askew(before):
            self._changes.append(_Change(origin=before.lane, target=now.lane))

    def _askew(self, state: _State) -> bool:
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

    def _between(self, before: _State, now: _State, pose: Pose) -> Pose:
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

    def _line(self, lane: str) -> Floats:
        if lane not in self._shapes:
            self._shapes[lane] = np.array(self._api.lane.getShape(lane), float)[:, :2]
        return self._shapes[lane]


def _jumped(moved_m: Floats, across_m: Floats) -> bool:
    """Whether a bumper has left the origin for the target; ``moved_m``: from now to before."""
    return bool(moved_m @ across_m > (across_m @ across_m) / 2)


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]


# Bits of speedMode: 1 safe speed, 2 and 4 limits of acceleration and deceleration, 8 right of way,
# 16 red lights.
_OWN_DECISION = 31
# With bit 1 a commanded speed is cut without any limit to braking, with bit 4 SUMO's emergency
# braking is weakened to comfortable braking. So both are off, and the limits are kept here.
_COMMANDED = 24
_NO_CHECKS = 0
_NO_CHANGES = 0
"""A laneChangeMode."""
_RISE_HELD_MPS = 0.02
_RISE_FREE_MPS = 0.15
_LOOK_M = 100.0
"""Distance within which SUMO's leader of the AV is recorded."""


class Av:
    """The AV.

    Args:
        api: a running SUMO.
        av_id: its id there.
        length_m: of its box.
        start: its pose at the current step.

    Attributes:
        placed: the pose it was put at in the last step; None if SUMO drove it.
        leaders: the vehicles that the planner named or SUMO's model followed in the last step;
            None if neither applies.
        pose: the shown pose: where the AV was placed, or as SUMO drives it (`ShownMotion`).
        lost: it does not count as present any more, although SUMO may still simulate it.
    """

    def __init__(self, api: SumoApi, av_id: AgentId, length_m: float, start: Pose) -> None:
        self._api = api
        self.id = av_id
        self.length_m = length_m
        self.ahead = RouteAhead(api, av_id)
        self.placed: Pose | None = None
        self._has_stops = False
        self._changes_lanes: int | None = None  # SUMO's mode from before it stood
        self.leaders: tuple[AgentId, ...] | None = None
        self.lost = False
        self.pose = start
        self._motion = ShownMotion(api, av_id, length_m)
        self._hand_over = HandOver(api)
        self._previous_mps: float | None = None
        self._commanded_mps: float | None = None
        self._path: Floats | None = None
        self._path_known = False

    @property
    def present(self) -> bool:
        """Whether SUMO still simulates the AV."""
        return not self.lost and self.id in self._api.vehicle.getIDList()

    @property
    def teleported(self) -> bool:
        """Whether SUMO took the AV for stuck in the last step, and moved it on or off the road."""
        moved = self._api.simulation.getStartingTeleportIDList()
        return self.placed is None and self.id in moved

    @property
    def on_lane(self) -> bool:
        """Whether the AV is matched to a lane: off every lane SUMO cannot drive it."""
        return bool(self._api.vehicle.getLaneID(self.id))

    def path(self) -> Floats | None:
        """(P, 2) centre line from the front bumper on, or None off every lane."""
        if not self._path_known:
            self._path, self._path_known = self.ahead.centre_line(), True
        return self._path

    def drive(self, command: Command) -> None:
        """Ask for the command in the coming step."""
        if command.kind == "pose":
            pose = Pose(
                x_m=command.x_m,
                y_m=command.y_m,
                heading_rad=command.heading_rad,
                speed_mps=command.speed_mps,
            )
            self.place(pose, leader_id=command.leader_id)
            return
        if self.placed is not None:
            self.placed = None
            self._hand_over.give_back(self.id)
        self.leaders = self._followed(command)
        commanded = None
        vehicle = self._api.vehicle
        speed = float(vehicle.getSpeed(self.id))
        self._keep_lane(standing=speed <= STANDING_MPS)
        behind_left = self._behind_left_lane(speed) if command.kind != "speed" else None
        if command.kind == "sumo":
            vehicle.setSpeedMode(self.id, _OWN_DECISION)
            if behind_left is not None and behind_left < speed:
                commanded = behind_left
            vehicle.setSpeed(self.id, -1.0 if commanded is None else commanded)
        elif command.kind == "leader":
            vehicle.setSpeedMode(self.id, _COMMANDED)
            commanded = self._behind_leader(command, speed)
            if behind_left is not None:
                commanded = min(commanded, behind_left)
            vehicle.setSpeed(self.id, commanded)
        else:  # speed
            vehicle.setSpeedMode(self.id, _NO_CHECKS)
            vehicle.setSpeed(self.id, max(0.0, command.speed_mps))
        self._previous_mps, self._commanded_mps = speed, commanded

    def _keep_lane(self, *, standing: bool) -> None:
        """Let SUMO change the lane of an AV that stands only where its lane does not lead on.

        SUMO changes lanes at any speed, and no vehicle moves sideways while it stands.
        """
        keeps = standing and self.on_lane and self._leads_on()
        if keeps == (self._changes_lanes is not None):
            return
        vehicle = self._api.vehicle
        if keeps:
            self._changes_lanes = int(vehicle.getLaneChangeMode(self.id))
            vehicle.setLaneChangeMode(self.id, _NO_CHANGES)
        else:
            vehicle.setLaneChangeMode(self.id, self._changes_lanes)
            self._changes_lanes = None

    def _leads_on(self) -> bool:
        """Whether the AV's lane leads to where its route goes on."""
        lane = self._api.vehicle.getLaneID(self.id)
        best = self._api.vehicle.getBestLanes(self.id)
        return all(one[4] for one in best if one[0] == lane)

    def place(self, pose: Pose, leader_id: AgentId | None = None) -> None:
        """Put the AV at a pose at the end of the coming step."""
        if self.placed is None:
            self._hand_over.take(self.id)
            self._has_stops = has_stops(self._api, self.id)
        self.placed = pose
        self.leaders = None if leader_id is None else (leader_id,)
        self._previous_mps = float(self._api.vehicle.getSpeed(self.id))
        self._commanded_mps = None
        self._hand_over.fit(self.id, pose, self.length_m)
        move(self._api, self.id, pose, self.length_m, MATCH_M, on_route=self._has_stops)

    def after_step(self) -> None:
        """Tell SUMO the speed after a placement, and note the pose of the AV."""
        self._path_known = False
        self._hand_over.after_step()
        if self.placed is not None:
            self._api.vehicle.setPreviousSpeed(self.id, max(0.0, self.placed.speed_mps))
            self._motion.restart()
            self.pose = self.placed
        else:
            self.pose = self._motion.advance(self.sumo_pose())

    def sumo_pose(self) -> Pose:
        """Where SUMO has the AV."""
        return read_pose(self._api, self.id, self.length_m)

    def _followed(self, command: Command) -> tuple[AgentId, ...] | None:
        """The leader that the planner names, and SUMO's on the AV's lanes; None without both."""
        named = () if command.leader_id is None else (command.leader_id,)
        if command.kind == "speed":
            return named or None
        found = self._api.vehicle.getLeader(self.id, _LOOK_M) if self.on_lane else None
        return named if not found or not found[0] else tuple(dict.fromkeys([*named, str(found[0])]))

    def _behind_left_lane(self, speed: float) -> float | None:
        """SUMO's speed behind the next vehicle on the lane that the AV is shown leaving, or None.

        For SUMO the AV is on its new lane at once, and follows only what is there. As long as its
        box is in the way of a vehicle ahead on the old lane, it keeps its distance to that, too.
        """
        leaving = self._motion.leaving()
        if not leaving:
            return None
        vehicle = self._api.vehicle
        own_m, own_width_m = (
            float(get(self.id)) for get in (vehicle.getLanePosition, vehicle.getWidth)
        )
        speeds = []
        for lane, aside_m in leaving.items():
            gaps = []
            for other in self._api.lane.getLastStepVehicleIDs(lane):
                ahead_m = float(vehicle.getLanePosition(other)) - float(vehicle.getLength(other))
                wide_m = (float(vehicle.getWidth(other)) + own_width_m) / 2
                if ahead_m >= own_m and aside_m < wide_m:
                    gaps.append((ahead_m - own_m, str(other)))
            if gaps:
                gap_m, leader = min(gaps)
                gap_m -= float(vehicle.getMinGap(self.id))
                leader_mps = float(vehicle.getSpeed(leader))
                decel = float(vehicle.getDecel(self.id))
                found = vehicle.getFollowSpeed(self.id, speed, gap_m, leader_mps, decel, leader)
                speeds.append(float(found))
                self.leaders = tuple(dict.fromkeys([*(self.leaders or ()), leader]))
        hardest = speed - float(vehicle.getEmergencyDecel(self.id)) * DT_S
        return max(0.0, hardest, min(speeds)) if speeds else None

    def _behind_leader(self, command: Command, speed: float) -> float:
        """SUMO's speed behind the leader, but at most what SUMO's own decision allows.

        A commanded speed overrules SUMO's lights, right of way, limits and lane leaders. What SUMO
        itself would have done in the last step is known, but only if that was less than the
        command: so the acceleration may rise, slowly where it is SUMO's own, and faster where SUMO
        did not limit the last command.
        """
        vehicle = self._api.vehicle
        gap = command.gap_m - float(vehicle.getMinGap(self.id))  # negative: nearer than wanted
        decel = float(vehicle.getDecel(self.id))
        target = float(vehicle.getFollowSpeed(self.id, speed, gap, command.leader_mps, decel, ""))
        if self._previous_mps is not None:
            own = float(vehicle.getSpeedWithoutTraCI(self.id))
            held = self._commanded_mps is None or own < self._commanded_mps - 1e-6
            rise = _RISE_HELD_MPS if held else _RISE_FREE_MPS
            target = min(target, speed + own - self._previous_mps + rise)
        hardest = speed - float(vehicle.getEmergencyDecel(self.id)) * DT_S
        return max(0.0, hardest, target)


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
