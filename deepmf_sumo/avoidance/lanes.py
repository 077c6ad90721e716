"""Where a car may swerve to beside the AV's path, and who keeps to a lane."""

from typing import Final

import numpy as np

from deepmf_sumo.avoidance.path import Path
from deepmf_sumo.datatypes import Bools, Floats, RoadMap
from deepmf_sumo.geometry import angles, road
from deepmf_sumo.geometry.ground import ground_of

BORDER_M: Final = 0.2
"""A car that is so far over its lane's border still keeps to the lane."""
_ALONG_M = 4.0
_ASIDE_M = 1.0
_FARTHEST_M = 5.0
_ALIGNED_RAD = np.pi / 4


def stays_on_road(
    road_map: RoadMap,
    path: Path,
    along_m: Floats,
    left_m: Floats,
    half_width_m: float,
    z_m: float = 0.0,
) -> Bools:
    """(M) whether the outer side of a car at (M, K) along and left of the path keeps to the road.

    Where the path itself is off all lanes (a car park, a driveway) the map does not know the road,
    and nothing is said against leaving it. ``z_m`` is the car's height at the least of ``along_m``:
    what is above or below its path is no road for it.
    """
    ways = np.arange(along_m.min(), along_m.max() + _ALONG_M, _ALONG_M)
    asides = np.arange(-_FARTHEST_M, _FARTHEST_M + _ASIDE_M / 2, _ASIDE_M)
    centre, heading = path.at(ways)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    grid = centre[:, None] + asides[:, None] * normal[:, None]
    heights = ground_of(road_map).follow(centre[None], np.array([z_m]))[0].repeat(len(asides))
    known = road.on_road(road_map, grid.reshape(-1, 2), heights).reshape(len(ways), len(asides))
    middle = len(asides) // 2
    allowed = known | ~known[:, middle : middle + 1]
    outer = left_m + np.sign(left_m) * half_width_m
    row = np.clip(np.rint((along_m - ways[0]) / _ALONG_M).astype(int), 0, len(ways) - 1)
    column = np.rint((outer + _FARTHEST_M) / _ASIDE_M).astype(int).clip(0, len(asides) - 1)
    swerved = np.abs(left_m) > _ASIDE_M / 2
    return np.asarray((allowed[row, column] | ~swerved).all(axis=1))


def keeps_lane(
    road_map: RoadMap, position_m: Floats, heading_rad: float, width_m: float, z_m: float = 0.0
) -> bool:
    """Whether a car drives within one lane of its direction, 0.2 m over the border at most."""
    pieces = road.pieces_near(road_map, position_m[None])
    on_it = road.covering(pieces, position_m[None])[0]
    if ground_of(road_map).has_levels:
        on_it &= road.at_height(pieces, position_m[None], np.array([z_m]))[0]
    aligned = np.abs(angles.difference(pieces.heading_rad, heading_rad)) < _ALIGNED_RAD
    normal = angles.unit(pieces.heading_rad + np.pi / 2)
    left = np.abs(((position_m - pieces.start_m) * normal).sum(-1))
    within = left + width_m / 2 <= pieces.reach_m - road.MARGIN_M + BORDER_M
    return bool((on_it & aligned & within).any())
