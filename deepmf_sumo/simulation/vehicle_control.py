"""Control of vehicles in SUMO's traffic: placing them at poses, and handing them back to SUMO."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Event, Floats
from deepmf_sumo.geometry import frames
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.free_positions import (
    FreePosition,
    FreePositions,
    Occupancy,
    permitted,
)
from deepmf_sumo.simulation.sumo_api import SumoApi

MATCH_M: Final = 5.0
"""Largest distance of a moving vehicle from the lane on which SUMO still takes it."""
_AT_ONCE_MPS: Final = 1000.0
_EXACT = 2  # keepRoute: exactly where it is put
_EXACT_ON_ROUTE = 3  # the same, but SUMO takes it on lanes of its route alone
_SNAP_TO_LANE, _SNAP_TO_ROUTE = 0, 1  # keepRoute: the nearest lane, of its route alone
_SNAP_M = 100.0
_ARRIVED = 2  # why SUMO removes it: counted as a vehicle that has arrived
_BESIDE_M: Final = 0.1
_SHORTEST_M: Final = 0.5
_BEYOND_M: Final = 0.1
_BEYOND_TURN_M: Final = 2.5  # where a vehicle may turn back
_STRAIGHT_ON = 0.5  # cosine of the angle to the lane: one that turns back has a larger angle
_TURNS_BACK = ("t", "T")  # directions of links
_ASKEW_RAD: Final = np.radians(60.0)


def move(
    api: SumoApi,
    vehicle_id: str,
    pose: Pose,
    length_m: float,
    match_m: float,
    *,
    on_route: bool = False,
) -> None:
    """Put a vehicle exactly there at the end of the coming step.

    ``match_m``: largest distance of the front from a lane on which SUMO still takes the vehicle;
    ``on_route``: of its route alone.
    """
    front, angle = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
    x, y = float(front[0]), float(front[1])
    keep = _EXACT_ON_ROUTE if on_route else _EXACT
    api.vehicle.moveToXY(vehicle_id, "", -1, x, y, float(angle), keep, match_m)


def has_stops(api: SumoApi, vehicle_id: str) -> bool:
    """Whether stops of a vehicle lie ahead of it or behind it.

    SUMO 1.28 ends where such a vehicle comes onto a lane off its route: it gives the vehicle all of
    its stops again, and finds that some are not ahead.
    """
    return bool(api.vehicle.getStops(vehicle_id) or api.vehicle.getStops(vehicle_id, -1))


@dataclass(frozen=True, slots=True)
class _End:
    """End (2) and direction (2) of a lane where the network ends, and the metres beyond it."""

    point_m: Floats
    ahead: Floats
    beyond_m: float


class NetworkEnds:
    """Where the network ends: at the ends of edges from which no lane leads on but back.

    SUMO takes its own vehicles off the road there, but keeps one that is placed beyond.
    """

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._ends: dict[str, _End | None] = {}
        self._last: tuple[AgentId, str] = ("", "")

    def passed(self, vehicle_id: AgentId, pose: Pose, length_m: float) -> bool:
        """Whether the pose is beyond the end of the last edge on which the vehicle was."""
        lane = str(self._api.vehicle.getLaneID(vehicle_id))
        if lane and not lane.startswith(":"):
            self._last = vehicle_id, lane
        if self._last[0] != vehicle_id:
            return False
        lane = self._last[1]
        if lane not in self._ends:
            self._ends[lane] = self._end(lane)
        end = self._ends[lane]
        if end is None or frames.unit(np.array(pose.heading_rad)) @ end.ahead < _STRAIGHT_ON:
            return False
        front, _ = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
        return float((front - end.point_m) @ end.ahead) > end.beyond_m

    def _end(self, lane: str) -> _End | None:
        edge = lane.rpartition("_")[0]
        beside = range(self._api.edge.getLaneNumber(edge))
        links = [link for i in beside for link in self._api.lane.getLinks(f"{edge}_{i}")]
        if any(link[6] not in _TURNS_BACK for link in links):
            return None
        shape = np.array(self._api.lane.getShape(lane), float)[:, :2]
        ahead = shape[-1] - shape[-2]
        beyond_m = _BEYOND_TURN_M if links else _BEYOND_M
        return _End(shape[-1], ahead / np.hypot(*ahead), beyond_m)


class HandOver:
    """Prepares a vehicle in SUMO for being placed at each step, and for being driven by SUMO again.

    Three states crash SUMO 1.28 where a vehicle is on two lanes at once (the first with
    `lanechange.duration`, the second with the sublane model too):

    - A lane change under way moves a vehicle sideways by time, even while a client places it
      elsewhere. If the vehicle is placed beyond the border of its lane before SUMO has it half-way
      across, SUMO looks for one more lane to move it to. So the change is ended first.
    - A vehicle that is placed on a lane that its class may not use is taken off its own lane, but
      stays listed on the lane beside it. So it may use every lane until SUMO drives it again, and
      the vehicles of that lane see it.
    - A vehicle that leaves the lanes while its rear is inside a junction stays listed there, and
      the next vehicle that is about to enter asks for its lane. So its rear is cut off (`fit`).
    """

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._hurried: tuple[AgentId, float] | None = None
        self._class: dict[AgentId, str] = {}
        self._lost: set[AgentId] = set()
        self._length_m: dict[AgentId, float] = {}  # of vehicles that SUMO has shorter

    def take(self, vehicle_id: AgentId) -> None:
        """From the coming step on a client places the vehicle."""
        vehicle, option = self._api.vehicle, self._api.simulation.getOption
        sublane = float(option("lateral-resolution")) > 0
        self._lost.discard(vehicle_id)
        if (sublane or float(option("lanechange.duration")) > 0) and vehicle_id not in self._class:
            self._class[vehicle_id] = str(vehicle.getVehicleClass(vehicle_id))
            vehicle.setVehicleClass(vehicle_id, "ignoring")
        if float(vehicle.getLateralSpeed(vehicle_id)) != 0.0 and not sublane:
            self._hurried = vehicle_id, float(vehicle.getMaxSpeedLat(vehicle_id))
            vehicle.setMaxSpeedLat(vehicle_id, _AT_ONCE_MPS)

    def fit(self, vehicle_id: AgentId, pose: Pose, length_m: float) -> None:
        """Before it is placed: cut off its rear if it may leave the lanes without that.

        SUMO takes it off them where it does not touch its lane any more.
        """
        vehicle = self._api.vehicle
        lane_id = vehicle.getLaneID(vehicle_id)
        if not lane_id:
            return
        along_m = float(vehicle.getLanePosition(vehicle_id))
        if along_m < length_m and self._may_leave(vehicle_id, lane_id, pose, length_m):
            self._length_m[vehicle_id] = length_m
            vehicle.setLength(vehicle_id, max(along_m, _SHORTEST_M))
        else:
            self._restore_length(vehicle_id)

    def _may_leave(self, vehicle_id: AgentId, lane_id: str, pose: Pose, length_m: float) -> bool:
        vehicle = self._api.vehicle
        front, _ = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
        moved_m = float(np.hypot(*(front - np.array(vehicle.getPosition(vehicle_id)))))
        reach_m = abs(float(vehicle.getLateralLanePosition(vehicle_id))) + moved_m
        widths_m = self._api.lane.getWidth(lane_id) + vehicle.getWidth(vehicle_id)
        return bool(reach_m > widths_m / 2)

    def _restore_length(self, vehicle_id: AgentId) -> None:
        length_m = self._length_m.pop(vehicle_id, None)
        if length_m is not None:
            self._api.vehicle.setLength(vehicle_id, length_m)

    def give_back(self, vehicle_id: AgentId) -> None:
        """From the coming step on SUMO drives the vehicle."""
        self._restore_length(vehicle_id)
        permission = self._class.pop(vehicle_id, None)
        if permission is not None:
            self._api.vehicle.setVehicleClass(vehicle_id, permission)

    def lose(self, vehicle_id: AgentId) -> None:
        """The vehicle has left the road; if SUMO brings it back, SUMO drives it."""
        if vehicle_id in self._class or vehicle_id in self._length_m:
            self._lost.add(vehicle_id)

    def after_step(self) -> None:
        """Restore the lateral speed of the vehicle, and the class of those that are back."""
        if self._hurried is None and not self._lost:
            return
        there = self._api.vehicle.getIDList()
        for vehicle_id in self._lost.intersection(there):
            self._lost.remove(vehicle_id)
            self.give_back(vehicle_id)
        if self._hurried is not None and self._hurried[0] in there:
            self._api.vehicle.setMaxSpeedLat(*self._hurried)
        self._hurried = None


@dataclass(slots=True, kw_only=True)
class _Taken:
    agent: AgentId
    length_m: float
    route: tuple[str, ...]
    stops: bool
    pose: Pose


class Takeover:
    """The one vehicle that a policy drives in SUMO's traffic.

    Args:
        api: a running SUMO.
        events: notes are added to it.
        positions: for a vehicle that SUMO cannot drive from its pose; None: the nearest lane, free
            or not.
        may_remove: whether a vehicle without a free position, or beyond the end of the network, is
            removed from the simulation; else it is put on the nearest lane, or goes on.
    """

    def __init__(
        self,
        api: SumoApi,
        events: list[Event],
        positions: FreePositions | None = None,
        *,
        may_remove: bool = True,
    ) -> None:
        self._api = api
        self._events = events
        self._positions = positions
        self._may_remove = may_remove
        self._ends = NetworkEnds(api)
        self._hand_over = HandOver(api)
        self._taken: _Taken | None = None
        self._moved: tuple[_Taken, float] | None = None
        self._gone: set[AgentId] = set()

    def placed(self) -> tuple[AgentId, Pose] | None:
        """The vehicle and the pose it was put at in the last step; None while SUMO drives."""
        taken = self._taken
        return None if taken is None else (taken.agent, taken.pose)

    def place(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put the vehicle at the pose at the end of the coming step, or take it off the road.

        In SUMO's traffic (with ``positions``, and where it may be removed) it leaves where the
        network ends, as all do.
        """
        if not self._present(step, agent):
            return
        traffic = self._positions is not None and self._may_remove
        if traffic and self._ends.passed(agent, pose, length_m):
            self._api.vehicle.remove(agent, _ARRIVED)
            self._gone.add(agent)
            self._note(step, agent, "opponent_gone", "it left where the network ends")
            return
        if self._taken is None or self._taken.agent != agent:  # the last one may have left
            route = tuple(self._api.vehicle.getRoute(agent))
            stops = has_stops(self._api, agent)
            self._taken = _Taken(
                agent=agent, length_m=length_m, route=route, stops=stops, pose=pose
            )
            if stops:
                detail = "it has stops, so SUMO's vehicles see it on its own route alone"
                self._note(step, agent, "seen_on_route", detail)
            self._hand_over.take(agent)
        self._taken.pose = pose
        self._hand_over.fit(agent, pose, length_m)
        move(self._api, agent, pose, length_m, MATCH_M, on_route=self._taken.stops)

    def after_step(self, step: int) -> None:
        """Tell SUMO the speed: else it would be that of the jump, cut to the vehicle's limits."""
        self._hand_over.after_step()
        there = self._api.vehicle.getIDList()
        if self._taken is not None and self._taken.agent in there:
            self._api.vehicle.setPreviousSpeed(self._taken.agent, self._taken.pose.speed_mps)
        elif self._taken is not None:
            self._hand_over.lose(self._taken.agent)
            self._taken = None  # if SUMO brings it back, it is somewhere else
        if self._moved is not None and self._moved[0].agent in there:
            taken, speed_mps = self._moved
            self._api.vehicle.setPreviousSpeed(taken.agent, speed_mps)
            self._restore_route(step, taken)
        self._moved = None

    def hand_back(self, step: int, agent: AgentId, around: Occupancy | None = None) -> None:
        """Let SUMO drive the vehicle from the coming step on.

        A vehicle that SUMO could not drive on from its pose (off-centre, against the direction of
        the lane, or overlapping others) is put on the nearest free position of a lane, or removed
        if there is none and that is allowed. It may overlap the AV: SUMO separates the two.

        Args:
            step: now.
            agent: the vehicle.
            around: the agents around it, needed with `FreePositions`; without the vehicle if it is
                on no road, because SUMO teleports it.
        """
        taken = self._taken
        if taken is None or not self._present(step, agent):
            return
        self._taken = None
        self._hand_over.give_back(agent)
        if self._positions is None:
            self._hand_to_nearest_lane(step, taken)
        elif around is None or agent not in around.frame.ids:
            self._note(step, agent, "opponent_gone", "SUMO has taken it off the road")
        elif self._drivable(taken, self._positions, around):
            self._go_on(step, taken)
        else:
            free = self._positions.nearest(
                agent, around.frame, around.size_m, taken.route, on_route=taken.stops
            )
            if free is not None:
                self._put(step, taken, free)
            elif self._may_remove:
                self._api.vehicle.remove(agent)
                self._note(step, agent, "removed", "no free place on a lane within 50 m")
            else:
                self._hand_to_nearest_lane(step, taken)

    def _go_on(self, step: int, taken: _Taken) -> None:
        self._note(step, taken.agent, "handed_back", "SUMO drives on along the route")
        self._restore_route(step, taken)

    def _hand_to_nearest_lane(self, step: int, taken: _Taken) -> None:
        vehicle, agent = self._api.vehicle, taken.agent
        lane_id = vehicle.getLaneID(agent)
        if lane_id and permitted(self._api, agent, lane_id):
            self._go_on(step, taken)
            return
        x, y = vehicle.getPosition(agent)
        keep = _SNAP_TO_ROUTE if taken.stops else _SNAP_TO_LANE
        vehicle.moveToXY(agent, "", -1, x, y, vehicle.getAngle(agent), keep, _SNAP_M)
        self._note(step, agent, "handed_back", "put on the nearest lane, where SUMO drives on")

    def _drivable(self, taken: _Taken, positions: FreePositions, around: Occupancy) -> bool:
        """Whether SUMO can drive on from the pose of the vehicle.

        Without its sublane model SUMO keeps a vehicle off-centre for ever, where it reaches into
        the next lane unseen, and stops it for good inside a junction under `lanechange.duration`.
        """
        vehicle, agent = self._api.vehicle, taken.agent
        lane_id = vehicle.getLaneID(agent)
        if not lane_id or not permitted(self._api, agent, lane_id):
            return False
        if around.touched(agent):
            return False
        if positions.askew_rad(lane_id, taken.pose) > _ASKEW_RAD:
            return False
        sublane = float(self._api.simulation.getOption("lateral-resolution")) > 0
        return sublane or abs(vehicle.getLateralLanePosition(agent)) <= _BESIDE_M

    def _put(self, step: int, taken: _Taken, free: FreePosition) -> None:
        edge, _, lane = free.lane_id.rpartition("_")
        angle = float(frames.sumo_angle(free.heading_rad))
        x, y = free.front_m
        keep = _EXACT_ON_ROUTE if taken.stops else _EXACT
        self._api.vehicle.moveToXY(taken.agent, edge, int(lane), x, y, angle, keep, MATCH_M)
        self._moved = taken, free.speed_mps
        detail = f"put on lane {free.lane_id}, {free.moved_m:.1f} m away, where SUMO drives on"
        self._note(step, taken.agent, "handed_back", detail)

    def _restore_route(self, step: int, taken: _Taken) -> None:
        """Send a vehicle that has left its route to its destination."""
        if tuple(self._api.vehicle.getRoute(taken.agent)) == taken.route:
            return
        try:
            self._api.vehicle.changeTarget(taken.agent, taken.route[-1])
        except self._api.TraCIException:
            detail = f"no way back to its destination {taken.route[-1]}"
            self._note(step, taken.agent, "route_lost", detail)

    def _note(self, step: int, agent: AgentId, kind: str, detail: str) -> None:
        self._events.append(Event(step=step, agent_id=agent, kind=kind, detail=detail))

    def _present(self, step: int, agent: AgentId) -> bool:
        present = agent in self._api.vehicle.getIDList()
        if not present and agent not in self._gone:
            self._gone.add(agent)
            self._note(step, agent, "opponent_gone", "left the traffic")
        return present
