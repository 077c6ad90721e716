"""The AV in SUMO: its way ahead, how its speed and lane are commanded, and where it is shown."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import DT_S, AgentId, Command, Floats, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.slow import STANDING_MPS, STOOD_MPS
from deepmf_sumo.sumo.network.footways import Footways, no_footways
from deepmf_sumo.sumo.simulation import on_lane
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.shown_motion import Jump, ShownMotion, read_pose
from deepmf_sumo.sumo.simulation.sumo_api import MATCH_M, SumoApi
from deepmf_sumo.sumo.simulation.vehicle_control import HandOver, has_stops, move
from deepmf_sumo.sumo.simulation.way_on import WayOn

# Bits of speedMode: 1 safe speed, 2 and 4 limits of acceleration and deceleration, 8 right of way,
# 16 red lights.
_OWN_DECISION = 31
# With bit 1 a commanded speed is cut without any limit to braking, with bit 4 SUMO's emergency
# braking is weakened to comfortable braking. So both are off, and the limits are kept here.
_COMMANDED = 24
# Harder than comfortably, because bit 4 would forbid that.
_BRAKES_HARD = 26
_NO_CHECKS = 0
_NO_CHANGES = 0
"""A laneChangeMode."""
_RISE_HELD_MPS = 0.02
_RISE_FREE_MPS = 0.15
_ASKEW_RAD = 0.3
"""A larger angle to its lane is not one that SUMO's first step may turn the AV by."""
_LOOK_M = 100.0
"""Distance within which SUMO's leader of the AV is recorded."""


LANE_LOST: Final = "SUMO cannot drive it from there: it drives to the nearest lane first"
"""The event ``lane_lost``."""


class WayBack(NamedTuple):
    """How an AV that a planner has left where SUMO drives nothing gets back to a lane.

    Attributes:
        begin: its way from a pose. clear: whether nothing is in its way at poses.
        lost: called when it begins.
    """

    begin: Callable[[Pose], WayOn]
    clear: Callable[[Sequence[Pose]], bool]
    lost: Callable[[], None]


