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
from deepmf_sumo.scene.geometry.polylines import heights_at
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
    """Polygons, and an index of them."""

    def __init__(self, polygons: tuple[Polygon, ...]) -> None:
        self._known = [one for one in polygons if len(one.points_m) > 2]
        rings = np.array([shapely.Polygon(one.points_m) for one in self._known], object)
        self._tree = shapely.STRtree(np.asarray(shapely.make_valid(rings), object))

    def near(self, points: NDArray[Any], reach_m: float, z_m: Floats | None) -> Bools:
        """(N) whether points are within reach of an area, at heights (N) if these are given.

        The height of an area at a point is that of the nearest place of its outline: sidewalks are
        long, and may climb.
        """
        found = np.zeros(len(points), bool)
        point, area = self._tree.query(points, predicate="dwithin", distance=reach_m)
        if z_m is None:
            found[point] = True
            return found
        for one in np.unique(area).tolist():
            here = point[area == one]
            corners, z = (
                _closed(part) for part in (self._known[one].points_m, self._known[one].z_m)
            )
            height = heights_at(corners, z, shapely.get_coordinates(points[here]))
            found[here[~clear(height, z_m[here])]] = True
        return found


def _closed(corners: Floats) -> Floats:
    return np.concatenate([corners, corners[:1]])


class _Edges:
    """The straight parts of the edges of a road, and an index of them."""

    def __init__(self, road: RoadMap) -> None:
        lines = [np.column_stack([one.points_m, one.z_m]) for one in road.edges]
        self._start = np.concatenate([np.empty((0, 3)), *(line[:-1] for line in lines)])
        self._step = np.concatenate([np.empty((0, 3)), *(np.diff(line, axis=0) for line in lines)])
        ends = np.stack([self._start, self._start + self._step], axis=1)[..., :2]
        self._tree = shapely.STRtree(np.asarray(shapely.linestrings(ends)))

    def near(self, points_m: Floats, reach_m: float, z_m: Floats | None) -> Bools:
        """(N) whether points (N, 2) are within reach of an edge, at heights (N) if given."""
        found = np.zeros(len(points_m), bool)
        places = np.asarray(shapely.points(points_m))
        point, edge = self._tree.query(places, predicate="dwithin", distance=reach_m)
        if z_m is not None:
            start, step = self._start[edge], self._step[edge]
            along = ((points_m[point] - start[:, :2]) * step[:, :2]).sum(axis=1)
            square = np.maximum((step[:, :2] ** 2).sum(axis=1), 1e-12)
            height = start[:, 2] + np.clip(along / square, 0.0, 1.0) * step[:, 2]
            point = point[~clear(height, z_m[point])]
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
        self._edges = _Edges(road)

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
        beside[rest] |= self._edges.near(
            points[rest], self.beside_m, z_m if z_m is None else z_m[rest]
        )
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


@per_road
def walkable(road: RoadMap) -> Walkable:
    """Of a road."""
    return Walkable(road)
