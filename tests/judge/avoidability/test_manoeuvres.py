"""The search over the AV's own braking and steering."""

import numpy as np
import pytest

from deepmf_sumo.judge.avoidability import manoeuvres
from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.judge.avoidability.manoeuvres import GRID, GRIP_MPS2, LATERAL_MPS2


def steadily(path, speed, steps, start=0.0):
    """The manoeuvres of an AV that keeps its speed."""
    return manoeuvres.drive(path, start + speed * 0.1 * np.arange(steps), 0.1)


STRAIGHT = AvPath.through(np.zeros((1, 2)), np.zeros(1), np.empty((0, 2)))


def test_about_a_hundred_manoeuvres_within_the_grip():
    assert 90 <= len(GRID.offset_m) <= 130
    assert np.hypot(GRID.braking_mps2, GRID.lateral_mps2).max() <= GRIP_MPS2
    assert {0.0, GRIP_MPS2} <= set(GRID.braking_mps2[GRID.lateral_mps2 == 0])
    assert GRID.lateral_mps2.max() == LATERAL_MPS2


@pytest.mark.parametrize("speed", [5.0, 15.0, 30.0])
def test_a_car_can_drive_them(speed):
    driven = steadily(STRAIGHT, speed, 100)
    along, left = driven.along_m, driven.left_m
    stopped = np.abs(along[:, -1] - speed**2 / (2 * np.maximum(GRID.braking_mps2, 1e-9))) < 0.01
    assert stopped[GRID.braking_mps2 * 9.9 > speed].all()
    speeds = np.diff(along, axis=1) / 0.1
    np.testing.assert_allclose(np.diff(speeds, axis=1).min(axis=1) / 0.1, -GRID.braking_mps2,
                               atol=0.01)  # fmt: skip
    aside = np.diff(left, n=2, axis=1) / 0.01
    assert np.abs(aside).max() <= GRIP_MPS2
    assert (np.abs(left) <= np.abs(GRID.offset_m)[:, None] + 1e-9).all()
    assert (left * GRID.offset_m[:, None] >= 0).all()


def test_they_end_beside_the_path_and_along_it():
    driven = steadily(STRAIGHT, 20.0, 60)
    rolling = GRID.braking_mps2 <= 2
    np.testing.assert_allclose(driven.left_m[rolling, -1], GRID.offset_m[rolling], atol=0.05)
    assert np.abs(driven.heading_rad[rolling, -1]).max() < 0.02
    np.testing.assert_allclose(driven.centre_m[..., 1], driven.left_m)


def test_the_time_of_a_lane_change_is_that_of_full_lateral_acceleration():
    """Half of the way speeding up, half slowing down: 2 sqrt(d / a), and up to 0.3 s for steps."""
    driven = steadily(STRAIGHT, 25.0, 80)
    for row in np.flatnonzero((GRID.braking_mps2 == 0) & (GRID.offset_m > 0)):
        offset, lateral = GRID.offset_m[row], GRID.lateral_mps2[row]
        done = np.flatnonzero(driven.left_m[row] >= 0.9 * offset)[0] * 0.1
        assert done <= 2 * np.sqrt(offset / lateral) + 0.3


def test_at_low_speed_the_turning_circle_limits_the_swerve():
    """At 3 m/s on a circle of 5 m: 1.8 m/s2, and at most 1.5 m/s aside."""
    driven = steadily(STRAIGHT, 3.0, 60)
    rolling = GRID.braking_mps2 == 0
    rate = np.diff(driven.left_m[rolling], axis=1) / 0.1
    assert 1.7 < np.abs(np.diff(rate, axis=1)).max() / 0.1 <= 1.8 + 1e-9
    assert 1.3 < np.abs(rate).max() <= 1.5 + 1e-9


def test_a_car_that_stands_stays():
    driven = steadily(STRAIGHT, 0.0, 40, start=3.0)
    assert np.ptp(driven.centre_m[..., 0]) == 0
    assert np.abs(driven.left_m).max() == 0


def test_bends_take_their_share_of_the_grip():
    turn = np.linspace(0, np.pi, 100)
    bend = np.stack([25 * np.sin(turn), 25 * (1 - np.cos(turn))], -1)
    path = AvPath.through(np.zeros((1, 2)), np.zeros(1), bend)
    slow = steadily(path, 3.0, 40).holds
    fast = steadily(path, 12.0, 40).holds  # 5.8 m/s2 in the bend alone
    assert slow.all()
    assert not fast[(GRID.lateral_mps2 >= 4)].any()
    assert fast[(GRID.lateral_mps2 == 0) & (GRID.braking_mps2 <= 4)].all()


def test_some_drive_as_the_av_did_and_swerve():
    seconds = np.arange(50) * 0.1
    starting = seconds**2  # from standstill with 2 m/s2
    driven = manoeuvres.drive(STRAIGHT, starting, 0.1)
    np.testing.assert_allclose(driven.along_m[GRID.as_driven], np.tile(starting, (25, 1)))
    reached = driven.left_m[GRID.as_driven & (GRID.offset_m == 2.0)][:, -1]
    assert (reached > 1.5).all()
    assert np.abs(driven.along_m[~GRID.as_driven]).max() < 0.6
