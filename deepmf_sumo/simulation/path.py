"""The AV's way ahead along its route, as SUMO will drive it."""

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry import polylines
from deepmf_sumo.simulation.sumo_api import SumoApi


class RouteAhead:
    """Lanes and centre line ahead of a vehicle; lane shapes are read once."""

    def __init__(self, api: SumoApi, vehicle_id: str) -> None:
        self._api = api
        self._id = vehicle_id
        self._shapes: dict[str, Floats] = {}
        self._limits: dict[str, float] = {}

    def centre_line(self, length_m: float = 120.0) -> Floats | None:
        """(P, 2) from the front bumper on, P >= 2, or None off every lane.

        SUMO keeps a lateral offset while it follows a lane; so does the line.
        """
        vehicle = self._api.vehicle
        lane = vehicle.getLaneID(self._id)
        if not lane:
            return None
        shape = self._shape(lane)
        scale = polylines.arc_lengths(shape)[-1] / max(self._api.lane.getLength(lane), 1e-6)
        begin = float(vehicle.getLanePosition(self._id)) * scale
        pieces = [shape, *(self._shape(following) for following in self._lanes_ahead(lane))]
        line = np.concatenate(pieces)
        line = line[np.concatenate([[True], np.abs(np.diff(line, axis=0)).sum(-1) > 1e-3])]
        along = polylines.arc_lengths(line)
        stations = along[(along > begin + 1e-3) & (along < begin + length_m)]
        # at least to a metre ahead, so that the line has a direction
        stations = np.concatenate([[begin], stations, [max(along[-1], begin + 1.0)]])
        stations = np.unique(np.minimum(stations, begin + length_m))
        points, heading = polylines.points_at(line, stations)
        left = float(vehicle.getLateralLanePosition(self._id))
        if abs(left) > 0.01:
            points = points + left * np.stack([-np.sin(heading), np.cos(heading)], -1)
        return points

    def speed_limits(self) -> list[tuple[float, float]]:
        """(metres to its beginning, limit for this vehicle) of the lanes ahead."""
        vehicle = self._api.vehicle
        lane = vehicle.getLaneID(self._id)
        if not lane:
            return []
        factor = float(vehicle.getSpeedFactor(self._id))
        away = float(self._api.lane.getLength(lane)) - float(vehicle.getLanePosition(self._id))
        limits = []
        for following in self._lanes_ahead(lane):
            limits.append((away, factor * self._limit(following)))
            away += float(self._api.lane.getLength(following))
        return limits

    def _lanes_ahead(self, lane: str) -> list[str]:
        # on a junction's lane SUMO lists only the links after the junction
        lanes = self._through_junction(lane) if lane.startswith(":") else []
        for link in self._api.vehicle.getNextLinks(self._id):
            following, via = str(link[0]), str(link[4])
            lanes += [via, *self._through_junction(via)] if via else [following]
        return lanes

    def _through_junction(self, lane: str) -> list[str]:
        lanes: list[str] = []
        while lane.startswith(":"):
            links = self._api.lane.getLinks(lane)
            if not links:
                break
            lane = str(links[0][4] or links[0][0])
            lanes.append(lane)
        return lanes

    def _shape(self, lane: str) -> Floats:
        if lane not in self._shapes:
            self._shapes[lane] = np.array(self._api.lane.getShape(lane), float)[:, :2]
        return self._shapes[lane]

    def _limit(self, lane: str) -> float:
        if lane not in self._limits:
            self._limits[lane] = float(self._api.lane.getMaxSpeed(lane))
        return self._limits[lane]
