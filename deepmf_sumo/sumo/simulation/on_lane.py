"""How a vehicle of SUMO is on its lane: which way it drives, and how far to the side it is."""

from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AGAINST_RAD: Final = 2 * np.pi / 3
"""A vehicle that is turned against its lane by more than this drives on it backwards."""


def against(lane_rad: float, angle_deg: float) -> bool:
    """Whether a vehicle drives against its lane, as SUMO does to overtake; its angle is SUMO's."""
    heading_rad = np.radians(90.0 - angle_deg)
    return bool(abs(frames.difference(np.asarray(lane_rad), heading_rad)) > _AGAINST_RAD)


def left_m(api: SumoApi, vehicle_id: AgentId, line_m: Floats, heading_rad: float) -> float:
    """How far left of the point (2,) of a line beside its front a vehicle is.

    SUMO counts to the right where traffic keeps left, and tells no client on which side it keeps.
    So SUMO says how far, and its front on which side.
    """
    vehicle = api.vehicle
    aside_m = abs(float(vehicle.getLateralLanePosition(vehicle_id)))
    if not aside_m:
        return 0.0
    off = np.asarray(vehicle.getPosition(vehicle_id), float) - line_m
    return float(np.copysign(aside_m, off @ frames.unit(np.asarray(heading_rad + np.pi / 2))))