class SumoAv:
    """The AV.

    Args:
        api: a running SUMO.
        av_id: its id there.
        length_m: of its box.
        start: its pose at the current step.
        way_back: from poses from which SUMO cannot drive it on; None: SUMO takes it anyway.
        footways: of SUMO's network, where it is placed.

    Attributes:
        placed: the pose it was put at in the last step; None if SUMO drove it.
        leaders: the vehicles that the planner named or SUMO's model followed in the last step;
            None if neither applies.
        pose: the shown pose: where the AV was placed, or as SUMO drives it (`ShownMotion`).
        lost: it does not count as present any more, although SUMO may still simulate it.
    """

    def __init__(
        self,
        api: SumoApi,
        av_id: AgentId,
        length_m: float,
        start: Pose,
        way_back: WayBack | None = None,
        footways: Callable[[], Footways] = no_footways,
    ) -> None:
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
        self._motion.restart(start)
        self._way_back = way_back
        self._way: WayOn | None = None
        self._hand_over = HandOver(api, footways)
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

    @property
    def drivable(self) -> bool:
        """Whether SUMO can drive the AV on from where it is without turning it around.

        What is left of its angle to the lane, and of its offset, is spread (`ShownMotion`).
        """
        lane_id = str(self._api.vehicle.getLaneID(self.id))
        if not lane_id or self.placed is None:
            return bool(lane_id)
        lane = np.array(self._api.lane.getShape(lane_id), float)[:, :2]
        at = np.array([self.placed.x_m, self.placed.y_m])
        along = float(polylines.project(lane, at).heading_rad)
        return abs(float(frames.difference(along, self.placed.heading_rad))) < _ASKEW_RAD

    @property
    def begun(self) -> Jump | None:
        """See `ShownMotion.begun`."""
        return self._motion.begun

    def path(self) -> Floats | None:
        """(P, 2) centre line from the front bumper on, or None off every lane."""
        if not self._path_known:
            self._path, self._path_known = self.ahead.centre_line(), True
        return self._path

    def blocked_by(
        self,
        placed: Mapping[AgentId, Pose],
        occupancy: Callable[[AgentId], Occupancy],
        road: RoadMap,
    ) -> dict[AgentId, float]:
        """Gaps, in metres, to road users that were put in its way and stand there, or almost.

        SUMO's driver looks at the lanes of its way, and at streams that cross them. A vehicle that
        stands across its way may be on another lane for SUMO, or on none.

        Args:
            placed: those that SUMO does not drive, and where they were put in the last step.
            occupancy: the agents around it now.
            road: its levels.
        """
        standing = {one for one, pose in placed.items() if pose.speed_mps < STOOD_MPS}
        line_m = self.path() if standing else None
        if line_m is None:
            return {}
        return occupancy(self.id).in_its_way(self.id, line_m, standing, road)

    def drive(self, command: Command, blocking: Mapping[AgentId, float] | None = None) -> None:
        """Ask for the command in the coming step.

        ``blocking``: gaps, in metres, to road users that stand in its way, seen by SUMO or not.
        """
        if command.kind == "pose":
            pose = Pose(
                x_m=command.x_m,
                y_m=command.y_m,
                heading_rad=command.heading_rad,
                speed_mps=command.speed_mps,
            )
            self._way = None
            self.place(pose, leader_id=command.leader_id)
            return
        if self._way_back is not None and self.placed is not None and not self.drivable:
            self._go_back(self._way_back, self.placed)
            return
        self._way = None
        if self.placed is not None:
            self.placed = None
            self._hand_over.give_back(self.id)
        self.leaders = self._followed(command)
        commanded = None
        vehicle = self._api.vehicle
        speed = float(vehicle.getSpeed(self.id))
        self._keep_lane(standing=speed <= STANDING_MPS)
        most = self._behind_unseen(speed, blocking or {}) if command.kind != "speed" else None
        if command.kind == "sumo":
            if most is not None and (most < speed or speed <= STANDING_MPS):
                commanded = most
            hard = commanded is not None and self._brakes_hard(speed, commanded)
            vehicle.setSpeedMode(self.id, _BRAKES_HARD if hard else _OWN_DECISION)
            vehicle.setSpeed(self.id, -1.0 if commanded is None else commanded)
        elif command.kind == "leader":
            vehicle.setSpeedMode(self.id, _COMMANDED)
            commanded = self._behind_leader(command, speed)
            if most is not None:
                commanded = min(commanded, most)
            vehicle.setSpeed(self.id, commanded)
        else:  # speed
            vehicle.setSpeedMode(self.id, _NO_CHECKS)
            vehicle.setSpeed(self.id, max(0.0, command.speed_mps))
        self._previous_mps, self._commanded_mps = speed, commanded

    def lane_cost(self, lane_id: str) -> float | None:
        """Of SUMO's lanes on its way back; see `ownership.NextOwner`."""
        route = self._api.vehicle.getRoute(self.id)
        return self._hand_over.lane_cost(self.id, lane_id, route)

    def _go_back(self, way_back: WayBack, placed: Pose) -> None:
        """Drive to the middle of a lane, where SUMO drives on."""
        if self._way is None:
            way_back.lost()
            self._way = way_back.begin(placed)
        self.place(self._way.next(way_back.clear))

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
            self._motion.restart(self.placed)
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

    def _brakes_hard(self, speed: float, commanded: float) -> bool:
        return commanded < speed - float(self._api.vehicle.getDecel(self.id)) * DT_S

    def _behind_unseen(self, speed: float, blocking: Mapping[AgentId, float]) -> float | None:
        """SUMO's speed behind what is in the AV's way where SUMO's driver does not look, or None.

        Also behind SUMO's own leader then: where the AV brakes hard, SUMO does not check the speed.
        """
        ahead = [*self._on_left_lanes(), *blocking.items()]
        if not ahead:
            return None
        self.leaders = tuple(dict.fromkeys([*(self.leaders or ()), *(one for one, _ in ahead)]))
        vehicle = self._api.vehicle
        least_m, decel = float(vehicle.getMinGap(self.id)), float(vehicle.getDecel(self.id))
        if own := vehicle.getLeader(self.id, _LOOK_M):
            ahead += [(str(own[0]), float(own[1]) + least_m)] if own[0] else []
        there, speeds = vehicle.getIDList(), []
        for one, gap_m in ahead:
            known, its_mps = (one, vehicle.getSpeed(one)) if one in there else ("", 0.0)  # a person
            found = vehicle.getFollowSpeed(
                self.id, speed, gap_m - least_m, float(its_mps), decel, known
            )
            speeds.append(float(found))
        hardest = speed - float(vehicle.getEmergencyDecel(self.id)) * DT_S
        return max(0.0, hardest, min(speeds))

    def _on_left_lanes(self) -> Iterator[tuple[AgentId, float]]:
        """The next vehicle on the lane that the AV is shown leaving, and the gap to it.

        For SUMO the AV is on its new lane immediately, and follows only what is there. As long as
        its box is in the way of a vehicle ahead on the old lane, it keeps its distance to that,
        too.
        """
        leaving = self._motion.leaving()
        if not leaving:
            return
        vehicle = self._api.vehicle
        own_width_m = float(vehicle.getWidth(self.id))
        for lane, aside_m in leaving.items():
            own_m = self._motion.along(lane)
            if own_m is None:
                continue
            gaps = []
            for other in self._api.lane.getLastStepVehicleIDs(lane):
                ahead_m = float(vehicle.getLanePosition(other)) - float(vehicle.getLength(other))
                wide_m = (float(vehicle.getWidth(other)) + own_width_m) / 2
                if ahead_m >= own_m and aside_m < wide_m:
                    gaps.append((ahead_m - own_m, str(other)))
            if gaps:
                gap_m, leader = min(gaps)
                yield leader, gap_m

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


