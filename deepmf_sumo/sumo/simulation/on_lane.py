"""How a vehicle of SUMO is on its lane: which way it drives, and how far to the side it is."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network.sumo_net import edge_of
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AGAINST_RAD: Final = 2 * np.pi / 3
"""A vehicle that is turned against its lane by more than this drives on it backwards."""


def against(
    api: SumoApi, vehicle_id: AgentId, lane: str, lane_rad: float, angle_deg: float
) -> bool:
    """Whether a vehicle drives against its lane, as SUMO does to overtake; its angle is SUMO's.

    Not on its route: where it turns back, SUMO's angle lags behind its front.
    """
    heading_rad = np.radians(90.0 - angle_deg)
    turned = abs(frames.difference(np.asarray(lane_rad), heading_rad)) > _AGAINST_RAD
    return bool(turned) and not _on_route(api, vehicle_id, lane)


def _on_route(api: SumoApi, vehicle_id: AgentId, lane: str) -> bool:
    """Whether a lane is of the edge that a vehicle has come to, or leads on from it."""
    at = int(api.vehicle.getRouteIndex(vehicle_id))
    if at < 0:
        return False
    edge = str(api.vehicle.getRoute(vehicle_id)[at])
    if not lane.startswith(":"):
        return edge_of(lane) == edge
    starts = (f"{edge}_{number}" for number in range(int(api.edge.getLaneNumber(edge))))
    return any(lane in _inner_lanes(api, start) for start in starts)


def _inner_lanes(api: SumoApi, lane: str) -> Iterator[str]:
    """The lanes inside a junction that lead on from a lane."""
    left, seen = [lane], {lane}
    while left:
        for link in api.lane.getLinks(left.pop()):
            following = str(link[4] or link[0])
            if following.startswith(":") and following not in seen:
                seen.add(following)
                left.append(following)
                yield following


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
