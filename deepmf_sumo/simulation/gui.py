"""An episode to look at: sumo-gui follows the AV at the speed of a clock."""

import time
from typing import Final

from deepmf_sumo.datatypes import DT_S, AgentId, Command, Event, Floats, SignalState
from deepmf_sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.simulation.world import Stage

_AV_COLOUR: Final = (200, 30, 30, 255)
_OPPONENT_COLOUR: Final = (240, 140, 0, 255)
_SPENT_COLOUR: Final = (250, 215, 160, 255)
_RADIUS_M: Final = 40.0
"""Of what is seen around the AV."""
_LAST_LOOK_S: Final = 2.0
"""How long the end stays to be seen."""


class WatchedStage:
    """A stage in sumo-gui: the same episode, with the AV in red and the opponent in orange."""

    def __init__(self, stage: Stage, api: SumoApi, av: AgentId) -> None:
        self.events: list[Event] = stage.events
        self._stage = stage
        self._api = api
        self._av = av
        self._due = time.monotonic()
        self._followed = False
        self._opponent: AgentId | None = None

    def history(self) -> list[Frame]:
        """The stage's."""
        return self._stage.history()

    def body(self, agent: AgentId) -> Body:
        """The stage's."""
        return self._stage.body(agent)

    def signals(self) -> dict[str, SignalState]:
        """The stage's."""
        return self._stage.signals()

    def av_path(self) -> Floats | None:
        """The stage's."""
        return self._stage.av_path()

    def av_present(self) -> bool:
        """The stage's."""
        return self._stage.av_present()

    def av_leaders(self) -> tuple[AgentId, ...] | None:
        """The stage's."""
        return self._stage.av_leaders()

    def advance(self, command: Command, opponent: AgentId | None, pose: Pose | None) -> Frame:
        """One step of the stage, not before its time."""
        frame = self._stage.advance(command, opponent, pose)
        self._show(opponent)
        now = time.monotonic()
        self._due = max(self._due + DT_S, now)  # what planning took is not made up for
        time.sleep(self._due - now)
        return frame

    def linger(self) -> None:
        """Leave the end on the screen for a moment."""
        time.sleep(_LAST_LOOK_S)

    def _show(self, opponent: AgentId | None) -> None:
        vehicle, gui = self._api.vehicle, self._api.gui
        there = set(vehicle.getIDList())
        if opponent != self._opponent and self._opponent in there:
            vehicle.setColor(self._opponent, _SPENT_COLOUR)
        self._opponent = opponent
        if opponent in there:
            vehicle.setColor(opponent, _OPPONENT_COLOUR)
        if self._av not in there:
            return
        vehicle.setColor(self._av, _AV_COLOUR)
        if not self._followed:
            view = gui.getIDList()[0]
            x, y = vehicle.getPosition(self._av)
            gui.setBoundary(view, x - _RADIUS_M, y - _RADIUS_M, x + _RADIUS_M, y + _RADIUS_M)
            gui.trackVehicle(view, self._av)
            if gui.getSchema(view) == "standard":  # the user's configuration chose no other
                gui.setSchema(view, "real world")
            self._followed = True
