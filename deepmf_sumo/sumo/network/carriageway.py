"""Where vehicles drive, as areas: what a person beside the road must not stand on.

Lanes for vehicles, bicycles and trains with their widths, and the outlines of junctions without
walking areas. Footways, and strips that are closed to all, are no part of it.
"""

from pathlib import Path
from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo import files
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.sumo.network.sumo_net import (
    ON_FOOT,
    RAIL_VEHICLES,
    ROAD_VEHICLES,
    NetFile,
    NetLane,
    read_once,
)
from deepmf_sumo.sumo.network.sumo_road import roadways

_DRIVING: Final = (*ROAD_VEHICLES, *RAIL_VEHICLES, "bicycle")
_REACHES_M: Final = (10.0, 50.0, 1e6)
_NOT_HERE: Final = {*ON_FOOT, "connector"}


def driven_on(lane: NetLane) -> bool:
    """Whether anything but people on foot moves on a lane, and bicycles on a path for both."""
    motor = lane.road or any(lane.allows(one) for one in RAIL_VEHICLES)
    return motor or (lane.allows("bicycle") and not lane.allows("pedestrian"))


def driver_of(lane: NetLane) -> str:
    """A class of vehicles that moves on a lane that is driven on."""
    return next(one for one in _DRIVING if lane.allows(one))


class Carriageway:
    """The areas of a network on which vehicles drive.

    A junction without heights of its own is at that of the nearest lane.
    """

    def __init__(self, net: NetFile) -> None:
        lanes = [
            lane
            for edge in net.edges.values()
            if edge.function not in _NOT_HERE
            for lane in edge.lanes
            if len(lane.shape_m) > 1 and driven_on(lane)
        ]
        areas = [lane.area() for lane in lanes]
        heights = [float(lane.shape_m[:, 2].mean()) for lane in lanes]
        outlines = (shapely.buffer(shapely.Polygon(ring), 0.0) for ring in roadways(net))
        rings = [one for one in outlines if not one.is_empty]  # dead ends may have none
        tree = shapely.STRtree(np.array(areas, object)) if areas else None
        for ring in rings:
            near = None if tree is None else tree.nearest(ring)
            heights.append(heights[int(near)] if near is not None else 0.0)
        self._lanes, self._lane_tree = lanes, tree
        self._areas = np.array([*areas, *rings], object)
        self._z_m = np.array(heights)
        self._tree = shapely.STRtree(self._areas)

    def near(self, position_m: Floats, reach_m: float, z_m: float = 0.0) -> BaseGeometry:
        """The union of what is within reach of a position (2,), and on its level."""
        place = shapely.Point(*np.asarray(position_m, float))
        rows = np.sort(self._tree.query(place, predicate="dwithin", distance=reach_m))
        rows = rows[~clear(self._z_m[rows], np.array(z_m))]
        return shapely.union_all(self._areas[rows])

    def lane_at(self, position_m: Floats, *, road: bool = False) -> NetLane | None:
        """The nearest lane that is driven on; None in a network without any.

        ``road``: outside junctions.
        """
        if self._lane_tree is None:
            return None
        place = shapely.Point(*np.asarray(position_m, float))
        for reach_m in _REACHES_M:
            rows = self._lane_tree.query(place, predicate="dwithin", distance=reach_m)
            near = [self._lanes[row] for row in rows if not (road and _inside(self._lanes[row]))]
            if near:
                return min(near, key=lambda lane: (_away_m(lane, place), lane.id))
        return None


def _inside(lane: NetLane) -> bool:
    return lane.id.startswith(":")


def _away_m(lane: NetLane, place: BaseGeometry) -> float:
    return float(shapely.distance(shapely.LineString(lane.shape_m[:, :2]), place))


@files.while_unchanged(2)
def carriageway_of(net_file: Path) -> Carriageway:
    """Of a network file; the last ones are kept as long as the files stay as they are."""
    return Carriageway(read_once(net_file))
