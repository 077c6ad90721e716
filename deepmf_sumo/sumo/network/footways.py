"""Where people walk in a SUMO network, and as whose lane SUMO takes a person anywhere else.

SUMO's own pedestrians keep to one lane of an edge: the one for pedestrians alone, else the first
that they may use. From there SUMO walks a person on; from other lanes it does not, or it jumps.
"""

from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from deepmf_sumo import files
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.sumo.network.sumo_net import NetEdge, NetFile, NetLane, edge_of, read_once

_CLASS: Final = "pedestrian"
_INSIDE_M: Final = 0.3
"""A person who comes from outside walks on until it is so far inside a footway."""

_AWAY_M: Final = 0.6
"""It does not come to the ends of one, where SUMO may take it for a person of a walking area."""
_END_M: Final = 0.2
_CORNER_M: Final = 0.3
"""So close to a walking area SUMO may take a person for one of it, whatever lane is asked for."""
_AROUND_CORNER_M: Final = 3.5
"""The same for vehicles: SUMO takes them by their front, for the lane whose line is at most half of
both widths away, and a walking area is several metres wide."""


class Footing(NamedTuple):
    """A place (2,) on a footway, the lane and its edge, and how far along it the place is."""

    point_m: Floats
    lane: str
    edge: str
    along_m: float


class _Lanes:
    """Lanes with their areas, and an index of them."""

    def __init__(self, lanes: list[NetLane]) -> None:
        self.lanes = lanes
        self.areas: NDArray[Any] = np.array([one.area() for one in lanes], object)
        self._tree = shapely.STRtree(self.areas)

    def within(self, at_m: Floats, reach_m: float, z_m: float) -> list[int]:
        """Rows of the areas within reach of a point (2,) on its level, the nearest first."""
        place = shapely.Point(*at_m)
        rows = np.sort(self._tree.query(place, predicate="dwithin", distance=reach_m))
        away = shapely.distance(self.areas[rows], place)
        near, z = rows[np.argsort(away, kind="stable")].tolist(), np.array(z_m)
        return [row for row in near if not clear(np.array(self._height_m(row, at_m)), z)]

    def under(self, at_m: Floats, z_m: float) -> NetLane | None:
        """The lane of a point (2,), of several the one whose line is nearest."""
        rows = self.within(at_m, 0.0, z_m)
        shapes = [self.lanes[row].shape_m[:, :2] for row in rows]
        away = [float(polylines.project(shape, at_m).distance_m) for shape in shapes]
        return self.lanes[rows[int(np.argmin(away))]] if rows else None

    def _height_m(self, row: int, at_m: Floats) -> float:
        """Of a lane beside a point."""
        shape = self.lanes[row].shape_m
        if not np.ptp(shape[:, 2]):
            return float(shape[0, 2])
        along = polylines.arc_lengths(shape[:, :2])
        return float(np.interp(polylines.project(shape[:, :2], at_m).along_m, along, shape[:, 2]))


class Footways:
    """The lanes of a network as people walk on them and over them."""

    def __init__(self, net: NetFile) -> None:
        walked = {lane.id: lane for one in net.edges.values() if (lane := _walked(one)) is not None}
        lanes = [(edge, lane) for edge in net.edges.values() for lane in edge.lanes if _long(lane)]
        beside = _edges_beside(net)
        self._open = {edge_of(lane) for lane in walked}
        self._ends = {one: (net.edges[one].start, net.edges[one].end) for one in self._open}
        self._length_m = {lane.edge: lane.length_m for lane in walked.values()}
        self._footways = _Lanes(list(walked.values()))
        self._names = frozenset(walked)
        self._crossings = _Lanes([one for edge, one in lanes if edge.function == "crossing"])
        self._corners = _Corners(net)
        self._roads = _Lanes([one for edge, one in lanes if not edge.function])
        self._junctions = _Lanes(
            [
                one
                for edge, one in lanes
                if edge.function == "internal" and beside[one.id] <= self._open
            ]
        )

    def lane_at(self, at_m: Floats, z_m: float) -> str:
        """The lane as whose SUMO must take a person at a point (2,); empty: as off every lane.

        Cars of a lane see a person of that lane, those of all lanes one of a crossing. SUMO 1.28
        crashes where a person is put onto a walking area at which its way does not pass, and ends
        where it is put onto a lane inside a junction before or behind which people may not walk.
        """
        at = np.asarray(at_m, float)
        found = self._crossings.under(at, z_m)
        if found is None and not self._corners.near(at):
            found = self._footways.under(at, z_m) or self._roads.under(at, z_m)
            found = found or self._junctions.under(at, z_m)
        return "" if found is None or _at_its_end(found, at) else found.id

    def at_corner(self, at_m: Floats) -> bool:
        """Whether a point (2,) is on a walking area, or within 3.5 m of it."""
        return self._corners.near(np.asarray(at_m, float), _AROUND_CORNER_M)

    def on_street(self, at_m: Floats, z_m: float) -> bool:
        """Whether a point (2,) is on a lane outside junctions, and not `at_corner`.

        All points are in a network without walking areas.
        """
        if not self._corners.any:
            return True
        at = np.asarray(at_m, float)
        return self._roads.under(at, z_m) is not None and not self.at_corner(at)

    def closed(self, lane: str) -> bool:
        """Whether people may walk on no lane of a lane's edge; one inside a junction is none."""
        return bool(lane) and not lane.startswith(":") and edge_of(lane) not in self._open

    def end_ahead_m(self, edge: str, following: str) -> float:
        """How far along an edge its end is from which SUMO takes a walk to lead to another edge.

        It is the far end where that belongs to both, and else the near one.
        """
        far = self._ends[edge][1] in self._ends.get(following, ())
        return max(self._length_m[edge] - _END_M, 0.0) if far else 0.0

    def walked(self, at_m: Floats, z_m: float) -> str:
        """The footway as whose SUMO takes a person at a point (2,); empty off all."""
        found = self.lane_at(at_m, z_m)
        return found if found in self._names else ""

    def nearest(self, at_m: Floats, reach_m: float, z_m: float) -> Footing | None:
        """Where the nearest footway is reached from a point (2,); None if none is near."""
        at = np.asarray(at_m, float)
        rows = self._footways.within(at, reach_m, z_m)
        lane = next((one for row in rows if _inside(one := self._footways.lanes[row])), None)
        if lane is None:
            return None
        line = shapely.shortest_line(_inside(lane), shapely.Point(*at))
        point_m = np.asarray(shapely.get_coordinates(line)[0], float)
        shape = lane.shape_m[:, :2]
        share = float(polylines.project(shape, point_m).along_m / polylines.arc_lengths(shape)[-1])
        return Footing(point_m, lane.id, lane.edge, share * lane.length_m)


