"""What is read from SUMO in each step: vehicles, persons, and the lights of lanes."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import (
    AgentId,
    AgentKind,
    Floats,
    SignalLink,
    Signals,
    SignalState,
)
from deepmf_sumo.simulation.frame import Body, Frame
from deepmf_sumo.simulation.sumo_api import SumoApi

_KINDS: Final[Mapping[str, AgentKind]] = {
    **dict.fromkeys(("bicycle", "scooter"), "cyclist"),
    **dict.fromkeys(("pedestrian", "wheelchair"), "pedestrian"),
    **dict.fromkeys(("tram", "rail", "rail_urban", "rail_fast", "rail_electric"), "other"),
    **dict.fromkeys(("subway", "cable_car", "ship", "container", "aircraft", "drone"), "other"),
}
"""Of SUMO's vehicle classes those that are not vehicles on roads, and so never attack."""


def kind_of(vehicle_class: str) -> AgentKind:
    """The kind of SUMO's vehicles of a class; ``other`` on rails, on water and in the air."""
    return _KINDS.get(vehicle_class, "vehicle")


class Bodies:
    """Kinds and sizes of the agents of a running SUMO, which is asked once for each."""

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._known: dict[AgentId, Body] = {}

    def __getitem__(self, agent: AgentId) -> Body:
        """Of an agent that has been asked for; raises KeyError for others."""
        return self._known[agent]

    def ask(self, agent: AgentId, *, person: bool = False) -> Body:
        """Of a vehicle or person that is present, or has been asked for before."""
        body = self._known.get(agent)
        if body is None:
            domain = self._api.person if person else self._api.vehicle
            size = (domain.getLength(agent), domain.getWidth(agent), domain.getHeight(agent))
            kind = "pedestrian" if person else kind_of(str(domain.getVehicleClass(agent)))
            length, width, height = (float(value) for value in size)
            body = self._known[agent] = Body(kind=kind, size_m=(length, width, height))
        return body

    def sizes_m(self, agents: Sequence[AgentId]) -> Floats:
        """(N, 2) length and width."""
        return np.array([self._known[one].size_m[:2] for one in agents]).reshape(-1, 2)


class TrafficReader:
    """All vehicles and persons of a running SUMO."""

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self.bodies = Bodies(api)

    def body(self, agent: AgentId) -> Body:
        """Kind and size; raises KeyError for an agent that was never read."""
        return self.bodies[agent]

    def read(self) -> Frame:
        """All agents, vehicles before persons, sorted by id."""
        states = self.states()
        ids = list(states)
        return Frame.of_sumo(ids, list(states.values()), self.bodies.sizes_m(ids)[:, 0])

    def states(self) -> dict[AgentId, tuple[float, float, float, float, float]]:
        """As `read`, in SUMO's terms: front bumper x, y (m), angle (degrees), speed (m/s), z (m).

        For a reader of thousands of steps, which converts them all at once.
        """
        vehicle, person = self._api.vehicle, self._api.person
        present = [(vehicle, name) for name in sorted(vehicle.getIDList())]
        present += [(person, name) for name in sorted(person.getIDList())]
        states = {}
        for domain, name in present:
            self.bodies.ask(name, person=domain is person)
            x_m, y_m, z_m = domain.getPosition3D(name)
            # of the order of -1e9 while a vehicle is not on the road
            speed_mps = max(0.0, domain.getSpeed(name))
            states[str(name)] = (x_m, y_m, domain.getAngle(name), speed_mps, z_m)
        return states


# UNKNOWN and unobserved give `o` (off, blinking: yield), never `O`, which ends all right of way.
_LETTER = {
    SignalState.UNKNOWN: "o",
    SignalState.ARROW_STOP: "r",
    SignalState.ARROW_CAUTION: "y",
    SignalState.ARROW_GO: "G",
    SignalState.STOP: "r",
    SignalState.CAUTION: "y",
    SignalState.GO: "G",
    SignalState.FLASHING_STOP: "o",  # SUMO has a letter for it, at which vehicles never go on
    SignalState.FLASHING_CAUTION: "o",
}
_STATE = {
    "r": SignalState.STOP,
    "s": SignalState.FLASHING_STOP,
    "u": SignalState.STOP,
    "y": SignalState.CAUTION,
    "Y": SignalState.CAUTION,
    "g": SignalState.GO,
    "G": SignalState.GO,
    "o": SignalState.FLASHING_CAUTION,
    "O": SignalState.UNKNOWN,
}


_RED = {SignalState.STOP, SignalState.ARROW_STOP}


class ReplayedSignals:
    """Sets the recorded states on SUMO's lights; a light changes only when its states do.

    A red that the recorded AV passed (turning right on red, or recorded late) does not stop it:
    while the red lasts, SUMO's light is off there, and the AV yields. Views show the red.

    Args:
        links: of the lanes with lights.
        passed: lane -> step at which the recorded AV enters it.
    """

    def __init__(
        self,
        api: SumoApi,
        links: Mapping[str, tuple[SignalLink, ...]],
        signals: Signals,
        passed: Mapping[str, int],
    ) -> None:
        self._api = api
        self._links = links
        self._signals = signals
        self.passed_red = {
            lane: phase
            for lane, step in passed.items()
            if lane in signals.lane_ids and (phase := _red_phase(signals, lane, step))
        }
        self._shown: dict[str, str] = {}
        self._count = {
            light: len(api.trafficlight.getRedYellowGreenState(light))
            for light in sorted(api.trafficlight.getIDList())
        }

    def states(self, step: int) -> dict[str, SignalState]:
        """The recorded states at a step, by lane id."""
        return self._signals.at(min(step, self._signals.state.shape[1] - 1))

    def show(self, step: int) -> None:
        """Set all lights to the recording's states at a step."""
        letters = {light: ["o"] * count for light, count in self._count.items()}
        for lane, state in self.states(step).items():
            letter = "o" if step in self.passed_red.get(lane, ()) else _LETTER[state]
            for link in self._links.get(lane, ()):
                if link.light in letters and link.index < len(letters[link.light]):
                    letters[link.light][link.index] = letter
        for light, shown in letters.items():
            text = "".join(shown)
            if self._shown.get(light) != text:
                self._api.trafficlight.setRedYellowGreenState(light, text)
                self._shown[light] = text


def _red_phase(signals: Signals, lane: str, step: int) -> range:
    """Steps of the red phase of a lane at a step; empty if it is not red."""
    steps = signals.state.shape[1]
    red = [signals.at(one).get(lane) in _RED for one in range(steps)]
    if step >= steps or not red[step]:
        return range(0)
    begin = max((one + 1 for one in range(step) if not red[one]), default=0)
    return range(begin, next((one for one in range(step, steps) if not red[one]), steps))


class LiveSignals:
    """Reads the states of SUMO's lights."""

    def __init__(self, api: SumoApi, links: Mapping[str, tuple[SignalLink, ...]]) -> None:
        self._api = api
        self._links = links

    def states(self) -> dict[str, SignalState]:
        """The current states, by lane id; of several links of a lane the first counts."""
        lights: dict[str, str] = {}
        states = {}
        for lane, links in self._links.items():
            link = links[0]
            if link.light not in lights:
                lights[link.light] = self._api.trafficlight.getRedYellowGreenState(link.light)
            if link.index < len(lights[link.light]):  # a program may have fewer states than links
                states[lane] = _STATE[lights[link.light][link.index]]
        return states
