"""Reads SUMO's own traffic: who is there, what it is, where it is."""

from typing import Any

import numpy as np

from deepmf_sumo.datatypes import AgentId, AgentKind, Driver
from deepmf_sumo.geometry import sumo_frame
from deepmf_sumo.simulation.frame import Body, Pose
from deepmf_sumo.simulation.sumo_api import SumoApi


class TrafficReader:
    """Vehicles and persons of a running SUMO; what they are is asked once each."""

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._bodies: dict[AgentId, Body] = {}

    def body(self, agent: AgentId) -> Body:
        """Kind and size; raises KeyError for an agent that was never read."""
        return self._bodies[agent]

    def read(self) -> dict[AgentId, tuple[Pose, Driver]]:
        """Everybody who is there, vehicles before persons, sorted by id."""
        states = self.states()
        table = np.array(list(states.values())).reshape(-1, 5)
        lengths = np.array([self._bodies[name].size_m[0] for name in states])
        centres, headings = sumo_frame.from_sumo(table[:, :2], table[:, 2], lengths)
        rows = zip(states, centres.tolist(), headings.tolist(), table[:, 3:].tolist(), strict=True)
        return {
            name: (Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed, z_m=z), Driver.SUMO)
            for name, (x, y), heading, (speed, z) in rows
        }

    def states(self) -> dict[AgentId, tuple[float, float, float, float, float]]:
        """As ``read``, in SUMO's terms: front bumper x, y (m), angle (degrees), speed (m/s), z (m).

        For who reads thousands of steps, and converts them all at once.
        """
        vehicle, person = self._api.vehicle, self._api.person
        everybody = [(vehicle, name) for name in sorted(vehicle.getIDList())]
        everybody += [(person, name) for name in sorted(person.getIDList())]
        states = {}
        for domain, name in everybody:
            if name not in self._bodies:
                self._bodies[name] = self._ask_body(domain, name)
            x_m, y_m, z_m = domain.getPosition3D(name)
            # of the order of -1e9 while a vehicle is not on the road
            speed_mps = max(0.0, domain.getSpeed(name))
            states[str(name)] = (x_m, y_m, domain.getAngle(name), speed_mps, z_m)
        return states

    def _ask_body(self, domain: Any, name: AgentId) -> Body:
        api = self._api
        size = (domain.getLength(name), domain.getWidth(name), domain.getHeight(name))
        kind: AgentKind = "vehicle"
        if domain is api.person:
            kind = "pedestrian"
        elif domain.getVehicleClass(name) == "bicycle":
            kind = "cyclist"
        return Body(kind=kind, size_m=(float(size[0]), float(size[1]), float(size[2])))
