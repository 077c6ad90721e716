"""Sees who is near the AV in somebody else's simulation, at the price of one subscription.

The subscription is centred on a point of interest that follows the AV, and not on the AV: what SUMO
sends goes to all of its clients, and the results of the user's own subscriptions around the AV
would hold what was never asked for.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, AgentKind, Driver, Floats
from deepmf_sumo.geometry import frames
from deepmf_sumo.live.connection import LiveApi
from deepmf_sumo.simulation.frame import Body, Frame, Pose

POSITION, ANGLE, SPEED = 0x39, 0x43, 0x40
"""TraCI's numbers of the variables: front bumper x, y, z (m), degrees clockwise from north, m/s."""
_VEHICLES, _PERSONS = 0xA4, 0xAE
"""TraCI's numbers of the domains."""
_INVISIBLE: Final = (0, 0, 0, 0)
_SLACK_M: Final = 10.0
"""So far the AV may go from the point before the point follows."""
_ASK_EVERY: Final = 20
"""Looks after which it is asked whether there are persons by now."""
_NOWHERE_M: Final = -1e8
"""Coordinates below are SUMO's way to say that a vehicle is not on the road."""

States = Mapping[AgentId, Mapping[int, Any]]


Circle = tuple[float, float, float, float, float]
"""Centre, velocity, radius."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Who was near the AV after a step, as SUMO says it."""

    vehicles: States
    persons: States


