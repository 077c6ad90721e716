"""Where vehicles drive, as areas: what a person beside the road must not stand on.

Lanes for vehicles, bicycles and trains with their widths, and the outlines of junctions without
walking areas. Footways, and strips that are closed to all, are no part of it.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo import files
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry.ground import CLEARANCE_M, clear
from deepmf_sumo.scene.geometry.polylines import arc_lengths, heights_at
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
    """The areas of a network on which vehicles drive, each at its height."""

    def __init__(self, net: NetFile) -> None:
        lanes = [
            lane
            for edge in net.edges.values()
            if edge.function not in _NOT_HERE
            for lane in edge.lanes
            if len(lane.shape_m) > 1 and driven_on(lane)
        ]
        parts = [part for lane in lanes for part in _parts(lane)]
        outlines = [
            (shapely.buffer(shapely.Polygon(ring[:, :2]), 0.0), float(ring[:, 2].mean()))
            for ring in roadways(net)
        ]  # dead ends may have none
        known = [*parts, *(one for one in outlines if not one[0].is_empty)]
        self._lanes = lanes
        self._lane_tree = shapely.STRtree(np.array([lane.area() for lane in lanes], object))
        self._areas = np.array([area for area, _ in known], object)
        self._z_m = np.array([z_m for _, z_m in known])
        self._tree = shapely.STRtree(self._areas)

    def near(self, way_m: Floats, reach_m: float, z_m: Floats) -> BaseGeometry:
        """The union of what is within reach of a way (P, 2), and at the way's heights (P) there."""
        way = shapely.LineString(way_m) if len(way_m) > 1 else shapely.Point(way_m[0])
        rows = np.sort(self._tree.query(way, predicate="dwithin", distance=reach_m))
        ends = shapely.get_coordinates(shapely.shortest_line(way, self._areas[rows]))[::2]
        beside = np.hypot(*np.moveaxis(ends[:, None] - way_m, -1, 0)).argmin(axis=1)
        rows = rows[~clear(self._z_m[rows], np.asarray(z_m, float)[beside])]
        return shapely.union_all(self._areas[rows])

    def lane_at(self, position_m: Floats, z_m: float, *, road: bool = False) -> NetLane | None:
        """The nearest lane that is driven on; None in a network without any.

        A lane at the position's height comes before one above or below. ``road``: outside
        junctions.
        """
        place, found = shapely.Point(*np.asarray(position_m, float)), None
        for reach_m in _REACHES_M:
            rows = self._lane_tree.query(place, predicate="dwithin", distance=reach_m)
            near = [self._lanes[row] for row in rows if not (road and _inside(self._lanes[row]))]
            feet = [(*_foot(lane, place, z_m), lane.id, lane) for lane in near]
            found = min(feet, default=None, key=lambda one: one[:3])
            if found is not None and not (found[0] and reach_m == _REACHES_M[0]):
                return found[-1]
        return found[-1] if found else None


def _parts(lane: NetLane) -> Iterator[tuple[BaseGeometry, float]]:
    """Areas of a lane, with heights that are nowhere wrong by more than a quarter of a storey."""
    climb = np.append(0.0, np.cumsum(np.abs(np.diff(lane.shape_m[:, 2]))))
    length = arc_lengths(lane.shape_m[:, :2])
    count = max(1, int(np.ceil(2 * climb[-1] / CLEARANCE_M)))
    ends = np.interp(np.linspace(0.0, climb[-1], 1 + count), climb, length)
    ends[0], ends[-1] = 0.0, length[-1]  # of what is flat, too
    for begin, end in pairwise(ends):
        inner = lane.shape_m[(length > begin) & (length < end)]
        xyz = [[np.interp(at, length, axis) for axis in lane.shape_m.T] for at in (begin, end)]
        part = replace(lane, shape_m=np.vstack([xyz[0], inner, xyz[1]]))
        yield part.area(), (xyz[0][2] + xyz[1][2]) / 2


def _inside(lane: NetLane) -> bool:
    return lane.id.startswith(":")


def _foot(lane: NetLane, place: shapely.Point, z_m: float) -> tuple[bool, float]:
    """Whether the lane passes over or under a place, and how far from it."""
    line_m, heights_m = lane.shape_m[:, :2], lane.shape_m[:, 2]
    height = heights_at(line_m, heights_m, np.array([place.x, place.y]))
    return bool(clear(height, z_m)), float(shapely.distance(shapely.LineString(line_m), place))


@files.while_unchanged(2)
def carriageway_of(net_file: Path) -> Carriageway:
    """Of a network file; the last ones are kept as long as the files stay as they are."""
    return Carriageway(read_once(net_file))
