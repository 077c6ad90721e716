"""Control of road users in SUMO's traffic: placing them at poses, handing them back to SUMO.

Persons are moved by `person_control`; vehicles, bicycles among them, here.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Event, Floats, agent_ids
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.network.footways import Footways, no_footways
from deepmf_sumo.sumo.network.sumo_net import TURNS
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.on_foot import WALK_MPS, Walk
from deepmf_sumo.sumo.simulation.on_lane import OwnWay
from deepmf_sumo.sumo.simulation.person_control import SEEN_ON_ANY_LANE, PersonControl
from deepmf_sumo.sumo.simulation.road_users import kind_of
from deepmf_sumo.sumo.simulation.sumo_api import MADE_TYPE, MATCH_M, SumoApi

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
_ASKEW_RAD: Final = 0.1
CREEP_MPS: Final = 5.0
"""At which a vehicle drives to where SUMO can drive it on."""
OWN_STOP_M: Final = 100.0
_OFF_ROUTE_COSTS_M: Final = 10.0
"""A lane off its route is as good as one on it that is farther off by this."""


def move(
    api: SumoApi,
    vehicle_id: str,
    pose: Pose,
    length_m: float,
    match_m: float,
    *,
    on_route: bool = False,
    any_lane: bool = False,
) -> None:
    """Put a vehicle exactly there at the end of the coming step.

    ``match_m``: largest distance of the front from a lane on which SUMO still takes the vehicle;
    ``on_route``: of its route alone; ``any_lane``: also of lanes that its class may not use.
    """
    front, angle = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
    x, y = float(front[0]), float(front[1])
    keep = _EXACT_ON_ROUTE if on_route else _EXACT
    keep += SEEN_ON_ANY_LANE if any_lane else 0
    api.vehicle.moveToXY(vehicle_id, "", -1, x, y, float(angle), keep, match_m)


def has_stops(api: SumoApi, vehicle_id: str) -> bool:
    """Whether stops of a vehicle lie ahead of it or behind it.

    SUMO 1.28 ends where such a vehicle comes onto a lane off its route: it gives the vehicle all of
    its stops again, and finds that some are not ahead.
    """
    return bool(api.vehicle.getStops(vehicle_id) or api.vehicle.getStops(vehicle_id, -1))


class OwnStop:
    """Whether an AV comes to, or keeps, a stop of its route: it slows down for it.

    ``events``: gets ``av_stop_ahead`` and ``av_stop_over``.
    """

    def __init__(self, api: SumoApi, vehicle_id: str, events: list[Event]) -> None:
        self._vehicle, self._id, self._events = api.vehicle, vehicle_id, events
        self._has = bool(self._vehicle.getStops(vehicle_id))
        self._was = False

    def note(self, step: int) -> None:
        """Say where it comes to a stop of its route, and where it has left it; each step."""
        near = self.near
        if near != self._was:
            kind = "av_stop_ahead" if near else "av_stop_over"
            self._events.append(Event(step=step, agent_id=self._id, kind=kind))
            self._was = near

    @property
    def near(self) -> bool:
        """Whether the next stop, also one that it stands at, is within `OWN_STOP_M`."""
        stops = self._vehicle.getStops(self._id, 1) if self._has else ()
        self._has = bool(stops)
        if not stops:
            return False
        edge, _, index = stops[0].lane.rpartition("_")
        place = (edge, stops[0].endPos, int(index))
        if 0.0 <= self._vehicle.getDrivingDistance(self._id, *place) <= OWN_STOP_M:
            return True
        return bool(self._vehicle.isStopped(self._id))  # it may stand a hair's breadth beyond


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
        if any(TURNS.get(link[6]) != "turnaround" for link in links):
            return None
        shape = np.array(self._api.lane.getShape(lane), float)[:, :2]
        ahead = shape[-1] - shape[-2]
        beyond_m = _BEYOND_TURN_M if links else _BEYOND_M
        return _End(shape[-1], ahead / np.hypot(*ahead), beyond_m)


class HandOver:
    """Prepares a vehicle in SUMO for being placed at each step, and for being driven by SUMO again.

    Three states crash SUMO 1.28 where a vehicle is on two lanes together (the first with
    `lanechange.duration`, the second with the sublane model too):

    - A lane change under way moves a vehicle sideways by time, even while a client places it
      elsewhere. If the vehicle is placed beyond the border of its lane before SUMO has it half-way
      across, SUMO looks for one more lane to move it to. So the change is ended first.
    - A vehicle that is placed on a lane that its class may not use is taken off its own lane, but
      stays listed on the lane beside it. So it may use every lane until SUMO drives it again, and
      the vehicles of that lane see it. Walking areas are the exception: onto these SUMO takes
      every vehicle that may use every lane, and crashes as well.
    - A vehicle that leaves the lanes while its rear is inside a junction stays listed there, and
      the next vehicle that is about to enter asks for its lane. So its rear is cut off (`fit`).

    Args:
        api: a running SUMO.
        footways: of its network; asked for where a vehicle may use every lane.
    """

    def __init__(self, api: SumoApi, footways: Callable[[], Footways] = no_footways) -> None:
        self._api, self._footways = api, footways
        self._hurried: dict[AgentId, float] = {}
        self._class: dict[AgentId, str] = {}
        self._lost: set[AgentId] = set()
        self._length_m: dict[AgentId, float] = {}  # of vehicles that SUMO has shorter

    def take(self, vehicle_id: AgentId) -> None:
        """From the coming step on a client places the vehicle."""
        vehicle, option = self._api.vehicle, self._api.simulation.getOption
        sublane = float(option("lateral-resolution")) > 0
        self._lost.discard(vehicle_id)
        if vehicle.getTypeID(vehicle_id).startswith(MADE_TYPE):
            return  # it always has a class that may be where it is
        if (sublane or float(option("lanechange.duration")) > 0) and vehicle_id not in self._class:
            self._class[vehicle_id] = str(vehicle.getVehicleClass(vehicle_id))
            vehicle.setVehicleClass(vehicle_id, "ignoring")
        if float(vehicle.getLateralSpeed(vehicle_id)) != 0.0 and not sublane:
            self._hurried[vehicle_id] = float(vehicle.getMaxSpeedLat(vehicle_id))
            vehicle.setMaxSpeedLat(vehicle_id, _AT_ONCE_MPS)

    def fit(self, vehicle_id: AgentId, pose: Pose, length_m: float) -> None:
        """Before it is placed: its class, and its rear, which is cut off if it may leave the lanes.

        SUMO takes it off them where it does not touch its lane any more.
        """
        self._permit(vehicle_id, pose, length_m)
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

    def _permit(self, vehicle_id: AgentId, pose: Pose, length_m: float) -> None:
        """Let it use every lane, but only those of its own class at a walking area."""
        own = self._class.get(vehicle_id)
        if own is None:
            return
        front, _ = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
        permission = own if self._footways().at_corner(front) else "ignoring"
        if self._api.vehicle.getVehicleClass(vehicle_id) != permission:
            self._api.vehicle.setVehicleClass(vehicle_id, permission)

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

    def permitted(self, vehicle_id: AgentId, lane_id: str) -> bool:
        """Whether a vehicle may use a lane, by its class from before it was taken."""
        own = self._class.get(vehicle_id) or str(self._api.vehicle.getVehicleClass(vehicle_id))
        allowed = self._api.lane.getAllowed(lane_id)
        return (not allowed or own in allowed) and own not in self._api.lane.getDisallowed(lane_id)

    def lane_cost(self, vehicle_id: AgentId, lane_id: str, route: Collection[str]) -> float | None:
        """Of a lane on a vehicle's way back: see `ownership.NextOwner`; its route comes first."""
        if not self.permitted(vehicle_id, lane_id):
            return None
        on_route = lane_id.startswith(":") or lane_id.rpartition("_")[0] in route
        return 0.0 if on_route else _OFF_ROUTE_COSTS_M

    def lose(self, vehicle_id: AgentId) -> None:
        """The vehicle has left the road; if SUMO brings it back, SUMO drives it."""
        if vehicle_id in self._class or vehicle_id in self._length_m:
            self._lost.add(vehicle_id)

    def after_step(self) -> None:
        """Restore the lateral speed of the vehicle, and the class of those that are back."""
        if not self._hurried and not self._lost:
            return
        there = self._api.vehicle.getIDList()
        for vehicle_id in self._lost.intersection(there):
            self._lost.remove(vehicle_id)
            self.give_back(vehicle_id)
        for vehicle_id, speed_mps in self._hurried.items():
            if vehicle_id in there:
                self._api.vehicle.setMaxSpeedLat(vehicle_id, speed_mps)
        self._hurried.clear()