class Observer:
    """Everybody within a radius of the AV.

    Args:
        api: the simulation.
        av_id: the AV.
        radius_m: who is farther away is not seen.
    """

    def __init__(self, api: LiveApi, av_id: AgentId, radius_m: float) -> None:
        self._api = api
        self._av = av_id
        self._radius_m = radius_m + _SLACK_M
        # one each: a vehicle and a person may have the same id
        self._points = {
            _VEHICLES: f"deepmf_sumo vehicles near {av_id}",
            _PERSONS: f"deepmf_sumo persons near {av_id}",
        }
        self._subscribed: list[int] = []
        self._at: tuple[float, float] | None = None
        self._looks = 0
        self._bodies: dict[AgentId, Body] = {}

    def look(self) -> Sighting | None:
        """Who is there now; None where the AV is not."""
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
            for domain in self._subscribed:
                self._api.poi.setPosition(self._points[domain], x, y)
        return seen

    def position(self, agent: AgentId) -> tuple[float, float] | None:
        """Front bumper of a vehicle; None where it is not on the road."""
        vehicle = self._api.vehicle
        if agent not in vehicle.getIDList():
            return None
        x, y = vehicle.getPosition(agent)[:2]
        return (float(x), float(y)) if min(x, y) > _NOWHERE_M else None

    def body(self, agent: AgentId) -> Body:
        """Kind and size; raises KeyError for an agent that is in no frame."""
        return self._bodies[agent]

    def sizes_m(self, ids: list[AgentId]) -> Floats:
        """(N, 2) length and width."""
        return np.array([self._bodies[one].size_m[:2] for one in ids]).reshape(-1, 2)

    def pose(self, sighting: Sighting, agent: AgentId) -> Pose:
        """Where a vehicle of a sighting is."""
        state = sighting.vehicles[agent]
        length = self._body(agent, person=False).size_m[0]
        centre, heading = frames.from_sumo(state[POSITION][:2], state[ANGLE], length)
        return Pose(
            x_m=float(centre[0]),
            y_m=float(centre[1]),
            heading_rad=float(heading),
            speed_mps=max(0.0, float(state[SPEED])),
            z_m=float(state[POSITION][2]),
        )

    def may_touch(self, sighting: Sighting, within_s: float) -> bool:
        """Whether circles around the AV and anybody else meet within a time, if all go straight on.

        In plain numbers: it is asked every 0.1 s, and mostly says no.
        """
        me = self._circle(sighting.vehicles[self._av], self._body(self._av, person=False))
        for group in (sighting.vehicles, sighting.persons):
            for name, state in group.items():
                person = group is sighting.persons
                if name == self._av or not self._known(name, person=person):
                    continue
                other = self._circle(state, self._body(name, person=person))
                if _meeting_s(me, other) <= within_s:
                    return True
        return False

    def frame(self, sighting: Sighting, placed: dict[AgentId, tuple[Pose, Driver]]) -> Frame:
        """A sighting in our terms; who is ``placed`` is where it was put, whatever SUMO says."""
        vehicles, persons = sighting.vehicles, sighting.persons
        states = {**persons, **vehicles}
        for name in placed:
            self._body(name, person=False)
        ids = [
            name
            for name in sorted(states)
            if name not in placed and self._known(name, person=name not in vehicles)
        ]
        table = np.array(
            [(*states[name][POSITION], states[name][ANGLE], states[name][SPEED]) for name in ids]
        ).reshape(-1, 5)
        centre, heading = frames.from_sumo(table[:, :2], table[:, 3], self.sizes_m(ids)[:, 0])
        speed = np.maximum(table[:, 4:], 0.0)
        frame = Frame(
            ids=ids,
            position_m=centre,
            z_m=table[:, 2],
            heading_rad=heading,
            velocity_mps=speed * frames.unit(heading),
            driver=np.full(len(ids), int(Driver.SUMO), np.uint8),
        )
        shown = {
            name: (replace(pose, z_m=float(states[name][POSITION][2])), driver)
            if name in states
            else (pose, driver)
            for name, (pose, driver) in placed.items()
        }
        return frame.with_poses(shown) if shown else frame

    def around(self, at: tuple[float, float], radius_m: float) -> Sighting:
        """Who is near any point now: asked once, at the price of a few messages."""
        poi, point = self._api.poi, f"deepmf_sumo place of {self._av}"
        poi.add(point, *at, _INVISIBLE)
        try:
            seen: list[States] = []
            for domain in (_VEHICLES, _PERSONS):
                poi.subscribeContext(point, domain, radius_m, [POSITION, ANGLE, SPEED])
                seen.append(dict(poi.getContextSubscriptionResults(point)))
                poi.unsubscribeContext(point, domain, radius_m)
        finally:
            poi.remove(point)
        return Sighting(*seen)

    def close(self) -> None:
        """Take the subscription and its point away again."""
        for domain in self._subscribed:
            point = self._points[domain]
            self._api.poi.unsubscribeContext(point, domain, self._radius_m)
            self._api.poi.remove(point)
        self._subscribed = []
        self._at = None

    def _find(self) -> Sighting | None:
        """Look for the AV anywhere, and see who is around it."""
        at = self.position(self._av)
        if at is None:
            return None
        self._body(self._av, person=False)  # now, for the script may remove it before we ask again
        poi = self._api.poi
        for domain in [_VEHICLES, _PERSONS] if self._api.person.getIDCount() else [_VEHICLES]:
            point = self._points[domain]
            if domain in self._subscribed:
                poi.setPosition(point, *at)
            else:
                poi.add(point, *at, _INVISIBLE)
                self._subscribed.append(domain)
            # answered at once
            poi.subscribeContext(point, domain, self._radius_m, [POSITION, ANGLE, SPEED])
        self._at = at
        seen = self._seen()
        if self._av not in seen.vehicles:  # off every lane, where SUMO's search does not find it
            vehicle = self._api.vehicle
            angle, speed = vehicle.getAngle(self._av), vehicle.getSpeed(self._av)
            own = {POSITION: vehicle.getPosition3D(self._av), ANGLE: angle, SPEED: speed}
            seen = Sighting({**seen.vehicles, self._av: own}, seen.persons)
        return seen

    def _persons_came(self) -> bool:
        """Whether there are persons, whom nobody has looked for yet: each subscription costs."""
        return (
            _PERSONS not in self._subscribed
            and self._looks % _ASK_EVERY == 0
            and self._api.person.getIDCount() > 0
        )

    def _seen(self) -> Sighting:
        results = self._api.poi.getContextSubscriptionResults
        persons = results(self._points[_PERSONS]) if _PERSONS in self._subscribed else {}
        return Sighting(results(self._points[_VEHICLES]), persons)

    @staticmethod
    def _circle(state: Mapping[int, Any], body: Body) -> Circle:
        """Around the box."""
        length, width, _ = body.size_m
        heading, speed = math.radians(90.0 - state[ANGLE]), state[SPEED]
        ahead, left = math.cos(heading), math.sin(heading)
        x, y = state[POSITION][0] - length / 2 * ahead, state[POSITION][1] - length / 2 * left
        return x, y, speed * ahead, speed * left, math.hypot(length, width) / 2

    def _known(self, name: AgentId, *, person: bool) -> bool:
        """Whether it is known what an agent is: one that has left since cannot be asked."""
        try:
            self._body(name, person=person)
        except self._api.TraCIException:
            return False
        return True

    def _body(self, name: AgentId, *, person: bool) -> Body:
        if name not in self._bodies:
            domain = self._api.person if person else self._api.vehicle
            kind: AgentKind = "pedestrian" if person else "vehicle"
            if not person and domain.getVehicleClass(name) == "bicycle":
                kind = "cyclist"
            size = (domain.getLength(name), domain.getWidth(name), domain.getHeight(name))
            length, width, height = (float(value) for value in size)
            self._bodies[name] = Body(kind=kind, size_m=(length, width, height))
        return self._bodies[name]


def _meeting_s(a: Circle, b: Circle) -> float:
    """Seconds until two circles touch at constant velocity; inf where they never do, 0 if now."""
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
