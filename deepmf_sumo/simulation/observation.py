"""What is read from SUMO in each step: vehicles, traffic lights, and the lanes they control."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import AgentId, AgentKind, Driver, SignalLink, Signals, SignalState
from deepmf_sumo.geometry import frames
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
        centres, headings = frames.from_sumo(table[:, :2], table[:, 2], lengths)
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


# UNKNOWN and what was never seen give `o` (off, blinking: yield), never `O`, which ends all right
# of way.
_LETTER = {
    SignalState.UNKNOWN: "o",
    SignalState.ARROW_STOP: "r",
    SignalState.ARROW_CAUTION: "y",
    SignalState.ARROW_GO: "G",
    SignalState.STOP: "r",
    SignalState.CAUTION: "y",
    SignalState.GO: "G",
    SignalState.FLASHING_STOP: "o",  # SUMO has a letter for stop and go on, and never goes on
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

    A red that the recorded AV passed (turning right on red, or recorded late) cannot mean that it
    has to stand: while it lasts, SUMO's light is off there, and the AV yields. Views show the red.

    Args:
        links: of the lanes with lights.
        passed: lane -> step at which the recorded AV comes onto it.
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
    """Steps of the red that a lane has at a step; empty where it has none."""
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
        """The states now, by lane id; of several links of a lane the first counts."""
        lights: dict[str, str] = {}
        states = {}
        for lane, links in self._links.items():
            link = links[0]
            if link.light not in lights:
                lights[link.light] = self._api.trafficlight.getRedYellowGreenState(link.light)
            states[lane] = _STATE[lights[link.light][link.index]]
        return states
