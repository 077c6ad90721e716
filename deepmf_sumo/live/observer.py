"""Reads the agents near the AV in a simulation of another program, by one subscription.

The subscription is centred on a point of interest that follows the AV, and not on the AV: what SUMO
sends goes to all of its clients, and the results of the user's own subscriptions around the AV
would contain values that were never asked for.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from deepmf_sumo.live import MARK
from deepmf_sumo.live.connection import LiveApi
from deepmf_sumo.scene import AgentId, Driver, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.sumo.simulation.road_users import Bodies, on_foot, somewhere

POSITION, ANGLE, SPEED = 0x39, 0x43, 0x40
"""TraCI's numbers of the variables: front bumper x, y, z (m), degrees clockwise from north, m/s."""
RIDES_IN: Final = 0xC3
"""The number of a person's vehicle."""
_VEHICLES, _PERSONS = 0xA4, 0xAE
"""TraCI's numbers of the domains."""
_VARIABLES: Final = {
    _VEHICLES: [POSITION, ANGLE, SPEED],
    _PERSONS: [POSITION, ANGLE, SPEED, RIDES_IN],
}
_INVISIBLE: Final = (0, 0, 0, 0)
_SLACK_M: Final = 10.0
"""Distance of the AV from the point at which the point follows."""
_ASK_EVERY: Final = 20
"""Number of looks after which it checks whether there are persons by now."""

