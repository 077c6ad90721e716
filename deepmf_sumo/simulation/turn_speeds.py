"""SUMO's drivers take bends at the lane's limit; people at what is comfortable sideways."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Lane, RoadMap
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.simulation.sumo_api import SumoApi

COMFORTABLE_MPS2: Final = 3.0
"""At the tightest bend of a lane; over whole turns that makes a median of 1.9, as recorded."""
_SLOWEST_MPS: Final = 3.0
_SPACING_M: Final = 2.0
_WINDOW_M: Final = 10.0
"""Bends are measured over so much way: corners of polylines are none."""
_TURN_RAD: Final = 0.25
"""Lanes inside junctions that turn less in all only lead over to a lane that begins beside."""


def slow_down(api: SumoApi, road: RoadMap) -> None:
    """Limit the speed on each lane that bends, where its own limit is higher."""
    for lane in road.lanes.values():
        speed = _comfortable(lane)
        if speed < api.lane.getMaxSpeed(lane.id):
            api.lane.setMaxSpeed(lane.id, speed)


def _comfortable(lane: Lane) -> float:
    """The speed at which the lane's tightest bend costs the comfortable sideways acceleration."""
    step = np.diff(polylines.resample(lane.centre_m, _SPACING_M), axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    if abs(float(angles.difference(heading[-1], heading[0]))) < _TURN_RAD and lane.interpolating:
        return np.inf
    spacing_m = float(np.hypot(step[:, 0], step[:, 1]).mean())
    over = min(round(_WINDOW_M / _SPACING_M), len(heading) - 1)
    if over < 1:
        return np.inf
    turned = float(np.abs(angles.difference(heading[over:], heading[:-over])).max())
    radius_m = over * spacing_m / max(turned, 1e-6)
    return max(_SLOWEST_MPS, float(np.sqrt(COMFORTABLE_MPS2 * radius_m)))
