import numpy as np
import pytest

from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M, path_set, road_index
from deepmf_sumo.scene import RoadMap, SignalState

from tests.support.synthetic import crossing, lane, straight


def paths_at(position, heading, speed, signals=None, road=None):
    index = road_index(road or crossing())
    return path_set(index, np.array(position, float), heading, speed, signals or {})


def test_both_ways_through_the_crossing_are_found_and_the_fan_follows():
    found = paths_at((-50, 0.5), 0.0, 10.0)
    assert len(found.lanes) == 2
    assert found.info[:, 0].tolist() == [1] * 7 + [0] * 9
    assert found.info[:7, 1].tolist() == [0, 0, 1, 1, 1, 1, 1]
    ends = found.points_m[:2, 60]  # 120 m on
    assert sorted(np.round(ends[:, 0])) == pytest.approx([50.0, 120.0], abs=1.5)


def test_paths_begin_at_the_pose_with_its_heading_and_join_the_lane():
    found = paths_at((-50, 1.5), 0.2, 8.0)
    lines = found.points_m[found.valid]
    assert np.abs(lines[:, 0]).max() < 1e-9
    first = np.arctan2(lines[:, 1, 1], lines[:, 1, 0])
    assert np.abs(first[:2]).max() < 0.1
    cos, sin = np.cos(0.2), np.sin(0.2)
    across = lines[0, 20:30, 0] * sin + lines[0, 20:30, 1] * cos  # in the road's frame
    assert across == pytest.approx(-1.5, abs=0.05)


def test_nodes_are_as_far_apart_as_they_say():
    lines = paths_at((-50, 1.0), 0.1, 10.0).points_m[:7]
    apart = np.linalg.norm(np.diff(lines, axis=1), axis=-1)
    assert np.abs(apart[2:5] - NODE_SPACING_M).max() < 1e-9
    assert np.abs(apart[:2] - NODE_SPACING_M).max() < 0.2


def test_the_stop_line_ahead_and_its_colour_are_told():
    info = paths_at((-50, 0), 0.0, 10.0, {"through": SignalState.STOP}).info
    red = info[:2, 8] > 0
    assert red.sum() == 1
    assert info[:2][red][0, 6] == pytest.approx(40.0, abs=0.1)


def test_there_are_paths_without_any_lane():
    found = paths_at((0, 0), 1.0, 3.0, road=RoadMap(lanes={}))
    assert found.valid.sum() == 5
    assert not found.lanes
    assert found.points_m[0, 10] == pytest.approx([20.0, 0.0])


def test_duplicate_lanes_give_one_path():
    twins = [lane("a", straight((-50, 0), (50, 0))), lane("b", straight((-50, 0.5), (50, 0.5)))]
    road = RoadMap(lanes={each.id: each for each in twins})
    assert len(paths_at((0, 0), 0.0, 5.0, road=road).lanes) == 1


def test_a_ring_of_lanes_ends():
    ring = [
        lane("a", straight((0, 0), (20, 0)), next=("b",)),
        lane("b", straight((20, 0), (20, 20)), next=("a",)),
    ]
    road = RoadMap(lanes={each.id: each for each in ring})
    assert paths_at((5, 0), 0.0, 20.0, road=road).lanes == ((0, 1),)


def test_the_oncoming_lane_is_no_start():
    assert not paths_at((-50, 0), np.pi, 5.0).lanes