class RouteAhead:
    """Lanes and centre line ahead of a vehicle; lane shapes are read once."""

    def __init__(self, api: SumoApi, vehicle_id: AgentId) -> None:
        self._api = api
        self._id = vehicle_id
        self._shapes: dict[str, Floats] = {}
        self._lengths_m: dict[str, float] = {}
        self._measured: dict[str, polylines.Measured | None] = {}
        self._lanes: tuple[str, ...] = ()
        self._line: polylines.Measured | None = None

    def centre_line(self, length_m: float = 120.0) -> Floats | None:
        """(P, 2) from the front bumper on, P >= 2, or None off every lane.

        Also None on a last lane without length. SUMO keeps a lateral offset while it follows a
        lane; so does the line. On the opposite lane, to overtake, it leads back along that lane, to
        the end of the vehicle's own edge and on.
        """
        vehicle = self._api.vehicle
        lane = vehicle.getLaneID(self._id)
        if not lane:
            return None
        shape, along = self._shape(lane), self._along(lane)
        against = self._against(lane, along)
        lanes = (lane, *self._lanes_ahead(lane), "against" * against)
        if lanes != self._lanes:
            self._lanes = lanes
            ahead = [self._shape(one) for one in lanes[1:-1]]
            line = np.concatenate([shape[::-1] if against else shape, *ahead])
            moved = np.hypot(*np.diff(line, axis=0).T) > 1e-3
            line = line[np.concatenate([[True], moved])]
            self._line = polylines.Measured(line) if len(line) > 1 else None
        if self._line is None:
            return None
        begin = self._shape_m(lane) - along if against else along
        along = self._line.along_m
        # at least a metre, so that the line has a direction
        end = max(min(along[-1], begin + length_m), begin + 1.0)
        inner = along[(along > begin + 1e-3) & (along < end - 1e-3)]
        points, heading = self._line.at(np.array([begin, *inner, end]))
        left = on_lane.left_m(self._api, self._id, points[0], float(heading[0]))
        if abs(left) > 0.01:
            points = points + left * np.stack([-np.sin(heading), np.cos(heading)], -1)
        return points

    def _along(self, lane: str) -> float:
        """Where the vehicle is along the shape of its lane, from the lane's begin."""
        lane_m = max(float(self._api.lane.getLength(lane)), 1e-6)
        position_m = float(self._api.vehicle.getLanePosition(self._id))
        return position_m * self._shape_m(lane) / lane_m

    def _against(self, lane: str, along_m: float) -> bool:
        """Whether the vehicle drives against its lane, as SUMO does to overtake.

        Networks have lanes inside junctions that are a single point: they have no direction.
        """
        if lane not in self._measured:
            shape = self._shape(lane)
            straight = np.ptp(shape, axis=0).any()
            self._measured[lane] = polylines.Measured(shape) if straight else None
        measured = self._measured[lane]
        if measured is None:
            return False
        _, lane_rad = measured.at(np.array(along_m))
        angle_deg = float(self._api.vehicle.getAngle(self._id))
        return on_lane.against(self._api, self._id, lane, float(lane_rad), angle_deg)

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
