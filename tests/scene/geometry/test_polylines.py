"""Polylines on numbers worked out by hand, and against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deepmf_sumo.scene.geometry import polylines

CORNER = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])


def test_arc_lengths():
    assert polylines.arc_lengths(CORNER).tolist() == [0, 10, 20]


def test_points_at_goes_straight_on_past_both_ends():
    points, headings = polylines.points_at(CORNER, np.array([-2.0, 5.0, 10.0, 15.0, 23.0]))
    assert points == pytest.approx(np.array([[-2, 0], [5, 0], [10, 0], [10, 5], [10, 13]]))
    assert headings == pytest.approx(np.array([0, 0, np.pi / 2, np.pi / 2, np.pi / 2]))


def test_points_at_survives_repeated_points():
    doubled = np.repeat(CORNER, 2, axis=0)
    points, _ = polylines.points_at(doubled, np.array([5.0, 15.0]))
    assert points == pytest.approx(np.array([[5, 0], [10, 5]]))


def test_project_gives_arc_length_and_side():
    foot = polylines.project(CORNER, np.array([[4.0, 1.0], [11.0, 6.0]]))
    assert foot.along_m == pytest.approx(np.array([4, 16]))
    assert foot.left_m == pytest.approx(np.array([1, -1]))
    assert foot.distance_m == pytest.approx(np.array([1, 1]))


@given(arrays(float, (5, 2), elements=st.floats(-50, 50)), st.floats(-60, 60), st.floats(-60, 60))
def test_project_distance_agrees_with_shapely(points, x, y):
    points = points + np.arange(5)[:, None] * 0.01
    distance = polylines.project(points, np.array([x, y])).distance_m
    assert float(distance) == pytest.approx(
        shapely.LineString(points).distance(shapely.Point(x, y)), abs=1e-5
    )


def test_resample_keeps_both_ends_and_the_spacing():
    points = polylines.resample(CORNER, 3.0)
    assert points[0].tolist() == [0, 0]
    assert points[-1] == pytest.approx(np.array([10, 10]))
    assert np.diff(polylines.arc_lengths(points)).max() <= 3.0 + 1e-9
