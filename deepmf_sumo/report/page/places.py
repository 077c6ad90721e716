"""Which element of the road a place lies on."""

from functools import lru_cache
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from deepmf_sumo.datatypes import Floats, Lane, RoadMap
from deepmf_sumo.geometry import frames

ELEMENTS: Final = (
    "junction",
    "junction approach",
    "merge or split",
    "road with several lanes",
    "road with one lane",
    "off the lanes",
)
_OFF_M: Final = 4.0
"""Farther than this from all lanes' centre lines is beside them."""
_NEAR_M: Final = 20.0
"""A junction or a merge so far ahead, and a merge so far behind, belongs to the place."""
_IN_M: Final = 10.0
"""So near to the point where another lane crosses is within the junction."""
_STOREY_M: Final = 3.0
"""Lanes so far above each other do not meet."""
_TURNED_RAD: Final = np.pi / 3
"""Lanes that lead elsewhere are not the vehicle's, unless there is no other."""


def element(road: RoadMap, place_m: Floats, heading_rad: float) -> str:
    """One of `ELEMENTS` for a place (2,) and the heading of the vehicle that is there.

    The vehicle's lane is the nearest one that leads its way within 60 degrees, else the nearest.
    A junction is where the lane was made up to join two others (SUMO's internal lanes), or within
    10 m of another lane that crosses it: recordings mark no junctions.
    """
    lane, along_m = _lane_at(road, place_m, heading_rad)
    if lane is None:
        return "off the lanes"
    ahead = [road.lanes[one] for one in lane.next if one in road.lanes]
    rest_m = shapely.LineString(lane.centre_m).length - along_m
    crossings = np.concatenate(
        [_crossings(road, lane) - along_m, *(rest_m + _crossings(road, one) for one in ahead)]
    )
    if lane.interpolating or (np.abs(crossings) <= _IN_M).any():
        return "junction"
    near_end = rest_m <= _NEAR_M
    if (crossings > 0).any() and crossings[crossings > 0].min() <= _IN_M + _NEAR_M:
        return "junction approach"
    if near_end and any(one.interpolating for one in ahead):
        return "junction approach"
    joined = along_m <= _NEAR_M and len(lane.previous) > 1
    if joined or (near_end and (len(ahead) > 1 or any(len(one.previous) > 1 for one in ahead))):
        return "merge or split"
    return "road with several lanes" if lane.left or lane.right else "road with one lane"


def _crossings(road: RoadMap, lane: Lane) -> Floats:
    """(K) metres along a lane at which others cross it on the same level."""
    if len(lane.centre_m) < 2:
        return np.zeros(0)
    lanes, lines = _driven_lanes(road)
    line = shapely.LineString(lane.centre_m)
    over = [
        lines[number]
        for number in np.flatnonzero(shapely.crosses(line, lines))
        if abs(float(lanes[number].z_m.mean() - lane.z_m.mean())) < _STOREY_M
    ]
    met = shapely.get_coordinates(shapely.intersection(line, np.array(over, object)))
    return np.asarray(shapely.line_locate_point(line, shapely.points(met)), float)


@lru_cache(maxsize=8)
def _driven_lanes(road: RoadMap) -> tuple[list[Lane], NDArray[Any]]:
    """Lanes for cars, and their centre lines."""
    lanes = [lane for lane in road.lanes.values() if len(lane.centre_m) > 1 and lane.kind != "bike"]
    return lanes, np.array([shapely.LineString(lane.centre_m) for lane in lanes], object)


def _lane_at(road: RoadMap, place_m: Floats, heading_rad: float) -> tuple[Lane | None, float]:
    """The lane, and how many metres along it the place is."""
    lanes, lines = _driven_lanes(road)
    point = shapely.Point(place_m)
    apart = shapely.distance(lines, point)
    found: list[tuple[bool, float, int]] = []
    for number in np.flatnonzero(apart <= _OFF_M).tolist():
        along = lines[number].project(point)
        ends = shapely.line_interpolate_point(lines[number], [max(0.0, along - 1.0), along + 1.0])
        way = np.diff(shapely.get_coordinates(ends), axis=0)[0]
        turned = abs(float(frames.difference(np.arctan2(way[1], way[0]), heading_rad)))
        found.append((turned > _TURNED_RAD, float(apart[number]), number))
    if not found:
        return None, 0.0
    best = min(found)[2]
    return lanes[best], float(lines[best].project(point))
