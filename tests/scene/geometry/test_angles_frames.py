"""Angles and frames: round trips and worked numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepmf_sumo.scene.geometry import frames

finite = st.floats(-1e4, 1e4)
angle = st.floats(-np.pi, np.pi)


@given(finite)
def test_wrap_keeps_the_direction_and_the_range(value):
    wrapped = float(frames.wrap(value))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(value), abs=1e-8)
    assert np.sin(wrapped) == pytest.approx(np.sin(value), abs=1e-8)


def test_wrap_takes_pi_and_not_minus_pi():
    assert float(frames.wrap(-np.pi)) == pytest.approx(np.pi)


def test_difference_is_the_short_way_round():
    assert float(frames.difference(np.radians(-170), np.radians(170))) == pytest.approx(
        np.radians(20)
    )


@given(finite, finite, finite, finite, angle)
def test_local_and_back_is_the_identity(x, y, origin_x, origin_y, heading):
    origin = np.array([origin_x, origin_y])
    there = frames.to_local(np.array([x, y]), origin, heading)
    assert frames.to_scene(there, origin, heading) == pytest.approx(np.array([x, y]), abs=1e-6)


def test_what_is_left_of_a_car_heading_north_is_west():
    local = frames.to_local(np.array([-3.0, 0.0]), np.zeros(2), np.pi / 2)
    assert local == pytest.approx(np.array([0.0, 3.0]))


def test_rotate_turns_counter_clockwise():
    assert frames.rotate(np.array([1.0, 0.0]), np.pi / 2) == pytest.approx(np.array([0.0, 1.0]))