class _Corners:
    """The walking areas, whatever their heights."""

    def __init__(self, net: NetFile) -> None:
        rings = [
            lane.shape_m[:, :2]
            for edge in net.edges.values()
            for lane in (edge.lanes if edge.function == "walkingarea" else ())
            if len(lane.shape_m) > 2
        ]
        areas = [shapely.buffer(shapely.Polygon(ring), 0.0) for ring in rings]
        self.any = bool(areas)
        self._tree = shapely.STRtree(np.array(areas, object))

    def near(self, at_m: Floats, reach_m: float = _CORNER_M) -> bool:
        place = shapely.Point(*at_m)
        return bool(len(self._tree.query(place, predicate="dwithin", distance=reach_m)))


def _walked(edge: NetEdge) -> NetLane | None:
    """The lane of an edge on which SUMO's pedestrians walk; None if they may not use it."""
    if edge.function:
        return None
    lanes = [lane for lane in edge.lanes if lane.allows(_CLASS) and _long(lane)]
    alone = (lane for lane in lanes if lane.allow is not None and lane.allow == {_CLASS})
    return next(alone, lanes[0] if lanes else None)


def _at_its_end(lane: NetLane, at_m: Floats) -> bool:
    """Whether SUMO may find no foot of a point on a lane, and take the next lane instead."""
    shape = lane.shape_m[:, :2]
    along = float(polylines.project(shape, at_m).along_m)
    return not _END_M < along < float(polylines.arc_lengths(shape)[-1]) - _END_M


def _inside(lane: NetLane) -> BaseGeometry | None:
    """Where a person from outside comes to; None on a lane that is too short."""
    line = shapely.LineString(lane.shape_m[:, :2])
    if line.length <= 3 * _AWAY_M:
        return None
    middle = substring(line, _AWAY_M, line.length - _AWAY_M)
    half_m = max(lane.width_m / 2 - _INSIDE_M, 0.1)
    return shapely.buffer(middle, half_m, cap_style="flat", join_style="mitre")


def _edges_beside(net: NetFile) -> dict[str, set[str]]:
    """The edges between which each lane inside a junction leads."""
    found: dict[str, set[str]] = {
        lane.id: set()
        for edge in net.edges.values()
        for lane in (edge.lanes if edge.function == "internal" else ())
    }
    for link in net.links:
        for lane in (link.via, link.origin):
            if lane in found:
                found[lane] |= {one for one in link.edges if not one.startswith(":")}
    return found


def _long(lane: NetLane) -> bool:
    return len(lane.shape_m) > 1 and bool(np.ptp(lane.shape_m[:, :2], axis=0).any())


@files.while_unchanged(2)
def footways_of(net_file: Path) -> Footways:
    """Of a network file; the last ones are kept as long as the files stay as they are."""
    return Footways(read_once(net_file))


@cache
def no_footways() -> Footways:
    """Of a network without any."""
    return Footways(NetFile(edges={}, links=(), junctions=()))
