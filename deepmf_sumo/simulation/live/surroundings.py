"""The road of somebody else's simulation, and its lights as they are now."""

from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import RoadMap, SignalState
from deepmf_sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.simulation.live.connection import LiveApi
from deepmf_sumo.simulation.places import Places
from deepmf_sumo.simulation.signals import LiveSignals

_NEAR_M: Final = 150.0
"""Lights farther from the AV are not asked for: each costs a message."""


class Surroundings:
    """Map, free places and lights.

    Args:
        api: the simulation.
        net: its network. additional: its additional files.

    Raises SimulationError where a file cannot be read.
    """

    def __init__(self, api: LiveApi, net: Path, additional: tuple[Path, ...]) -> None:
        self.net = net
        self.road: RoadMap = road_of_net(net, additional)
        self.places = Places(api, self.road)
        self._api = api
        links = signal_links(net)
        self._links = {lane: row for lane, row in links.items() if lane in self.road.lanes}
        stops = [self.road.lanes[lane].centre_m[0] for lane in self._links]
        self._stop_m = np.array(stops).reshape(-1, 2)

    def signals(self, at_m: tuple[float, float]) -> dict[str, SignalState]:
        """States of the lights around a point, by lane id."""
        near = np.hypot(*(self._stop_m - at_m).T) < _NEAR_M
        links = {
            lane: row for (lane, row), close in zip(self._links.items(), near, strict=True) if close
        }
        return LiveSignals(self._api, links).states()
