"""Heights of tracks that have none, where roads lie above each other."""

import time

import numpy as np
import pytest

from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.scene.readers.raw.ground import ground_m


def lane(name, *xyz, step_m=5.0):
    xyz = np.array(xyz, float)
    along = np.linspace(0.0, 1.0, int(np.linalg.norm(xyz[1] - xyz[0]) / step_m) + 1)
    points = xyz[0] + along[:, None] * (xyz[1] - xyz[0])
    return Lane(id=name, kind="street", centre_m=points[:, :2], z_m=points[:, 2])


def road(*lanes):
    return RoadMap(lanes={one.id: one for one in lanes}, lines=(), edges=(), polygons=(),
                   stop_signs=())  # fmt: skip


def straight(begin, end, steps=50):
    """One agent's (1, T, 2) positions, its headings and where it is valid."""
    position = np.linspace(begin, end, steps)[None]
    x, y = np.subtract(end, begin)
    return position, np.full((1, steps), np.arctan2(y, x)), np.ones((1, steps), bool)


BRIDGE = road(
    lane("below", (-100, 0, 20), (100, 0, 24)),  # climbs eastwards
    lane("back", (100, 3.5, 24), (-100, 3.5, 20)),
    lane("bridge", (0, -100, 28), (0, 100, 28)),
    lane("bridge back", (3.5, 100, 28), (3.5, -100, 28)),
)


@pytest.mark.parametrize("y", [0.0, 3.5, 1.5])
def test_who_drives_below_a_bridge_stays_below_it(y):
    track = straight((-60.0, y), (60.0, y))
    expected = 22 + 0.02 * track[0][0, :, 0]
    assert ground_m(BRIDGE, *track)[0] == pytest.approx(expected, abs=0.05)


def test_who_drives_on_the_bridge_stays_on_it():
    for x in (0.0, 3.5):
        assert ground_m(BRIDGE, *straight((x, -60.0), (x, 60.0)))[0] == pytest.approx(28.0)


@pytest.mark.parametrize(("heading", "height"), [(0.0, 22.0), (np.pi, 22.0), (np.pi / 2, 28.0)])
def test_who_stands_is_on_the_road_that_leads_its_way(heading, height):
    position = np.zeros((1, 30, 2))
    found = ground_m(BRIDGE, position, np.full((1, 30), heading), np.ones((1, 30), bool))
    assert found[0] == pytest.approx(height, abs=0.05)


def test_parallel_decks_keep_the_level_that_a_track_comes_from():
    decks = road(
        lane("ramp", (-200, 0, 10), (-100, 0, 10)),
        lane("lower", (-100, 0, 10), (100, 0, 10)),
        lane("upper", (-100, 0.5, 16), (100, 0.5, 16)),
    )
    assert ground_m(decks, *straight((-150.0, 0.4), (80.0, 0.4)))[0] == pytest.approx(10.0)


def test_gaps_and_places_far_from_lanes():
    position, heading, valid = straight((-60.0, 0.0), (60.0, 0.0))
    valid[0, 10:20] = False
    position[0, :5] = (-60.0, 40.0)
    ground = ground_m(BRIDGE, position, heading, valid)[0]
    assert not ground[10:20].any()
    assert ground[:5] == pytest.approx(20.8, abs=0.05)  # of the nearest lane
    assert ground[20:] == pytest.approx(22 + 0.02 * position[0, 20:, 0], abs=0.05)


def test_roads_without_lanes_or_with_lanes_of_a_point():
    track = straight((0.0, 0.0), (10.0, 0.0))
    assert not ground_m(road(), *track).any()
    point = Lane(id="point", kind="street", centre_m=np.zeros((1, 2)), z_m=np.full(1, 7.0))
    assert ground_m(road(point), *track) == pytest.approx(7.0)


def test_a_lane_that_leads_to_and_fro_over_the_whole_map_takes_no_time():
    ends = np.tile([-9e5, 9e5], 500)
    points = np.column_stack([ends, np.linspace(-50.0, 50.0, len(ends))])
    lane = Lane(id="to and fro", kind="street", centre_m=points, z_m=np.full(len(points), 5.0))
    begin = time.process_time()
    assert ground_m(road(lane), *straight((0.0, 0.0), (10.0, 0.0))) == pytest.approx(5.0)
    assert time.process_time() - begin < 30.0