States = Mapping[AgentId, Mapping[int, Any]]
Circle = tuple[float, float, float, float, float]
"""Centre, velocity, radius."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """The road users near the AV after a step, as SUMO states them; persons are those on foot."""

    vehicles: States
    persons: States

    def all(self) -> dict[AgentId, Mapping[int, Any]]:
        """Vehicles, then persons."""
        return {**self.vehicles, **self.persons}


def _on_foot(persons: Mapping[str, Mapping[int, Any]]) -> States:
    """The persons that are road users, by agent."""
    return {
        agent_ids.of_person(name): state
        for name, state in persons.items()
        if on_foot(state[RIDES_IN])
    }


class LiveObserver:
    """All agents within a radius of the AV.

    Args:
        api: the simulation.
        av_id: the AV.
        radius_m: agents farther away are not seen.

    Attributes:
        bodies: kinds and sizes of the agents in frames.
    """

    def __init__(self, api: LiveApi, av_id: AgentId, radius_m: float) -> None:
        self._api = api
        self._av = av_id
        self._radius_m = radius_m + _SLACK_M
        # one each: a vehicle and a person may have the same id
        self._points = {
            _VEHICLES: f"{MARK}vehicles near {av_id}",
            _PERSONS: f"{MARK}persons near {av_id}",
        }
        self._subscribed: list[int] = []
        self._at: tuple[float, float] | None = None
        self._looks = 0
        self.bodies = Bodies(api, av_id)

    def look(self) -> Sighting | None:
        """The agents that are present now; None if the AV is not."""
        self._looks += 1
        if self._at is None or self._persons_came():
            return self._find()
        seen = self._seen()
        state = seen.vehicles.get(self._av)
        if state is None:
            return self._find()
        x, y = state[POSITION][:2]
        if np.hypot(x - self._at[0], y - self._at[1]) > _SLACK_M:
            self._at = (x, y)
            points = [self._points[domain] for domain in self._subscribed]
            if not all(self._moved(point, self._at) for point in points):
                return self._find()
        return seen

    def position(self, agent: AgentId) -> tuple[float, float] | None:
        """Front of a vehicle, or of a person on foot; None if it is not on the road."""
        name = agent_ids.person_of(agent)
        domain = self._api.vehicle if name is None else self._api.person
        if (agent if name is None else name) not in domain.getIDList():
            return None
        if name is not None and not on_foot(domain.getVehicle(name)):
            return None
        x, y = domain.getPosition(agent if name is None else name)[:2]
        return (float(x), float(y)) if somewhere((x, y)) else None

    def pose(self, sighting: Sighting, agent: AgentId) -> Pose:
        """Pose of a vehicle of a sighting."""
        state = sighting.vehicles[agent]
        length = self.bodies.ask(agent).size_m[0]
        centre, heading = frames.from_sumo(state[POSITION][:2], state[ANGLE], length)
        return Pose(
            x_m=float(centre[0]),
            y_m=float(centre[1]),
            heading_rad=float(heading),
            speed_mps=max(0.0, float(state[SPEED])),
            z_m=float(state[POSITION][2]),
        )

    def may_touch(self, sighting: Sighting, within_s: float) -> bool:
        """Whether circles around the AV and another agent meet in time, if all go straight on.

        In plain numbers: it is called every 0.1 s, and mostly says no.
        """
        me = self._circle(sighting.vehicles[self._av], self.bodies.ask(self._av))
        for name, state in sighting.all().items():
            if name == self._av or not self._known(name):
                continue
            other = self._circle(state, self.bodies[name])
            if _meeting_s(me, other) <= within_s:
                return True
        return False

    def frame(self, sighting: Sighting, placed: dict[AgentId, tuple[Pose, Driver]]) -> Frame:
        """The frame of a sighting; ``placed`` agents are where they were put."""
        states = sighting.all()
        for name in placed:
            self.bodies.ask(name)
        ids = [name for name in sorted(states) if name not in placed and self._known(name)]
        rows = [
            (*state[POSITION][:2], state[ANGLE], max(state[SPEED], 0.0), state[POSITION][2])
            for state in (states[name] for name in ids)
        ]
        frame = Frame.of_sumo(ids, rows, self.bodies.sizes_m(ids)[:, 0])
        shown = {
            name: (replace(pose, z_m=float(states[name][POSITION][2])), driver)
            if name in states
            else (pose, driver)
            for name, (pose, driver) in placed.items()
        }
        return frame.with_poses(shown)

    def around(self, at: tuple[float, float], radius_m: float) -> Sighting:
        """The agents near any point now, read once by a few messages."""
        poi = self._api.poi
        seen: dict[int, States] = {}
        for domain, variables in _VARIABLES.items():
            point = f"{MARK}place {domain} of {self._av}"  # results of a point are by id alone
            poi.add(point, *at, _INVISIBLE)
            try:
                poi.subscribeContext(point, domain, radius_m, variables)
                seen[domain] = dict(poi.getContextSubscriptionResults(point))
                poi.unsubscribeContext(point, domain, radius_m)
            finally:
                poi.remove(point)
        return Sighting(self._boxes(seen[_VEHICLES]), _on_foot(seen[_PERSONS]))

    def keep(self) -> None:
        """Before a step: a script may have removed our points; SUMO 1.28 ends without them."""
        poi = self._api.poi
        for domain in self._subscribed:
            point = self._points[domain]
            try:
                poi.getType(point)
            except self._api.TraCIException:
                poi.add(point, *(self._at or (0.0, 0.0)), _INVISIBLE)
                poi.subscribeContext(point, domain, self._radius_m, _VARIABLES[domain])

    def forget(self) -> None:
        """SUMO has loaded another state, with its own agents, and without subscriptions."""
        there = self._api.poi.getIDList()
        for point in (self._points[domain] for domain in self._subscribed):
            if point in there:
                self._api.poi.remove(point)
        self._subscribed, self._at = [], None
        self.bodies = Bodies(self._api, self._av)

    def close(self) -> None:
        """Remove the subscription and its point."""
        for domain in self._subscribed:
            point = self._points[domain]
            with suppress(self._api.TraCIException):  # the script has removed it
                self._api.poi.unsubscribeContext(point, domain, self._radius_m)
            with suppress(self._api.TraCIException):
                self._api.poi.remove(point)
        self._subscribed = []
        self._at = None

    def _find(self) -> Sighting | None:
        """Look for the AV anywhere, and for the agents around it."""
        at = self.position(self._av)
        if at is None:
            return None
        self.bodies.ask(self._av)  # now: the script may remove it before the next question
        poi = self._api.poi
        for domain in [_VEHICLES, _PERSONS] if self._api.person.getIDCount() else [_VEHICLES]:
            point = self._points[domain]
            if domain not in self._subscribed or not self._moved(point, at):
                poi.add(point, *at, _INVISIBLE)
                self._subscribed = sorted({*self._subscribed, domain})
            # answered immediately
            poi.subscribeContext(point, domain, self._radius_m, _VARIABLES[domain])
        self._at = at
        seen = self._seen()
        if self._av not in seen.vehicles:  # off every lane, where SUMO's search does not find it
            vehicle = self._api.vehicle
            angle, speed = vehicle.getAngle(self._av), vehicle.getSpeed(self._av)
            own = {POSITION: vehicle.getPosition3D(self._av), ANGLE: angle, SPEED: speed}
            seen = Sighting({**seen.vehicles, self._av: own}, seen.persons)
        return seen

    def _moved(self, point: str, at: tuple[float, float]) -> bool:
        """Put one of our points there; False where the script has removed it."""
        try:
            self._api.poi.setPosition(point, *at)
        except self._api.TraCIException:
            return False
        return True

    def _persons_came(self) -> bool:
        """Whether there are persons that are not subscribed to yet: each subscription costs."""
        return (
            _PERSONS not in self._subscribed
            and self._looks % _ASK_EVERY == 0
            and self._api.person.getIDCount() > 0
        )

    def _seen(self) -> Sighting:
        results = self._api.poi.getContextSubscriptionResults
        persons = results(self._points[_PERSONS]) if _PERSONS in self._subscribed else {}
        return Sighting(self._boxes(results(self._points[_VEHICLES])), _on_foot(persons))

    def _boxes(self, vehicles: States) -> States:
        """The same, with all boxes of vehicles that bend."""
        bent = [name for name in vehicles if self._known(name) and name in self.bodies.bent]
        if not bent:
            return vehicles
        found = dict(vehicles)
        for name in bent:
            (x, y, z), angle = vehicles[name][POSITION], vehicles[name][ANGLE]
            boxes = self.bodies.long.boxes(name, (x, y, angle, vehicles[name][SPEED], z))
            found |= {
                agent: {POSITION: (one[0], one[1], one[4]), ANGLE: one[2], SPEED: one[3]}
                for agent, one in boxes.items()
            }
        return found

    @staticmethod
    def _circle(state: Mapping[int, Any], body: Body) -> Circle:
        """The circle around a box."""
        length, width, _ = body.size_m
        heading, speed = math.radians(90.0 - state[ANGLE]), state[SPEED]
        ahead, left = math.cos(heading), math.sin(heading)
        x, y = state[POSITION][0] - length / 2 * ahead, state[POSITION][1] - length / 2 * left
        return x, y, speed * ahead, speed * left, math.hypot(length, width) / 2

    def _known(self, name: AgentId) -> bool:
        """Whether kind and size of an agent are known: one that has left cannot be asked."""
        try:
            self.bodies.ask(name)
        except self._api.TraCIException:
            return False
        return True


def _meeting_s(a: Circle, b: Circle) -> float:
    """Seconds until two circles touch at constant velocity; inf if they never do, 0 if now."""
    x, y, u, v = (b[row] - a[row] for row in range(4))
    reach = a[4] + b[4]
    apart = x * x + y * y - reach * reach
    if apart <= 0.0:
        return 0.0
    closing, speed = -(x * u + y * v), u * u + v * v
    root = closing * closing - speed * apart
    if closing <= 0.0 or root < 0.0:
        return math.inf
    return apart / (closing + math.sqrt(root))
