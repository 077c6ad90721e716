"""The lanes and the centre line ahead of a vehicle of SUMO."""

from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AGAINST_RAD: Final = 2 * np.pi / 3
"""A vehicle that is turned against its lane by more than this drives on it backwards."""


class RouteAhead:
    """Lanes and centre line ahead of a vehicle; lane shapes are read once."""

    def __init__(self, api: SumoApi, vehicle_id: AgentId) -> None:
        self._api = api
        self._id = vehicle_id
        self._shapes: dict[str, Floats] = {}
        self._lengths_m: dict[str, float] = {}
        self._measured: dict[str, polylines.Measured | None] = {}
        self._lanes: tuple[str, ...] = ()
        self._line: polylines.Measured | None = None

    def centre_line(self, length_m: float = 120.0) -> Floats | None:
        """(P, 2) from the front bumper on, P >= 2, or None off every lane.

        Also None on a last lane without length. SUMO keeps a lateral offset while it follows a
        lane; so does the line. On the opposite lane, to overtake, it leads back along that lane, to
        the end of the vehicle's own edge and on.
        """
        vehicle = self._api.vehicle
        lane = vehicle.getLaneID(self._id)
        if not lane:
            return None
        shape, along = self._shape(lane), self._along(lane)
        against = self._against(lane, along)
        lanes = (lane, *self._lanes_ahead(lane), "against" * against)
        if lanes != self._lanes:
            self._lanes = lanes
            ahead = [self._shape(one) for one in lanes[1:-1]]
            line = np.concatenate([shape[::-1] if against else shape, *ahead])
            moved = np.hypot(*np.diff(line, axis=0).T) > 1e-3
            line = line[np.concatenate([[True], moved])]
            self._line = polylines.Measured(line) if len(line) > 1 else None
        if self._line is None:
            return None
        begin = self._shape_m(lane) - along if against else along
        along = self._line.along_m
        # at least a metre, so that the line has a direction
        end = max(min(along[-1], begin + length_m), begin + 1.0)
        inner = along[(along > begin + 1e-3) & (along < end - 1e-3)]
        points, heading = self._line.at(np.array([begin, *inner, end]))
        left = float(vehicle.getLateralLanePosition(self._id)) * (-1.0 if against else 1.0)
        if abs(left) > 0.01:
            points = points + left * np.stack([-np.sin(heading), np.cos(heading)], -1)
        return points

    def _along(self, lane: str) -> float:
        """Where the vehicle is along the shape of its lane, from the lane's begin."""
        lane_m = max(float(self._api.lane.getLength(lane)), 1e-6)
        position_m = float(self._api.vehicle.getLanePosition(self._id))
        return position_m * self._shape_m(lane) / lane_m

    def _against(self, lane: str, along_m: float) -> bool:
        """Whether the vehicle drives against its lane, as SUMO does to overtake.

        Networks have lanes inside junctions that are a single point: they have no direction.
        """
        if lane not in self._measured:
            shape = self._shape(lane)
            straight = np.ptp(shape, axis=0).any()
            self._measured[lane] = polylines.Measured(shape) if straight else None
        measured = self._measured[lane]
        if measured is None:
            return False
        _, lane_rad = measured.at(np.array(along_m))
        heading_rad = np.radians(90.0 - float(self._api.vehicle.getAngle(self._id)))
        return bool(abs(frames.difference(lane_rad, heading_rad)) > _AGAINST_RAD)

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

    def _shape_m(self, lane: str) -> float:
        """Length of a lane's shape, which need not be what SUMO takes the lane's length for."""
        if lane not in self._lengths_m:
            self._lengths_m[lane] = float(polylines.arc_lengths(self._shape(lane))[-1])
        return self._lengths_m[lane]
