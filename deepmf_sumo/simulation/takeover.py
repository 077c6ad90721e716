"""Takes a vehicle of SUMO's traffic over, and hands it back onto its route."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Event, Floats
from deepmf_sumo.geometry import sumo_frame
from deepmf_sumo.simulation.av import move
from deepmf_sumo.simulation.frame import Frame, Pose
from deepmf_sumo.simulation.lane_change import LaneChangeEnd
from deepmf_sumo.simulation.places import Place, Places, overlapped
from deepmf_sumo.simulation.sumo_api import SumoApi

_MATCH_M = 5.0
_EXACT = 2  # keepRoute: exactly where it is put
_SNAP_TO_LANE = 0  # keepRoute: the nearest lane
_SNAP_M = 100.0
_BESIDE_M: Final = 0.1
_ASKEW_RAD: Final = np.radians(60.0)


@dataclass(slots=True, kw_only=True)
class _Taken:
    agent: AgentId
    length_m: float
    route: tuple[str, ...]
    pose: Pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crowd:
    """Everybody who is there, and who of them is the AV; ``size_m`` (N, 2) lengths and widths."""

    frame: Frame
    size_m: Floats
    av_id: AgentId


class Takeover:
    """The one vehicle that a policy drives in SUMO's traffic.

    Args:
        api: a running SUMO.
        events: notes are added to it.
        places: where a vehicle can be put that SUMO cannot drive from where it is; None: the
            nearest lane, whoever is there.
        may_remove: whether one for which no place is free is taken out of the simulation; else it
            is put on the nearest lane.
    """

    def __init__(
        self,
        api: SumoApi,
        events: list[Event],
        places: Places | None = None,
        *,
        may_remove: bool = True,
    ) -> None:
        self._api = api
        self._events = events
        self._places = places
        self._may_remove = may_remove
        self._lane_change = LaneChangeEnd(api)
        self._taken: _Taken | None = None
        self._moved: tuple[_Taken, float] | None = None
        self._gone: set[AgentId] = set()

    def placed(self) -> tuple[AgentId, Pose] | None:
        """The vehicle and where it was put in the last step; None while SUMO drives."""
        taken = self._taken
        return None if taken is None else (taken.agent, taken.pose)

    def place(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put the vehicle there at the end of the coming step."""
        if not self._present(step, agent):
            return
        if self._taken is None or self._taken.agent != agent:  # the last one may have left
            route = tuple(self._api.vehicle.getRoute(agent))
            self._taken = _Taken(agent=agent, length_m=length_m, route=route, pose=pose)
            self._lane_change.end(agent)
        self._taken.pose = pose
        move(self._api, agent, pose, length_m, _MATCH_M)

    def after_step(self, step: int) -> None:
        """Tell SUMO the speed: it would otherwise be that of the jump, cut to what it allows."""
        self._lane_change.after_step()
        there = self._api.vehicle.getIDList()
        if self._taken is not None and self._taken.agent in there:
            self._api.vehicle.setPreviousSpeed(self._taken.agent, self._taken.pose.speed_mps)
        else:
            self._taken = None  # should SUMO bring it back, it is not where it was put
        if self._moved is not None and self._moved[0].agent in there:
            taken, speed_mps = self._moved
            self._api.vehicle.setPreviousSpeed(taken.agent, speed_mps)
            self._find_way(step, taken)
        self._moved = None

    def hand_back(self, step: int, agent: AgentId, crowd: Crowd | None = None) -> None:
        """From the coming step on SUMO drives.

        One from where SUMO cannot go on is put on a lane: beside the middle of one, against its
        direction, or in the midst of others (but the AV: SUMO parts two). Where no place is free
        near by it is taken out of the simulation, if that is allowed.

        Args:
            step: now.
            agent: the vehicle.
            crowd: who is where, needed where there are `Places`; without the vehicle if it is on
                no road, because SUMO teleports it.
        """
        taken = self._taken
        if taken is None or not self._present(step, agent):
            return
        self._taken = None
        if self._places is None:
            self._hand_to_nearest_lane(step, taken)
        elif crowd is None or agent not in crowd.frame.ids:
            self._note(step, agent, "opponent_gone", "SUMO has taken it off the road")
        elif self._drivable(taken, self._places, crowd):
            self._note(step, agent, "handed_back", "SUMO drives on along the route")
            self._find_way(step, taken)
        else:
            place = self._places.nearest(agent, crowd.frame, crowd.size_m, taken.route)
            if place is not None:
                self._put(step, taken, place)
            elif self._may_remove:
                self._api.vehicle.remove(agent)
                self._note(step, agent, "removed", "no free place on a lane within 50 m")
            else:
                self._hand_to_nearest_lane(step, taken)

    def _hand_to_nearest_lane(self, step: int, taken: _Taken) -> None:
        vehicle, agent = self._api.vehicle, taken.agent
        if vehicle.getLaneID(agent):
            self._note(step, agent, "handed_back", "SUMO drives on along the route")
            self._find_way(step, taken)
            return
        x, y = vehicle.getPosition(agent)
        vehicle.moveToXY(agent, "", -1, x, y, vehicle.getAngle(agent), _SNAP_TO_LANE, _SNAP_M)
        self._note(step, agent, "handed_back", "put on the nearest lane, where SUMO drives on")

    def _drivable(self, taken: _Taken, places: Places, crowd: Crowd) -> bool:
        """Whether SUMO can drive on from there.

        Without its sublane model SUMO keeps a distance to the middle of a lane for ever, reaches
        into the next lane unseen, and inside a junction stops for good under `lanechange.duration`.
        """
        vehicle, agent = self._api.vehicle, taken.agent
        lane_id = vehicle.getLaneID(agent)
        if not lane_id or overlapped(agent, crowd.frame, crowd.size_m, but=crowd.av_id):
            return False
        if places.askew_rad(lane_id, taken.pose) > _ASKEW_RAD:
            return False
        sublane = float(self._api.simulation.getOption("lateral-resolution")) > 0
        return sublane or abs(vehicle.getLateralLanePosition(agent)) <= _BESIDE_M

    def _put(self, step: int, taken: _Taken, place: Place) -> None:
        edge, _, lane = place.lane_id.rpartition("_")
        angle = float(sumo_frame.sumo_angle(place.heading_rad))
        x, y = place.front_m
        self._api.vehicle.moveToXY(taken.agent, edge, int(lane), x, y, angle, _EXACT, _MATCH_M)
        self._moved = taken, place.speed_mps
        detail = f"put on lane {place.lane_id}, {place.moved_m:.1f} m away, where SUMO drives on"
        self._note(step, taken.agent, "handed_back", detail)

    def _find_way(self, step: int, taken: _Taken) -> None:
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
