"""Vehicles of the recording that SUMO drives on from where the recording has them first."""

from deepmf_sumo.datatypes import AgentId, Driver, Event, Tracks
from deepmf_sumo.simulation.av import read_pose
from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.lane_change import ShownMotion
from deepmf_sumo.simulation.log import Log
from deepmf_sumo.simulation.placed import add_vehicle, move_logged, speed_factor
from deepmf_sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.simulation.vehicle_types import TRAFFIC_TYPE


class FreeTraffic:
    """Rows of the recording that SUMO drives.

    ``entered`` were SUMO's once; ``lost`` are those that the log has to drive.
    """

    def __init__(self, api: SumoApi, log: Log, tracks: Tracks, events: list[Event]) -> None:
        self._api = api
        self._log = log
        self._tracks = tracks
        self._events = events
        self._inside: set[int] = set()
        self._motions: dict[int, ShownMotion] = {}
        self._fresh: list[tuple[int, int]] = []
        self.lost: set[int] = {row for row in log.rows if row not in log.routes}
        self.entered: set[int] = set()

    def drives(self, row: int) -> bool:
        """Whether SUMO drives the agent now."""
        return row in self._inside

    def may_enter(self, row: int) -> bool:
        """Whether the agent was never SUMO's and can be; who has left does not come back."""
        return row not in self.lost and row not in self.entered

    def enter(self, row: int, step: int) -> None:
        """Insert the agent with its recorded state at a step."""
        name, vehicle = self._tracks.ids[row], self._api.vehicle
        try:
            add_vehicle(self._api, self._log, self._tracks, row, TRAFFIC_TYPE)
        except self._api.TraCIException as error:
            self.lost.add(row)
            detail = f"{str(error).strip()} Replayed from the log."
            self._events.append(Event(step=step, agent_id=name, kind="off_network", detail=detail))
            return
        fastest = float(self._tracks.speed_mps[row][self._tracks.valid[row]].max())
        vehicle.setSpeedFactor(name, speed_factor(self._api, self._log.routes[row], fastest))
        move_logged(self._api, self._log, name, row, step)
        self._inside.add(row)
        self.entered.add(row)
        self._motions[row] = ShownMotion(self._api, name, float(self._tracks.size_m[row, 0]))
        self._fresh.append((row, step))

    def after_step(self, step: int) -> None:
        """Give the new ones their speed; those that started off every lane are lost."""
        vehicle = self._api.vehicle
        there = set(vehicle.getIDList())
        for row, at in self._fresh:
            name = self._tracks.ids[row]
            if name in there and vehicle.getLaneID(name):
                vehicle.setPreviousSpeed(name, float(self._tracks.speed_mps[row, at]))
                continue
            self.lost.add(row)
            self._inside.discard(row)
            if name in there:
                vehicle.remove(name)
            detail = "starts on no lane; replayed from the log"
            self._events.append(Event(step=step, agent_id=name, kind="off_network", detail=detail))
        self._fresh.clear()
        self._inside = {row for row in self._inside if self._tracks.ids[row] in there}

    def read(self) -> dict[AgentId, tuple[Pose, Driver]]:
        """Where they are. To be asked once a step."""
        poses = {}
        for row in sorted(self._inside):
            name = self._tracks.ids[row]
            pose = read_pose(self._api, name, float(self._tracks.size_m[row, 0]))
            poses[name] = (self._motions[row].advance(pose), Driver.SUMO)
        return poses
