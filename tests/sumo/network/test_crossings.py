import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepmf_sumo.sumo.network import lane_graph
from deepmf_sumo.sumo.network.lane_graph import crossings


def line(*points):
    return np.array([(*point, 0.0)[:3] if len(point) == 2 else point for point in points], float)


def test_lanes_that_cross_are_a_pair_once():
    shapes = {"a": line((0, 0), (10, 0)), "b": line((5, -5), (5, 5)), "c": line((0, 9), (10, 9))}
    assert crossings(shapes) == [("a", "b")]


def test_lanes_that_join_or_split_do_not_cross():
    shapes = {
        "a": line((0, 0), (10, 0)),
        "follows": line((10, 0), (20, 5)),
        "beside": line((0, 0), (10, 5)),
        "ends on it": line((5, -5), (5, 0)),
    }
    assert crossings(shapes) == []


@pytest.mark.parametrize(("height", "pairs"), [(2.0, 1), (3.0, 0)])
def test_an_overpass_does_not_cross(height, pairs):
    shapes = {"a": line((0, 0), (10, 0)), "b": line((5, -5, height), (5, 5, height))}
    assert len(crossings(shapes)) == pairs


def test_single_points_and_nothing():
    assert crossings({}) == []
    assert crossings({"a": line((0, 0)), "b": line((0, 0), (1, 1))}) == []


@given(st.floats(0.0, 30.0), st.floats(0.0, 30.0))
def test_a_part_is_as_long_as_asked_and_on_the_line(one, two):
    points = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    start, end = sorted((one, two))
    part = lane_graph.part(points, start, end)
    length = np.hypot(*np.diff(part, axis=0).T).sum()
    assert length == pytest.approx(end - start, abs=1e-5)


def test_a_bridge_leaves_and_arrives_straight():
    before, after = np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([[20.0, 10.0], [20.0, 20.0]])
    bridge = lane_graph.bridge(before, after)
    assert bridge[0] == pytest.approx([10.0, 0.0])
    assert bridge[-1] == pytest.approx([20.0, 10.0])
    steps = np.diff(bridge, axis=0)
    assert abs(np.arctan2(*steps[0][::-1])) < 0.1
    assert np.arctan2(*steps[-1][::-1]) == pytest.approx(np.pi / 2, abs=0.1)


def test_the_speed_in_a_bend_is_that_of_its_radius():
    angle = np.linspace(0.0, np.pi / 2, 50)
    arc = 20.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert lane_graph.bend_speed_mps(arc) == pytest.approx(np.sqrt(5.5 * 20.0), rel=0.05)
    assert lane_graph.bend_speed_mps(np.array([[0.0, 0.0], [50.0, 0.0]])) > 100.0
