"""The roads of a report: each stored once, however many runs are on it, and only near the runs."""

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.report.map_layers import features
from deepmf_sumo.report.page.replay import packed, stepwise
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Run
from deepmf_sumo.scene import Floats, Lane, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import on_level, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import per_road
from deepmf_sumo.scene.geometry.road import lanes_for_cars

AROUND_M: Final = 60.0
"""How much of the road is kept around what AV and opponent drove."""
UNIT_M: Final = 0.1
_TOLERANCE_M: Final = 0.12
"""Lines may deviate by this where points are left out."""
_KEPT: Final = 8
"""Road maps in memory: runs of one scene come one after the other, or a sweep has few scenes."""


@dataclass(slots=True)
class PageRoads:
    """The roads of the runs that were added, numbered."""

    _numbers: dict[str, int] = field(default_factory=dict)
    _origins: list[Floats] = field(default_factory=list)
    _shapes: list[dict[tuple[str, int], list[Any]]] = field(default_factory=list)
    _maps: OrderedDict[str, tuple[RoadMap, str]] = field(default_factory=OrderedDict)

    def add(self, run: Run, near_m: Floats) -> tuple[int | None, RoadMap | None, str]:
        """Keep the road of a run near the places (K, 2).

        Returns:
            Its number, the map, and why it is not the one that was attacked on; None, None and the
            reason where the road cannot be read.
        """
        key = _key(run)
        try:
            road, note = self._map(key, run)
        except (DeepmfError, OSError, KeyError) as error:
            return None, None, f"no road: {error}"
        if key not in self._numbers:
            self._numbers[key] = len(self._numbers)
            self._origins.append(np.rint(near_m[0]))
            self._shapes.append({})
        number = self._numbers[key]
        _keep(self._shapes[number], road, near_m, self._origins[number])
        return number, road, note

    def packed(self) -> list[str]:
        """Each road as the page reads it."""
        return [
            packed({"origin": origin.tolist(), "unit": UNIT_M, "shapes": list(shapes.values())})
            for origin, shapes in zip(self._origins, self._shapes, strict=True)
        ]

    def _map(self, key: str, run: Run) -> tuple[RoadMap, str]:
        if key not in self._maps:
            self._maps[key] = run.road()
            while len(self._maps) > _KEPT:
                self._maps.popitem(last=False)
        self._maps.move_to_end(key)
        return self._maps[key]


def _key(run: Run) -> str:
    """What tells roads apart: the recorded scene, or the network with what is beside it."""
    source = run.source
    if "recording" in source:
        return f"{source['recording']} {run.scene}"
    net, drawn = stored.net_file(run.folder), stored.map_file(run.folder)
    return run.run_id if net is None else " ".join(_digest(one) for one in (net, drawn) if one)


@files.while_unchanged(4096)
def _digest(file: Path) -> str:
    return files.sha256(file)


def _keep(
    shapes: dict[tuple[str, int], list[Any]], road: RoadMap, near_m: Floats, origin: Floats
) -> None:
    """Add the shapes within `AROUND_M` of the places that are not there yet."""
    area = shapely.buffer(shapely.LineString(np.concatenate([near_m, near_m[-1:]])), AROUND_M)
    shapely.prepare(area)
    lines = _lines(road)
    found = np.flatnonzero(shapely.intersects(area, lines)).tolist()
    for number, one in ((number, features(road)[number]) for number in found):
        if (one.kind, number) not in shapes:
            line = shapely.simplify(lines[number], _TOLERANCE_M)
            corners = shapely.get_coordinates(line) - origin
            x, y = (stepwise(axis, UNIT_M) for axis in corners.T)
            shapes[one.kind, number] = [one.kind, round(one.width_m / UNIT_M), x, y]


@per_road
def _lines(road: RoadMap) -> NDArray[Any]:
    """Of each feature all parts, one after the other.

    After each part it leads back to the first point: filled by the even-odd rule, islands are free.
    """
    rings = [
        np.concatenate([each for part in one.parts_m for each in (part, one.parts_m[0][:1])])
        if len(one.parts_m) > 1
        else one.parts_m[0]
        for one in features(road)
    ]
    return np.array([shapely.LineString(ring) for ring in rings], object)


ELEMENTS: Final = (
    "junction",
    "junction approach",
    "merge or split",
    "road with several lanes",
    "road with one lane",
    "off the lanes",
)
_OFF_M: Final = 4.0
"""Farther than this from all centre lines is off the lanes."""
_NEAR_M: Final = 20.0
"""A junction or a merge up to this far ahead, or a merge up to this far behind, counts."""
_IN_M: Final = 10.0
"""Within this distance of a crossing lane is inside the junction."""
_TURNED_RAD: Final = np.pi / 3
"""Lanes in other directions are not the vehicle's, unless there is no other."""


def element(road: RoadMap, place_m: Floats, z_m: float, heading_rad: float) -> str:
    """One of `ELEMENTS` for a place (2,), height and heading of the vehicle that is there.

    The vehicle's lane is the nearest one within 60 degrees of its heading, else the nearest, of the
    level nearest to its height.
    A junction is where the lane was generated to join two others (SUMO's internal lanes), or within
    10 m of another lane that crosses it: recordings mark no junctions.
    """
    lane, along_m = _lane_at(road, place_m, z_m, heading_rad)
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
    others, lines = lanes_for_cars(road).lanes, _lines_for_cars(road)
    line = shapely.LineString(lane.centre_m)
    rows = np.flatnonzero(shapely.crosses(line, lines))
    met, of = shapely.get_coordinates(shapely.intersection(line, lines[rows]), return_index=True)
    along = np.asarray(shapely.line_locate_point(line, shapely.points(met)), float)
    over = [
        float(polylines.heights_at(others[row].centre_m, others[row].z_m, place))
        for row, place in zip(rows[of], met, strict=True)
    ]
    z_m = polylines.heights_at(lane.centre_m, lane.z_m, met)
    return along[on_level(road, z_m, np.array(over))]


@per_road
def _lines_for_cars(road: RoadMap) -> NDArray[Any]:
    """The centre lines of `lanes_for_cars`."""
    return np.array(
        [shapely.LineString(one.centre_m) for one in lanes_for_cars(road).lanes], object
    )


def _lane_at(
    road: RoadMap, place_m: Floats, z_m: float, heading_rad: float
) -> tuple[Lane | None, float]:
    """The lane, and how many metres along it the place is."""
    lanes = lanes_for_cars(road)
    feet = lanes.feet(np.reshape(place_m, (1, 2)), _OFF_M)
    feet = feet.among(np.hypot(*feet.away_m.T) <= _OFF_M)
    if not len(feet.point):
        return None, 0.0
    feet = feet.among(on_nearest_level(feet.point, lanes.heights_m(feet), np.array(z_m)))
    x, y = lanes.vector_m[feet.segment].T
    turned = np.abs(frames.difference(np.arctan2(y, x), heading_rad)) > _TURNED_RAD
    best = np.lexsort((np.hypot(*feet.away_m.T), turned))[0]
    segment = int(feet.segment[best])
    row = int(lanes.lane[segment])
    passed_m = polylines.arc_lengths(lanes.line_m[row])[segment - int(lanes.first[row])]
    return lanes.lanes[row], float(passed_m + feet.share[best] * np.hypot(x[best], y[best]))
