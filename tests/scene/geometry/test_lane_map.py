import gc
import time
import weakref
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.lane_assignment import lanes_at
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.report.map_layers import features
from deepmf_sumo.scene import Lane, RoadMap
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road
from deepmf_sumo.scene.geometry.road import on_road
from deepmf_sumo.sumo.network.matching import match


def lane(name, points):
    points = np.asarray(points, float)
    return Lane(id=name, kind="street", centre_m=points, z_m=np.zeros(len(points)), width_m=3.2)


def town(lanes):
    """Parallel streets of a hundred lanes of 50 m each, 20 m apart."""
    rows = []
    for number in range(lanes):
        row, column = divmod(number, 100)
        ends = (50 * column, 20 * row), (50 + 50 * column, 20 * row)
        rows.append(lane(f"{number}", np.linspace(*ends, 6)))
    return RoadMap(lanes={one.id: one for one in rows})


def winding(rng, count):
    """Lines of up to 60 points that wander about."""
    for _ in range(count):
        steps = rng.normal(1.0, 1.0, (int(rng.integers(0, 60)), 2))
        yield np.cumsum(steps, axis=0) + rng.uniform(-60, 60, 2)


def test_the_index_finds_what_a_look_at_every_segment_finds():
    rng = np.random.default_rng(3)
    lines = list(winding(rng, 40))
    lanes = LaneMap.of([lane(f"{n}", line) for n, line in enumerate(lines)])
    points = rng.uniform(-80, 100, (300, 2))
    feet = lanes.feet(points, 4.0)
    distance = np.hypot(*feet.away_m.T)
    found = set(zip(feet.point[distance <= 4.0], feet.segment[distance <= 4.0], strict=True))
    every = set()
    for segment, (start, vector) in enumerate(zip(lanes.start_m, lanes.vector_m, strict=True)):
        away = polylines.project(np.stack([start, start + vector]), points).distance_m
        every |= {(int(point), segment) for point in np.flatnonzero(away <= 4.0)}
    assert found == every
    assert (np.diff(feet.point) >= 0).all()
    assert (np.diff(feet.segment)[np.diff(feet.point) == 0] > 0).all()
    for number, point in enumerate(points):
        around = lanes.around(point, 4.0).tolist()
        assert around == sorted(around)
        assert {segment for one, segment in every if one == number} <= {*around}


def test_segments_belong_to_their_lanes_and_have_their_heights():
    slope = np.array([[0.0, 0.0], [10.0, 0.0]])
    high = Lane(id="up", kind="street", centre_m=slope, z_m=np.array([0.0, 5.0]))
    lanes = LaneMap.of([lane("none", np.empty((0, 2))), lane("point", [[3, 3]]), high])
    assert lanes.lane.tolist() == [2]
    assert lanes.first.tolist() == [0, 0, 0, 1]
    assert lanes.row == {"none": 0, "point": 1, "up": 2}
    feet = lanes.feet(np.array([[4.0, 1.0], [50.0, 50.0]]), 2.0)
    assert lanes.heights_m(feet).tolist() == [2.0]
    assert feet.point.tolist() == [0]


def test_a_map_without_lanes_finds_nothing():
    lanes = LaneMap.of([])
    assert len(lanes.around(np.zeros(2), 10.0)) == 0
    assert len(lanes.feet(np.zeros((3, 2)), 10.0).point) == 0


def test_what_is_prepared_for_a_road_is_kept_while_the_road_lives():
    made = []

    @per_road
    def size(road):
        made.append(len(road.lanes))
        return made[-1:]

    road = town(3)
    assert size(road) is size(road)
    assert made == [3]
    result, dead = weakref.ref(road), road_index(road).map.lanes
    match(road, np.zeros((1, 2)), np.zeros(1), np.ones(1, bool))
    lanes_at(road, np.zeros(2), 0.0)
    on_road(road, np.zeros((1, 2)))
    del road
    gc.collect()
    assert result() is None
    assert len(dead) == 3


def test_the_eight_roads_used_last_are_kept():
    made = []

    @per_road
    def noted(road):
        made.append(len(road.lanes))
        return len(made)

    first, second, *others = [town(count) for count in range(1, 10)]
    for road in (first, second, first, *others):
        noted(road)
    assert made == [*range(1, 10)]
    noted(first)
    assert made == [*range(1, 10)]
    noted(second)  # the one that was not used for the longest time
    assert made == [*range(1, 10), 2]


def seconds(look_up, road):
    """The least of several times: other processes only add to it."""
    times = []
    for _ in range(30):
        start = time.perf_counter()
        look_up(road)
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.slow_unit
def test_a_look_up_costs_about_the_same_in_a_town_twenty_times_as_large():
    pose, heading = np.array([1020.0, 1.0]), 0.0
    path = pose + np.stack([np.linspace(0, 90, 80), np.zeros(80)], axis=1)
    look_ups = {
        "feet": lambda road: road_index(road).feet(pose, heading, 6.5, 0.9),
        "lanes_at": lambda road: lanes_at(road, pose, heading),
        "on_road": lambda road: on_road(road, path),
        "match": lambda road: match(road, path, np.zeros(80), np.ones(80, bool)),
    }
    small, large = town(100), town(2_000)
    for name, look_up in look_ups.items():
        once, again = (seconds(look_up, road) for road in (small, large))
        assert again < 4 * once, f"{name}: {once:.2g} s in the small town, {again:.2g} s"


def test_a_lane_without_a_width_is_12_feet_wide_on_the_ground_and_in_pictures():
    ends = np.array([[0.0, 0.0], [50.0, 0.0]])
    unknown, stated = (replace(lane("a", ends), width_m=width) for width in (None, 12 * 0.3048))
    assert features(RoadMap(lanes={"a": unknown}))[0].width_m == pytest.approx(3.7, abs=0.05)
    for one in (unknown, stated):
        at = np.array([[25.0, 2.3], [25.0, -2.3], [25.0, 2.4]])  # half of it, and 0.5 m
        assert on_road(RoadMap(lanes={"a": one}), at, np.zeros(3)).tolist() == [True, True, False]
