"""Traffic lights of a running SUMO: read from it, or shown as they were recorded."""

from collections.abc import Mapping

from deepmf_sumo.scene import SignalLink, Signals, SignalState
from deepmf_sumo.scene.signals import FORBIDS, LETTER_OF, STATE_OF
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi


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
        return self._signals.at(step)

    def show(self, step: int) -> None:
        """Set all lights to the recording's states at a step."""
        letters = {light: ["o"] * count for light, count in self._count.items()}
        for lane, state in self.states(step).items():
            letter = "o" if step in self.passed_red.get(lane, ()) else LETTER_OF[state]
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
    red = [signals.at(one).get(lane) in FORBIDS for one in range(steps)]
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
        """The current states, by lane id; a lane begins at one light (`signal_links`)."""
        lights: dict[str, str] = {}
        states = {}
        for lane, links in self._links.items():
            (link,) = links
            if link.light not in lights:
                lights[link.light] = self._api.trafficlight.getRedYellowGreenState(link.light)
            if link.index < len(lights[link.light]):  # a program may have fewer states than links
                states[lane] = STATE_OF[lights[link.light][link.index]]
        return states