@dataclass(slots=True, kw_only=True)
class _Taken:
    agent: AgentId
    length_m: float
    route: tuple[str, ...]
    stops: bool
    made: bool
    rides: bool
    pose: Pose


class Takeover:
    """The vehicles and persons that a policy drives in SUMO.

    Args:
        api: a running SUMO.
        events: notes are added to it.
        leaves: whether a vehicle that is placed beyond the end of the network is taken off the
            road, as SUMO does with its own.
        footways: of the network, where persons are moved.
    """

    def __init__(
        self,
        api: SumoApi,
        events: list[Event],
        *,
        leaves: bool = False,
        footways: Callable[[], Footways] = no_footways,
    ) -> None:
        self._api = api
        self._events = events
        self._leaves = leaves
        self._ends = NetworkEnds(api)
        self._own_way = OwnWay(api)
        self._footways = cache(footways)
        self._hand_over = HandOver(api, self._footways)
        self._taken: dict[AgentId, _Taken] = {}
        self._gone: set[AgentId] = set()
        self._step = 0
        self.persons = PersonControl(api, self._footways, self._note_now)

    def placed(self) -> dict[AgentId, Pose]:
        """Those that SUMO does not drive, and where they were put in the last step."""
        vehicles = {agent: taken.pose for agent, taken in self._taken.items()}
        return vehicles | self.persons.placed()

    def place(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put a road user at the pose at the end of the coming step, or take it off the road."""
        self._step = step
        if not self._present(step, agent):
            return
        if agent_ids.person_of(agent) is not None:
            self.persons.place(agent, pose, length_m)
            return
        if self._leaves and self._ends.passed(agent, pose, length_m):
            self._api.vehicle.remove(agent, _ARRIVED)
            self._gone.add(agent)
            self._note(step, agent, "opponent_gone", "it left where the network ends")
            return
        if agent not in self._taken:
            self._taken[agent] = self._take(step, agent, pose, length_m)
        taken = self._taken[agent]
        taken.pose = pose
        self._hand_over.fit(agent, pose, length_m)
        seen = taken.rides and self._on_street(agent, pose, length_m)
        on_route = taken.stops or self._on_its_way(taken, pose)
        move(self._api, agent, pose, length_m, MATCH_M, on_route=on_route, any_lane=seen)

    def _on_its_way(self, taken: _Taken, pose: Pose) -> bool:
        """Whether it is on its route, from which SUMO has not taken it yet."""
        if taken.rides or taken.made:
            return False
        if tuple(self._api.vehicle.getRoute(taken.agent)) != taken.route:
            return False
        place = pose.x_m, pose.y_m
        front, _ = frames.to_sumo(place, pose.heading_rad, taken.length_m)
        return self._own_way.has(taken.agent, front, pose.heading_rad)

    def _take(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> _Taken:
        route = tuple(self._api.vehicle.getRoute(agent))
        stops = has_stops(self._api, agent)
        if stops:
            detail = "it has stops, so SUMO's vehicles see it on its own route alone"
            self._note(step, agent, "seen_on_route", detail)
        made = str(self._api.vehicle.getTypeID(agent)).startswith(MADE_TYPE)
        rides = not made and kind_of(str(self._api.vehicle.getVehicleClass(agent))) == "cyclist"
        self._hand_over.take(agent)
        return _Taken(
            agent=agent, length_m=length_m, route=route, stops=stops, made=made, rides=rides,
            pose=pose,
        )  # fmt: skip

    def after_step(self) -> None:
        """Tell SUMO the speeds, which it would otherwise derive from how far `moveToXY` moved."""
        self._hand_over.after_step()
        self.persons.after_step()
        there = self._api.vehicle.getIDList()
        for agent, taken in list(self._taken.items()):
            if agent in there:
                self._api.vehicle.setPreviousSpeed(agent, max(taken.pose.speed_mps, 0.0))
            else:
                self._hand_over.lose(agent)
                del self._taken[agent]  # if SUMO brings it back, it is somewhere else

    def drivable(self, agent: AgentId, occupancy: Occupancy) -> bool:
        """Whether SUMO can drive a road user on from its pose without moving or turning it.

        Without its sublane model SUMO keeps a vehicle off-centre for ever, where it reaches into
        the next lane unseen, and stops it for good inside a junction under `lanechange.duration`.
        It may overlap the AV: SUMO separates the two.
        """
        if agent_ids.person_of(agent) is not None:
            return self.persons.drivable(agent)
        taken, vehicle = self._taken.get(agent), self._api.vehicle
        if taken is None or agent not in vehicle.getIDList():
            return True  # it is SUMO's already, or gone
        lane_id = vehicle.getLaneID(agent)
        if not lane_id or not self._hand_over.permitted(agent, lane_id) or occupancy.touched(agent):
            return False
        lane = np.array(self._api.lane.getShape(lane_id), float)[:, :2]
        at = np.array([taken.pose.x_m, taken.pose.y_m])
        along = float(polylines.project(lane, at).heading_rad)
        if abs(float(frames.difference(along, taken.pose.heading_rad))) > _ASKEW_RAD:
            return False
        sublane = float(self._api.simulation.getOption("lateral-resolution")) > 0
        return sublane or abs(vehicle.getLateralLanePosition(agent)) <= _BESIDE_M

    def lane_cost(self, agent: AgentId, lane_id: str) -> float | None:
        """See `ownership.NextOwner`: lanes of its class, and those of its route before others."""
        taken = self._taken.get(agent)
        if taken is None:
            return None
        cost = self._hand_over.lane_cost(agent, lane_id, taken.route)
        return None if cost and taken.stops else cost

    def forget(self) -> None:
        """SUMO has loaded another state: it drives all vehicles from where they are in it."""
        there = self._api.vehicle.getIDList()
        for agent in [agent for agent in self._taken if agent in there]:
            self._hand_over.give_back(agent)
        self._taken.clear()
        self.persons.forget()

    def hand_back(self, step: int, agent: AgentId) -> None:
        """Let SUMO drive one from the coming step on: from where it is, if it is `drivable`.

        Off every lane SUMO drives nothing. There a vehicle is taken off the road if it ``leaves``;
        else it is put on the nearest lane. So is a person where there is no footway.
        """
        self._step = step
        if agent_ids.person_of(agent) is not None:
            self.persons.hand_back(agent, leaves=self._leaves)
            return
        taken = self._taken.pop(agent, None)
        if taken is None or not self._present(step, agent):
            return
        vehicle = self._api.vehicle
        self._hand_over.give_back(agent)
        lane_id = vehicle.getLaneID(agent)
        if lane_id and self._hand_over.permitted(agent, lane_id):
            self._note(step, agent, "handed_back", "SUMO drives on along the route")
            self._restore_route(step, taken)
            return
        if self._leaves:
            vehicle.remove(agent)
            self._note(step, agent, "removed", "it stands where SUMO drives no vehicle")
            return
        x, y = vehicle.getPosition(agent)
        keep = _SNAP_TO_ROUTE if taken.stops else _SNAP_TO_LANE
        vehicle.moveToXY(agent, "", -1, x, y, vehicle.getAngle(agent), keep, _SNAP_M)
        self._note(step, agent, "handed_back", "put on the nearest lane, where SUMO drives on")

    def _restore_route(self, step: int, taken: _Taken) -> None:
        """Send a vehicle that has left its route to its destination."""
        if tuple(self._api.vehicle.getRoute(taken.agent)) == taken.route:
            return
        try:
            self._api.vehicle.changeTarget(taken.agent, taken.route[-1])
        except self._api.TraCIException:
            detail = f"no way back to its destination {taken.route[-1]}"
            self._note(step, taken.agent, "route_lost", detail)

    def _on_street(self, agent: AgentId, pose: Pose, length_m: float) -> bool:
        """Whether a bicycle may belong to a lane of another class there.

        Inside junctions and at walking areas SUMO would crash.
        """
        front, _ = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
        z_m = float(self._api.vehicle.getPosition3D(agent)[2])  # poses of plans have none
        return self._footways().on_street(front, z_m)

    def _note(self, step: int, agent: AgentId, kind: str, detail: str) -> None:
        self._events.append(Event(step=step, agent_id=agent, kind=kind, detail=detail))

    def _note_now(self, agent: AgentId, kind: str, detail: str) -> None:
        self._note(self._step, agent, kind, detail)

    def _present(self, step: int, agent: AgentId) -> bool:
        if agent_ids.person_of(agent) is None:
            present = agent in self._api.vehicle.getIDList()
        else:
            present = self.persons.present(agent)
        if not present and agent not in self._gone:
            self._gone.add(agent)
            self._note(step, agent, "opponent_gone", "left the traffic")
        return present


class SumoOwner:
    """SUMO as the next owner of those that were taken over; see `ownership.NextOwner`.

    Args:
        takeover: of vehicles and persons.
        occupancy: the agents around a vehicle now.
        made: road users that leave the road by themselves, from wherever they are.
    """

    def __init__(
        self,
        takeover: Takeover,
        occupancy: Callable[[AgentId], Occupancy],
        made: Collection[AgentId] = (),
    ) -> None:
        self._takeover, self._occupancy, self._made = takeover, occupancy, made

    def creep_mps(self, agent: AgentId) -> float:
        """Creeping speed of a vehicle that turns onto a lane; walking speed of a person."""
        return CREEP_MPS if agent_ids.person_of(agent) is None else WALK_MPS

    def takes(self, agent: AgentId, step: int, pose: Pose) -> bool:  # noqa: ARG002
        """Whether SUMO can drive the agent on from where it is."""
        return agent in self._made or self._takeover.drivable(agent, self._occupancy(agent))

    def clear(self, agent: AgentId, poses: Sequence[Pose]) -> bool:
        """Whether nothing is in the way of the agent; people on foot make way for each other."""
        occupancy = self._occupancy(agent)
        if agent_ids.person_of(agent) is not None:
            occupancy = occupancy.without_persons(agent)
        return occupancy.clear(agent, poses)

    def lane_cost(self, agent: AgentId, lane_id: str) -> float | None:
        """Lanes of its class; those of its route before others."""
        return self._takeover.lane_cost(agent, lane_id)

    def walk(self, agent: AgentId, pose: Pose) -> Walk | None:
        """Of persons: to the nearest footway."""
        return (
            None if agent_ids.person_of(agent) is None else self._takeover.persons.walk(agent, pose)
        )

    def refusals(self, agents: Collection[AgentId]) -> dict[AgentId, str]:
        """Persons that do not walk, and all of them where SUMO's model of persons ignores it."""
        persons = self._takeover.persons
        found = {
            agent: persons.refusal(agent)
            for agent in agents
            if agent_ids.person_of(agent) is not None and persons.present(agent)
        }
        return {agent: reason for agent, reason in found.items() if reason}
