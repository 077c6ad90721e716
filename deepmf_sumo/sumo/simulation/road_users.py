"""Who is on the road in a running SUMO: its vehicles on the road, and its persons on foot.

A person in a vehicle is no road user, and neither is a vehicle that SUMO is moving elsewhere (a
teleport). Containers are none at all: SUMO has them at stops and in vehicles. Persons who wait at a
stop are on foot.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from deepmf_sumo.scene import AgentId, AgentKind, Floats, agent_ids
from deepmf_sumo.sumo.network.sumo_net import OTHER_VEHICLES, RAIL_VEHICLES
from deepmf_sumo.sumo.simulation.frame import Body, Frame
from deepmf_sumo.sumo.simulation.long_vehicles import LongVehicles, State
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi, asking

_KINDS: Final[Mapping[str, AgentKind]] = {
    **dict.fromkeys(("bicycle", "scooter"), "cyclist"),
    **dict.fromkeys(("pedestrian", "wheelchair"), "pedestrian"),
    **dict.fromkeys((*RAIL_VEHICLES, *OTHER_VEHICLES), "other"),
}
"""Kinds of SUMO's vehicle classes; all others are vehicles. ``other`` never attacks."""
_NOWHERE_M: Final = -1e8
"""Coordinates below are SUMO's way to say that a vehicle is not on the road."""


def kind_of(vehicle_class: str) -> AgentKind:
    """The kind of SUMO's vehicles of a class; ``other`` on rails, on water and in the air."""
    return _KINDS.get(vehicle_class, "vehicle")


def somewhere(position_m: Sequence[float]) -> bool:
    """Whether a position that SUMO states is one: that of a vehicle in a teleport is not."""
    return min(position_m[0], position_m[1]) > _NOWHERE_M


def on_foot(vehicle: str) -> bool:
    """Whether a person is, by the vehicle that SUMO states for it."""
    return not vehicle


class Bodies:
    """Kinds and sizes of the agents of a running SUMO, which is asked once for each.

    Args:
        api: a running SUMO.
        av_id: is one box, of whatever length; None: no vehicle is the AV.

    Attributes:
        bent: the vehicles that are several boxes (`long_vehicles`). They and their parts are of the
            kind ``other``: a policy could not drive them.
    """

    def __init__(self, api: SumoApi, av_id: AgentId | None = None) -> None:
        self._api, self._av = api, av_id
        self._known: dict[AgentId, Body] = {}
        self.bent: set[AgentId] = set()
        self.long = LongVehicles(api)

    def __getitem__(self, agent: AgentId) -> Body:
        """Of an agent that has been asked for; raises KeyError for others."""
        return self._known[agent]

    def declare(self, agent: AgentId, body: Body) -> None:
        """What an agent is, whatever its class in SUMO says: a made person is a vehicle there."""
        self._known[agent] = body

    def unknown(self, states: Mapping[AgentId, Any]) -> set[AgentId]:
        """Those agents that have not been asked for."""
        return states.keys() - self._known.keys()

    def ask(self, agent: AgentId) -> Body:
        """Of an agent that is present, or has been asked for before."""
        body = self._known.get(agent)
        if body is None:
            person = agent_ids.person_of(agent)
            domain = self._api.vehicle if person is None else self._api.person
            name = agent if person is None else person
            size = (domain.getLength(name), domain.getWidth(name), domain.getHeight(name))
            permission = str(domain.getVehicleClass(name))
            kind = kind_of(permission) if person is None else "pedestrian"
            length, width, height = (float(value) for value in size)
            body = self._known[agent] = Body(kind=kind, size_m=(length, width, height))
            if person is None and agent != self._av:
                self._bend(agent, width, height)
        return self._known[agent]

    def _bend(self, agent: AgentId, width: float, height: float) -> None:
        """Make the boxes of a vehicle that bends known."""
        for number, length in enumerate(self.long.lengths_m(agent), 1):
            self.bent.add(agent)
            part = agent if number == 1 else agent_ids.of_part(agent, number)
            self._known[part] = Body(kind="other", size_m=(length, width, height))

    def stiffened(self) -> str:
        """What to say of an AV that SUMO would let bend; empty for another one."""
        count = len(self.long.lengths_m(self._av)) if self._av is not None else 0
        return f"a vehicle of {count} carriages in SUMO is one stiff box here" if count else ""

    def sizes_m(self, listed: Sequence[AgentId]) -> Floats:
        """(N, 2) length and width."""
        known = self._known
        return np.array([known[one].size_m for one in listed]).reshape(-1, 3)[:, :2]


class TrafficReader:
    """All road users of a running SUMO; ``av_id``: see `Bodies`."""

    def __init__(self, api: SumoApi, av_id: AgentId | None = None) -> None:
        self._api = api
        self._agents: dict[str, AgentId] = {}
        self._lengths: tuple[list[AgentId], Floats] = [], np.zeros(0)
        self._vehicles, self._persons = asking(api, "vehicle"), asking(api, "person")
        self.bodies = Bodies(api, av_id)

    def body(self, agent: AgentId) -> Body:
        """Kind and size; raises KeyError for an agent that was never read."""
        return self.bodies[agent]

    def read(self) -> Frame:
        """All road users, vehicles before persons, sorted by id; parts follow their vehicle."""
        states = self.states()
        ids = list(states)
        if ids != self._lengths[0]:  # mostly those of the last step
            self._lengths = ids, self.bodies.sizes_m(ids)[:, 0]
        return Frame.of_sumo(ids, list(states.values()), self._lengths[1])

    def states(self) -> dict[AgentId, State]:
        """As `read`, in SUMO's terms: for a reader of many steps, which converts all together."""
        states: dict[AgentId, State] = {}
        ask = self._vehicles
        for name in sorted(self._api.vehicle.getIDList()):
            x_m, y_m, z_m = ask.position(name)
            if x_m > _NOWHERE_M and y_m > _NOWHERE_M:
                speed_mps = ask.speed(name)  # far below 0 where SUMO has none yet
                states[name] = (
                    x_m, y_m, ask.angle(name), speed_mps if speed_mps > 0 else 0.0, z_m
                )  # fmt: skip
        self._read_persons(states)
        bodies = self.bodies
        for agent in sorted(bodies.unknown(states)):
            bodies.ask(agent)
        return self._with_boxes(states) if not bodies.bent.isdisjoint(states) else states

    def _read_persons(self, states: dict[AgentId, State]) -> None:
        """Add the persons on foot."""
        ask, agents = self._persons, self._agents
        for name in sorted(self._api.person.getIDList()):
            if ask.rides_in(name):
                continue
            x_m, y_m, z_m = ask.position(name)
            if x_m > _NOWHERE_M and y_m > _NOWHERE_M:
                agent = agents.get(name)
                if agent is None:
                    agent = agents[name] = agent_ids.of_person(name)
                speed_mps = ask.speed(name)
                states[agent] = (
                    x_m, y_m, ask.angle(name), speed_mps if speed_mps > 0 else 0.0, z_m
                )  # fmt: skip

    def _with_boxes(self, states: dict[AgentId, State]) -> dict[AgentId, State]:
        """The same, with all boxes of vehicles that bend."""
        bodies = self.bodies
        found: dict[AgentId, State] = {}
        for agent, state in states.items():
            found |= bodies.long.boxes(agent, state) if agent in bodies.bent else {agent: state}
        return found
