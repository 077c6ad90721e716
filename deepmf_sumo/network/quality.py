"""How far the net's lanes are from the scene's."""

from collections.abc import Mapping
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.datatypes import Floats, LanePiece, RoadMap

SPACING_M: Final = 0.5


def distances(
    road: RoadMap,
    pieces: Mapping[str, tuple[LanePiece, ...]],
    lane_of: Mapping[str, tuple[str, ...]],
    shapes: Mapping[str, Floats],
) -> Floats:
    """Distances both ways, in one array.

    Every recorded point of a lane to the nearest of that lane's pieces, and points of the SUMO
    lanes, 0.5 m apart, to the nearest of the scene's lanes that they are made of. Lanes that only
    SUMO has (extensions, the ghost edge) are not counted.

    Args:
        road: the scene's, as recorded.
        pieces: scene lane -> its SUMO lanes.
        lane_of: SUMO lane -> its scene lanes.
        shapes: (P, 2) of each SUMO lane, as written.
    """
    recorded = {key: lane.centre_m for key, lane in road.lanes.items()}
    to_sumo = [
        (recorded[key], [shapes[piece.sumo_lane] for piece in parts])
        for key, parts in pieces.items()
        if parts
    ]
    to_scene = [
        (_dense(shapes[key]), [recorded[lane_id] for lane_id in lane_ids])
        for key, lane_ids in lane_of.items()
        if lane_ids
    ]
    return _to_lines(to_sumo + to_scene)


def _dense(points_m: Floats) -> Floats:
    points: Floats = shapely.get_coordinates(
        shapely.segmentize(shapely.linestrings(points_m), SPACING_M)
    )
    return points


def _to_lines(tasks: list[tuple[Floats, list[Floats]]]) -> Floats:
    """Distance of each point of each task to the nearest of the task's polylines."""
    if not tasks:
        return np.zeros(0)
    targets = np.array([_geometry(lines) for _, lines in tasks])
    shapely.prepare(targets)
    points = shapely.points(np.concatenate([points for points, _ in tasks]))
    owner = np.repeat(np.arange(len(tasks)), [len(points) for points, _ in tasks])
    distance: Floats = shapely.distance(targets[owner], points)
    return distance


def _geometry(lines: list[Floats]) -> shapely.Geometry:
    parts = [shapely.LineString(line if len(line) > 1 else line[[0, 0]]) for line in lines]
    return parts[0] if len(parts) == 1 else shapely.GeometryCollection(parts)
