"""Where people can be: lanes, sidewalks, the verge; no walls, no water, no air beside a bridge."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import Polygon, Polyline
from deepmf_sumo.scene.geometry.walkable import walkable

from tests.scene.geometry.test_ground import BELOW, CROSSING, road


def area(kind, low, high, z_m=0.0):
    (left, bottom), (right, top) = low, high
    points = np.array([(left, bottom), (right, bottom), (right, top), (left, top)], float)
    return Polygon(id=kind, kind=kind, points_m=points, z_m=np.full(4, z_m))


STREET = replace(road(BELOW), footways=())  # 3.2 m wide, along y = 0


def holds(road_map, *points, z_m=None):
    places = np.array(points, float)
    return walkable(road_map).holds(places, z_m and np.full(len(places), z_m)).tolist()


def test_a_verge_of_two_metres_is_beside_a_lane():
    assert holds(STREET, (0, 0), (0, 1.5), (0, 3.55), (0, 3.65), (0, -3.55), (0, -3.65)) == [
        True, True, True, False, True, False,
    ]  # fmt: skip


def test_where_no_sidewalks_are_mapped_ten_metres_are():
    recorded = replace(STREET, footways=None)
    assert holds(recorded, (0, 11.5), (0, 11.7)) == [True, False]
    edge = Polyline(id="e", kind=1, points_m=np.array([(-9, 8.0), (9, 8.0)]), z_m=np.zeros(2))
    assert holds(replace(recorded, edges=(edge,)), (0, 17.9), (0, 18.1)) == [True, False]


def test_sidewalks_crossings_and_walking_areas_count_in_themselves_alone():
    walked = area("footway", (-10, 8), (10, 12))
    crossing = area("crosswalk", (30, 8), (34, 20))
    map_ = replace(STREET, footways=(walked,), polygons=(crossing,))
    assert holds(map_, (0, 10), (0, 12.05), (0, 12.5), (32, 15), (36, 15)) == [
        True, True, False, True, False,
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["building", "water"])
def test_nobody_is_inside_a_house_or_in_water_beside_the_road(kind):
    barred = area(kind, (-5, 2.4), (5, 20))
    map_ = replace(STREET, **{"buildings" if kind == "building" else kind: (barred,)})
    # the wall of a house reaches a shoulder's width into the verge
    assert holds(map_, (0, 3), (0, 2.2), (0, 2.0), (6, 3)) == [False, False, True, True]


def test_roads_and_sidewalks_pass_through_houses_and_over_water():
    over = area("water", (-50, -50), (50, 50))
    walked = area("footway", (-10, 8), (10, 12))
    map_ = replace(STREET, water=(over,), buildings=(over,), footways=(walked,))
    assert holds(map_, (0, 0), (0, 10), (0, 2)) == [True, True, False]


def test_beside_a_bridge_is_air():
    levels = replace(CROSSING, footways=())  # above y = 0 the bridge along x = 0 is 8 m up
    assert holds(levels, (0, 0), (1.5, 0), (3, 0), (3, 20), z_m=8.0) == [True, True, False, True]
    assert holds(levels, (0, 0), (3, 0), (20, 3), (0, 20), z_m=0.1) == [True, True, True, False]
    assert holds(levels, (0, 20)) == [True]  # no height is asked for


def test_sidewalks_and_edges_climb_with_the_road():
    """A person at the foot of a long slope is on its sidewalk, and beside its edge; not above."""
    strip = area("footway", (100, 100), (500, 103))
    strip = replace(strip, z_m=strip.points_m[:, 0] / 10 - 10)
    levels = replace(CROSSING, footways=(strip,))
    for x in (105.0, 300.0, 495.0):
        assert holds(levels, (x, 101.5), z_m=x / 10 - 10 + 0.3) == [True]
        assert holds(levels, (x, 101.5), z_m=x / 10 - 10 + 4.0) == [False]
    kerb = np.array([(100.0, 100.0), (500.0, 100.0)])
    edge = Polyline(id="e", kind=1, points_m=kerb, z_m=np.array([0.0, 40.0]))
    recorded = replace(CROSSING, footways=None, edges=(edge,))
    for x in (105.0, 300.0, 495.0):
        assert holds(recorded, (x, 105.0), z_m=x / 10 - 10 + 0.3) == [True]
        assert holds(recorded, (x, 105.0), z_m=x / 10 - 10 + 4.0) == [False]
