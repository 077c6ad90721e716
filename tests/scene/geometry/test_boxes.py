"""Oriented boxes against shapely, which knows nothing of separating axes."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from deepmf_sumo.scene.geometry import boxes

coordinate = st.floats(-20, 20)
angle = st.floats(-np.pi, np.pi)
side = st.floats(0.3, 12)
box = st.tuples(st.tuples(coordinate, coordinate), angle, st.tuples(side, side))


def polygon(centre, heading, size):
    return shapely.Polygon(boxes.corners(np.array(centre), np.array(heading), np.array(size)))


def arrays(values):
    return tuple(np.array(value) for value in values)


@given(box, box)
def test_overlap_and_gap_agree_with_shapely(first, second):
    a, b = polygon(*first), polygon(*second)
    if abs(a.intersection(b).area) < 1e-6 and a.distance(b) < 1e-6:
        return  # mere touch: rounding decides
    assert bool(boxes.overlap(*arrays(first), *arrays(second))) == a.intersects(b)
    assert boxes.gap(*arrays(first), *arrays(second)) == pytest.approx(a.distance(b), abs=1e-6)


def test_corners_start_front_left_and_go_counter_clockwise():
    corners = boxes.corners(np.array([10.0, 0.0]), np.array(np.pi / 2), np.array([4.0, 2.0]))
    assert corners == pytest.approx(np.array([[9, 2], [9, -2], [11, -2], [11, 2]]))


def test_overlap_broadcasts_over_leading_axes():
    centres = np.array([[0.0, 0.0], [3.9, 0.0], [4.1, 0.0]])
    size = np.array([4.0, 2.0])
    hit = boxes.overlap(np.zeros(2), np.array(0.0), size, centres, np.zeros(3), size)
    assert hit.tolist() == [True, True, False]


def test_touching_is_no_overlap():
    size = np.array([4.0, 2.0])
    zero = np.array(0.0)
    assert not boxes.overlap(np.zeros(2), zero, size, np.array([4.0, 0.0]), zero, size)
