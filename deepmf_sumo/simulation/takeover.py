"""Takes a vehicle of SUMO's traffic over, and hands it back onto its route."""

from dataclasses import dataclass

from deepmf_sumo.datatypes import AgentId, Event
from deepmf_sumo.simulation.av import move
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.sumo_api import SumoApi

_MATCH_M = 5.0
_SNAP_TO_LANE = 0  # keepRoute: the nearest lane
_SNAP_M = 100.0


@dataclass(slots=True, kw_only=True)
class _Taken:
    agent: AgentId
    length_m: float
    route: tuple[str, ...]
    pose: Pose


class Takeover:
    """The one vehicle that a policy drives in SUMO's traffic."""

    def __init__(self, api: SumoApi, events: list[Event]) -> None:
        self._api = api
        self._events = events
        self._taken: _Taken | None = None
        self._gone = False

    def placed(self) -> tuple[AgentId, Pose] | None:
        """The vehicle and where it was put in the last step; None while SUMO drives."""
        taken = self._taken
        return None if taken is None else (taken.agent, taken.pose)

    def place(self, step: int, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put the vehicle there at the end of the coming step."""
        if not self._present(step, agent):
            return
        if self._taken is None:
            route = tuple(self._api.vehicle.getRoute(agent))
            self._taken = _Taken(agent=agent, length_m=length_m, route=route, pose=pose)
        self._taken.pose = pose
        move(self._api, agent, pose, length_m, _MATCH_M)

    def after_step(self) -> None:
        """Tell SUMO the speed: it would otherwise be that of the jump, cut to what it allows."""
        taken = self._taken
        if taken is not None and taken.agent in self._api.vehicle.getIDList():
            self._api.vehicle.setPreviousSpeed(taken.agent, taken.pose.speed_mps)

    def hand_back(self, step: int, agent: AgentId) -> None:
        """From the coming step on SUMO drives; one beside the road is put on a lane."""
        taken = self._taken
        if taken is None or not self._present(step, agent):
            return
        self._taken = None
        vehicle = self._api.vehicle
        detail = "SUMO drives on along the route"
        if not vehicle.getLaneID(agent):
            x, y = vehicle.getPosition(agent)
            vehicle.moveToXY(agent, "", -1, x, y, vehicle.getAngle(agent), _SNAP_TO_LANE, _SNAP_M)
            detail = "put on the nearest lane, where SUMO drives on"
        elif tuple(vehicle.getRoute(agent)) != taken.route:
            try:
                vehicle.changeTarget(agent, taken.route[-1])
            except self._api.TraCIException:
                detail = f"no way back to its destination {taken.route[-1]}"
        self._events.append(Event(step=step, agent_id=agent, kind="handed_back", detail=detail))

    def _present(self, step: int, agent: AgentId) -> bool:
        present = agent in self._api.vehicle.getIDList()
        if not present and not self._gone:
            self._gone = True
            self._events.append(
                Event(step=step, agent_id=agent, kind="opponent_gone", detail="left the traffic")
            )
        return present
