"""Where people can be: on foot, or on a bicycle that they may also push.

A person can be on lanes of any kind, crossings, sidewalks, walking areas and tracks of trams, and
up to 2 m beside a lane, where the kerb and the verge are, but there neither inside a building nor
in water, nor over a road that passes below. Only what lies at the person's height counts.

Recordings map neither sidewalks nor buildings: there a person can be up to 10 m beside a lane or an
edge of the road. (Nine of ten pedestrians of the Waymo Open Motion Dataset are, two of three within
2 m; of its cyclists nearly all.)
"""

from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from deepmf_sumo.scene import Bools, Floats, Polygon, RoadMap
from deepmf_sumo.scene.geometry.ground import CLEARANCE_M, clear, ground_of
from deepmf_sumo.scene.geometry.lane_map import MARGIN_M, per_road
from deepmf_sumo.scene.geometry.road import all_lanes

VERGE_M: Final = 2.0
"""Beside lanes: kerb and verge; as wide as a sidewalk."""
UNMAPPED_M: Final = 10.0
"""The same where the map has no sidewalks."""
_SHOULDER_M: Final = 0.25
"""Nobody's middle is nearer to a wall."""
_JOINT_M: Final = 0.1
"""Areas for people meet lanes and each other with gaps of rounding."""


class _Areas:
    """Polygons with their mean heights, and an index of them."""

    def __init__(self, polygons: tuple[Polygon, ...]) -> None:
        known = [one for one in polygons if len(one.points_m) > 2]
        rings = np.array([shapely.Polygon(one.points_m) for one in known], object)
        self._z_m = np.array([float(one.z_m.mean()) for one in known])
        self._tree = shapely.STRtree(np.asarray(shapely.make_valid(rings), object))

    def near(self, points: NDArray[Any], reach_m: float, z_m: Floats | None) -> Bools:
        """(N) whether points are within reach of an area, at heights (N) if these are given."""
        found = np.zeros(len(points), bool)
        point, area = self._tree.query(points, predicate="dwithin", distance=reach_m)
        if z_m is not None:
            point = point[~clear(self._z_m[area], z_m[point])]
        found[point] = True
        return found


class Walkable:
    """Where people can be on a road.

    Attributes:
        beside_m: how far beside lanes.
    """

    def __init__(self, road: RoadMap) -> None:
        self.beside_m = UNMAPPED_M if road.footways is None else VERGE_M
        self._lanes, self._levels = all_lanes(road), ground_of(road).has_levels
        self._areas = _Areas((*road.polygons, *(road.footways or ())))
        self._buildings, self._water = _Areas(road.buildings), _Areas(road.water)
        lines = [one.points_m for one in road.edges if len(one.points_m) > 1]
        row = np.repeat(np.arange(len(lines)), [len(one) for one in lines])
        points = np.concatenate([np.empty((0, 2)), *lines])
        edges = np.asarray(shapely.linestrings(points, indices=row))
        self._edges = shapely.STRtree(edges)
        self._edge_z_m = self._heights_m(edges) if self._levels else np.zeros(len(edges))

    def _heights_m(self, edges: NDArray[Any]) -> Floats:
        """(N) of lanes beside edges; nan without. Outlines of junctions have no own heights."""
        middles = shapely.get_coordinates(
            shapely.line_interpolate_point(edges, 0.5, normalized=True)
        )
        feet = self._lanes.feet(middles, self.beside_m + self._lanes.widest_m)
        order = np.argsort(-np.hypot(*feet.away_m.T), kind="stable")
        found = np.full(len(edges), np.nan)
        found[feet.point[order]] = self._lanes.heights_m(feet)[order]  # the nearest comes last
        return found

    def indoors(self, points_m: Floats) -> Bools:
        """(N) whether points (N, 2) are inside a building as it is drawn, on whatever ground."""
        return self._buildings.near(np.asarray(shapely.points(points_m)), 0.0, None)

    def barred(self, points_m: Floats) -> Bools:
        """(N) whether points (N, 2) are inside a building or in water, or at a wall."""
        places = np.asarray(shapely.points(points_m))
        return self._buildings.near(places, _SHOULDER_M, None) | self._water.near(
            places, _SHOULDER_M, None
        )

    def holds(self, points_m: Floats, z_m: Floats | None = None) -> Bools:
        """(N) whether a person can be at points (N, 2).

        Heights (N) are needed where the road passes over itself; without them all levels count.
        """
        points, z_m = np.asarray(points_m, float), z_m if self._levels else None
        places = np.asarray(shapely.points(points))
        on_it, beside = self._by_lanes(points, z_m)
        on_it |= self._areas.near(places, _JOINT_M, z_m)
        rest = np.flatnonzero(~on_it)
        beside[rest] |= self._by_edges(places[rest], None if z_m is None else z_m[rest])
        left = rest[beside[rest]]
        on_it[left] = ~self.barred(points[left])
        return on_it

    def _by_lanes(self, points_m: Floats, z_m: Floats | None) -> tuple[Bools, Bools]:
        """(N) and (N): points on lanes; and beside lanes, but not over another road."""
        lanes = self._lanes
        on_it, beside = np.zeros((2, len(points_m)), bool)
        feet = lanes.feet(points_m, lanes.widest_m + self.beside_m)
        away = np.hypot(*feet.away_m.T) - lanes.reach_m[lanes.lane[feet.segment]] + MARGIN_M
        if z_m is None:
            on_it[feet.point[away <= 0]] = True
            beside[feet.point[away <= self.beside_m]] = True
            return on_it, beside
        above = z_m[feet.point] - lanes.heights_m(feet)
        level = np.abs(above) < CLEARANCE_M
        on_it[feet.point[level & (away <= 0)]] = True
        beside[feet.point[level & (away <= self.beside_m)]] = True
        beside[feet.point[(above >= CLEARANCE_M) & (away <= 0)]] = False
        return on_it, beside

    def _by_edges(self, places: NDArray[Any], z_m: Floats | None) -> Bools:
        found = np.zeros(len(places), bool)
        place, edge = self._edges.query(places, predicate="dwithin", distance=self.beside_m)
        if z_m is not None:
            place = place[np.abs(self._edge_z_m[edge] - z_m[place]) < CLEARANCE_M]
        found[place] = True
        return found


@per_road
def walkable(road: RoadMap) -> Walkable:
    """Of a road."""
    return Walkable(road)
