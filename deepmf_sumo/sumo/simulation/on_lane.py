"""How a vehicle of SUMO is on its lane: which way it drives, and how far to the side it is."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.network.sumo_net import edge_of
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AGAINST_RAD: Final = 2 * np.pi / 3
"""A vehicle that is turned against its lane by more than this drives on it backwards."""
_ALONG_RAD: Final = np.pi / 4


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


class OwnWay:
    """Whether a vehicle that a client places is on the lanes of its own route.

    SUMO takes it on these alone if it is asked to. Otherwise SUMO may take it for one of the
    opposite lane, where lanes lie on each other, or of the way of another stream over a junction,
    and vehicles behind it do not see it.
    """

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._lanes: dict[tuple[str, str], list[tuple[Floats, float]]] = {}

    def has(self, vehicle_id: AgentId, front_m: Floats, heading_rad: float) -> bool:
        """Whether a front (2) with a heading is on a lane here or next on its route, along it."""
        at = int(self._api.vehicle.getRouteIndex(vehicle_id))
        if at < 0:
            return False
        edges = [*self._api.vehicle.getRoute(vehicle_id)[max(at - 1, 0) : at + 2], ""]
        return any(
            self._on(line, reach_m, front_m, heading_rad)
            for pair in pairwise(edges)
            for line, reach_m in self._of(*pair)
        )

    def _reach_m(self, lane: str) -> float:
        """How far beside its middle a front still counts: nothing marks ways over a junction."""
        width_m = float(self._api.lane.getWidth(lane))
        return width_m if lane.startswith(":") else width_m / 2

    @staticmethod
    def _on(line_m: Floats, reach_m: float, front_m: Floats, heading_rad: float) -> bool:
        foot = polylines.project(line_m, front_m)
        if float(foot.distance_m) > reach_m:
            return False
        return abs(float(frames.difference(foot.heading_rad, heading_rad))) < _ALONG_RAD

    def _of(self, edge: str, following: str) -> list[tuple[Floats, float]]:
        """Lines and reach of an edge's lanes and of the lanes over the junction behind it."""
        if (edge, following) not in self._lanes:
            lane, count = self._api.lane, int(self._api.edge.getLaneNumber(edge))
            starts = [f"{edge}_{number}" for number in range(count)]
            names = [*starts, *dict.fromkeys(self._over(starts, following))]
            self._lanes[edge, following] = [
                (np.array(lane.getShape(name), float)[:, :2], self._reach_m(name)) for name in names
            ]
        return self._lanes[edge, following]

    def _over(self, starts: Sequence[str], following: str) -> Iterator[str]:
        for start in starts:
            for link in self._api.lane.getLinks(start):
                if edge_of(str(link[0])) == following and link[4]:
                    yield str(link[4])
                    yield from _inner_lanes(self._api, str(link[4]))


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
