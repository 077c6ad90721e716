"""Parts of a road map near a path: recorded scenes contain no more of a road."""

from collections.abc import Container, Iterable
from dataclasses import replace

import numpy as np
import shapely

from deepmf_sumo.scene import Boundary, Floats, Lane, Neighbour, RoadMap


class Excerpts:
    """Excerpts of one road map, whose features are indexed once."""

    def __init__(self, road: RoadMap) -> None:
        self._road = road
        shapes: list[Floats] = [lane.centre_m for lane in road.lanes.values()]
        shapes += [one.points_m for one in (*road.lines, *road.edges)]
        shapes += [one.points_m for one in road.polygons]
        shapes += [sign.position_m.reshape(1, 2) for sign in road.stop_signs]
        self._tree = shapely.STRtree([_geometry(shape) for shape in shapes])

    def near(self, path_m: Floats, radius_m: float) -> RoadMap:
        """The features within a radius of a path (P, 2), each as a whole.

        Lanes do not refer to neighbours, successors, predecessors and lines that are left out.
        """
        found = self._tree.query(_geometry(path_m), predicate="dwithin", distance=radius_m)
        kept = np.zeros(len(self._tree.geometries), bool)
        kept[found] = True
        road, taken = self._road, iter(kept.tolist())
        lanes = {name: lane for name, lane in road.lanes.items() if next(taken)}
        lines = tuple(one for one in road.lines if next(taken))
        edges = tuple(one for one in road.edges if next(taken))
        borders = {one.id for one in (*lines, *edges)}
        return RoadMap(
            lanes={name: _without(lane, lanes.keys(), borders) for name, lane in lanes.items()},
            lines=lines,
            edges=edges,
            polygons=tuple(one for one in road.polygons if next(taken)),
            stop_signs=tuple(
                replace(sign, lane_ids=tuple(name for name in sign.lane_ids if name in lanes))
                for sign in road.stop_signs
                if next(taken)
            ),
        )


def _geometry(points_m: Floats) -> shapely.Geometry:
    # shapely finds no line without a length
    still = bool((points_m == points_m[0]).all())
    return shapely.Point(points_m[0]) if still else shapely.LineString(points_m)


def _without(lane: Lane, lanes: Container[str], borders: Container[str]) -> Lane:
    """The lane, without references to lanes and lines that are left out."""

    def neighbours(beside: Iterable[Neighbour]) -> tuple[Neighbour, ...]:
        return tuple(one for one in beside if one.lane_id in lanes)

    def boundaries(beside: Iterable[Boundary]) -> tuple[Boundary, ...]:
        return tuple(one for one in beside if one.feature_id in borders)

    return replace(
        lane,
        next=tuple(name for name in lane.next if name in lanes),
        previous=tuple(name for name in lane.previous if name in lanes),
        left=neighbours(lane.left),
        right=neighbours(lane.right),
        left_boundaries=boundaries(lane.left_boundaries),
        right_boundaries=boundaries(lane.right_boundaries),
    )
