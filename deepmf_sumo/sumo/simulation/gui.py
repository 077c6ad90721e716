"""An episode in sumo-gui, which follows the AV in real time."""

import time
from collections.abc import Sequence
from typing import Final

from deepmf_sumo.scene import DT_S, AgentId
from deepmf_sumo.sumo.simulation.frame import Frame
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AV_COLOUR: Final = (200, 30, 30, 255)
_OPPONENT_COLOUR: Final = (240, 140, 0, 255)
_FORMER_OPPONENT_COLOUR: Final = (250, 215, 160, 255)
_RADIUS_M: Final = 40.0
"""Shown around the AV."""
_LAST_LOOK_S: Final = 2.0
"""For which the end stays on the screen."""


class GuiWindow:
    """Observer of an episode in sumo-gui: the AV is red, its opponents are orange."""

    def __init__(self, api: SumoApi, av: AgentId) -> None:
        self._api = api
        self._av = av
        self._due = time.monotonic()
        self._followed = False
        self._opponents: Sequence[AgentId] = ()

    def on_step(self, frame: Frame, attackers: Sequence[AgentId]) -> None:  # noqa: ARG002 - SUMO shows it
        """Colour the vehicles, and wait until the step is over in real time."""
        self._show(attackers)
        now = time.monotonic()
        self._due = max(self._due + DT_S, now)  # time spent on planning is not caught up
        time.sleep(self._due - now)

    def on_end(self) -> None:
        """Leave the end on the screen for a moment."""
        time.sleep(_LAST_LOOK_S)

    def _show(self, opponents: Sequence[AgentId]) -> None:
        vehicle, gui = self._api.vehicle, self._api.gui
        there = set(vehicle.getIDList())
        for one in self._opponents:
            if one not in opponents and one in there:
                vehicle.setColor(one, _FORMER_OPPONENT_COLOUR)
        self._opponents = opponents
        for one in opponents:
            if one in there:
                vehicle.setColor(one, _OPPONENT_COLOUR)
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
