"""Heights on roads that cross on two levels, checked by hand."""

import numpy as np
import pytest

from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.scene.geometry.ground import (
    CLEARANCE_M,
    clear,
    distance_m,
    ground_of,
    off_level,
    on_nearest_level,
)


def lane(name, points, **more):
    xyz = np.array(points, float)
    return Lane(id=name, kind="street", centre_m=xyz[:, :2], z_m=xyz[:, 2], width_m=3.2, **more)


def road(*lanes):
    return RoadMap(lanes={one.id: one for one in lanes})


BELOW = lane("below", [(-200, 0, 0), (200, 0, 0)])
BRIDGE = lane("bridge", [(0, -110, 0), (0, -30, 8), (0, 30, 8), (0, 110, 0)])
CROSSING = road(BELOW, BRIDGE)


def test_clearance():
    assert clear(0.0, CLEARANCE_M)
    assert not clear(np.array([0.0, 2.0]), np.array([2.4, 0.0])).any()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_paths_keep_to_their_level(side):
    ground = ground_of(CROSSING)
    assert ground.has_levels
    along = side * np.linspace(-150, 150, 301)
    over = np.stack([np.zeros_like(along), along], axis=-1)
    under = over[:, ::-1]
    z = ground.follow(np.stack([over, under]), np.zeros(2))
    expected = np.clip((110 - np.abs(along)) / 10, 0, 8)
    np.testing.assert_allclose(z[0], expected, atol=0.4)
    np.testing.assert_array_equal(z[1], 0.0)


def test_a_height_above_the_road_is_kept():
    """Recorded heights are those of the vehicles' middles."""
    up = np.stack([np.zeros(81), np.linspace(-110, -30, 81)], axis=-1)
    z = ground_of(CROSSING).follow(up[None], np.array([0.8]))
    np.testing.assert_allclose(z[0], 0.8 + np.linspace(0, 8, 81), atol=0.4)


def test_off_the_road_nobody_falls():
    """Over the railing of the bridge, and on over the road below."""
    path = np.stack([np.linspace(0, 60, 121), np.linspace(3, 0, 121)], axis=-1)
    np.testing.assert_allclose(ground_of(CROSSING).follow(path[None], np.array([8.0]))[0], 8.0)


def test_one_slope_is_one_level():
    hill = road(lane("up", [(0, 0, 0), (100, 0, 15)]), lane("beside", [(0, 4, 0), (100, 4, 15)]))
    assert not ground_of(hill).has_levels
    z = ground_of(hill).follow(np.array([[[0.0, 0.0], [40.0, 1.0], [80.0, 4.0]]]), np.zeros(1))
    assert z[0, 1] == 0.0  # 40 m at once are no step of a vehicle
    fine = np.stack([np.linspace(0, 80, 81), np.zeros(81)], axis=-1)
    assert ground_of(hill).follow(fine[None], np.zeros(1))[0, -1] == pytest.approx(12.0, abs=0.05)
    assert not off_level(hill, np.zeros(2), 0.0, np.array([[80.0, 0.0]]), np.array([12.0])).any()


def test_a_flat_road_costs_nothing_and_changes_nothing():
    flat = road(lane("one", [(0, 0, 5), (100, 0, 5)]), lane("two", [(50, -50, 5), (50, 50, 5)]))
    ground = ground_of(flat)
    assert not ground.has_levels
    np.testing.assert_array_equal(ground.follow(np.ones((2, 4, 2)), np.array([5.0, 6.0]))[1], 6.0)
    assert not ground_of(RoadMap(lanes={})).has_levels


def test_who_is_on_another_level():
    """AV below, 20 m before the bridge: one on the bridge, one behind it, one at its foot."""
    others = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, -108.0]])
    heights = np.array([8.0, 0.0, 0.2])
    found = off_level(CROSSING, np.array([-20.0, 0.0]), 0.0, others, heights)
    assert found.tolist() == [True, False, False]


def test_distance_in_height_counts_beyond_the_clearance():
    found = distance_m(np.array([0.0, 3.0, 3.0, 0.0]), np.zeros(4), np.array([8.0, 6.5, 2.4, 2.4]))
    np.testing.assert_allclose(found, [5.5, 5.0, 3.0, 0.0])


def test_nearest_levels_of_groups():
    group, heights = np.array([7, 7, 7, 2, 2]), np.array([0.0, 8.0, 7.0, 0.0, 8.0])
    found = on_nearest_level(group, heights, np.array([8.5, 8.5, 8.5, 1.0, 1.0]))
    assert found.tolist() == [False, True, True, True, False]
    assert on_nearest_level(group[:0], heights[:0], np.zeros(())).shape == (0,)
