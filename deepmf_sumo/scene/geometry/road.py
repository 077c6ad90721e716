"""Whether points are on the road, and whether vehicles drive against its direction."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road

_AGAINST_RAD = 2 * np.pi / 3
_ALONG = 0.5  # cosine: within 60 degrees of the lane
_LENGTHWISE = np.cos(np.pi / 6)


@per_road
def lanes_for_cars(road: RoadMap) -> LaneMap:
    """All lanes but cycle lanes, as they are drawn."""
    return LaneMap.of(
        [one for one in road.lanes.values() if one.kind != "bike" and len(one.centre_m) > 1]
    )


@per_road
def all_lanes(road: RoadMap) -> LaneMap:
    """All lanes, cycle lanes included, as they are drawn."""
    return LaneMap.of([one for one in road.lanes.values() if len(one.centre_m) > 1])


class Covering(NamedTuple):
    """K pairs of a point and a segment of a centre line that it is on.

    Attributes:
        point: (K) row of the point. lane: (K) row of the lane in `lanes_for_cars`.
        start_m: (K, 2) of the segment. heading_rad, reach_m: (K) of the lane there.
    """

    point: Ints
    lane: Ints
    start_m: Floats
    heading_rad: Floats
    reach_m: Floats


def covering(
    road: RoadMap, points_m: Floats, z_m: Floats | None = None, *, bicycles: bool = False
) -> Covering:
    """Segments that points (N, 2) are on: within half a lane's width and 0.5 m of them.

    Where roads cross the lane must be at the points' heights (N), if these are given: a vehicle
    that has left a bridge over its side is not on the road below. ``bicycles``: of `all_lanes`.
    """
    lanes = all_lanes(road) if bicycles else lanes_for_cars(road)
    feet = lanes.feet(points_m, lanes.widest_m)
    reach = lanes.reach_m[lanes.lane[feet.segment]]
    on_it = (feet.away_m**2).sum(axis=-1) <= reach**2
    if z_m is not None and ground_of(road).has_levels:
        on_it &= ~clear(lanes.heights_m(feet), np.asarray(z_m, float)[feet.point])
    segment = feet.segment[on_it]
    x, y = lanes.vector_m[segment].T
    return Covering(
        point=feet.point[on_it],
        lane=lanes.lane[segment],
        start_m=lanes.start_m[segment],
        heading_rad=np.arctan2(y, x),
        reach_m=reach[on_it],
    )


def on_road(
    road: RoadMap, points_m: Floats, z_m: Floats | None = None, *, bicycles: bool = False
) -> Bools:
    """(N) whether points (N, 2) are on a lane, see `covering`; no cycle lanes by default."""
    on_it = np.zeros(len(points_m), bool)
    on_it[covering(road, points_m, z_m, bicycles=bicycles).point] = True
    return on_it


def against_traffic(
    road: RoadMap, points_m: Floats, course_rad: Floats, z_m: Floats | None = None,
    *, bicycles: bool = False,
) -> Bools:  # fmt: skip
    """(N) points on the road where all lanes run against the course (N), by more than 120 degrees.

    A point on no lane is not against any: False. Heights (N), ``bicycles`` as in `covering`.
    """
    under = covering(road, points_m, z_m, bicycles=bicycles)
    turn = np.cos(np.asarray(course_rad, float)[under.point] - under.heading_rad)
    on_it, along = np.zeros((2, len(points_m)), bool)
    on_it[under.point] = True
    along[under.point[turn > np.cos(_AGAINST_RAD)]] = True
    return on_it & ~along


def along_lanes(
    road: RoadMap, points_m: Floats, course_rad: Floats, z_m: Floats | None = None
) -> Bools:
    """(N) points on the road where the course (N) is within 30 degrees of all lanes, either way.

    In junctions lanes lie in several directions: nobody goes along all of them. Heights (N) as in
    `covering`.
    """
    under = covering(road, points_m, z_m)
    turn = np.abs(np.cos(np.asarray(course_rad, float)[under.point] - under.heading_rad))
    on_it, across = np.zeros((2, len(points_m)), bool)
    on_it[under.point] = True
    across[under.point[turn < _LENGTHWISE]] = True
    return on_it & ~across


def limit_mps(
    road: RoadMap, points_m: Floats, course_rad: Floats, z_m: Floats | None = None
) -> Floats:
    """(N) speed limits where points (N, 2) are on lanes that run within 60 degrees of the course.

    Of several lanes the highest; nan on none, and where no limit is known. Heights (N) as in
    `covering`.
    """
    under, lanes = covering(road, points_m, z_m), lanes_for_cars(road).lanes
    known = np.array([one.speed_limit_mps or np.nan for one in lanes], float)
    along = np.cos(np.asarray(course_rad, float)[under.point] - under.heading_rad) > _ALONG
    found = np.full(len(points_m), np.nan)
    np.fmax.at(found, under.point[along], known[under.lane[along]])
    return found
