"""Lane changes glide; all else is shown as SUMO has it."""

import numpy as np
import pytest

from deepmf_sumo.simulation.frame import Pose
from deepmf_sumo.simulation.glide import Glide


def pose(x, y=0.0, heading=0.0, speed=10.0):
    return Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)


def test_a_lane_change_takes_three_seconds_and_ends_on_the_new_lane():
    glide = Glide(pose(0.0))
    shown = [glide.follow(pose(step + 1.0, 3.2)) for step in range(40)]
    sideways = np.diff([0.0, *(one.y_m for one in shown)])
    assert np.abs(sideways).max() < 0.15
    assert shown[14].y_m == pytest.approx(1.6, abs=0.2)
    assert shown[-1] == pose(40.0, 3.2)


def test_a_standing_vehicle_does_not_move_sideways():
    glide = Glide(pose(0.0, speed=0.0))
    assert glide.follow(pose(0.0, 3.2, speed=0.0)).y_m == pytest.approx(0.0, abs=1e-9)


def test_a_bend_is_shown_as_it_is():
    angle = 0.05 * np.arange(60)
    poses = [pose(20 * np.sin(a), 20 * (1 - np.cos(a)), a) for a in angle]
    glide = Glide(poses[0])
    for one in poses[1:]:
        shown = glide.follow(one)
        assert np.hypot(shown.x_m - one.x_m, shown.y_m - one.y_m) < 1e-9


def test_a_start_askew_turns_gently_and_a_teleport_is_not_hidden():
    glide = Glide(pose(0.0, heading=0.4))
    assert glide.follow(pose(1.0)).heading_rad == pytest.approx(0.37, abs=0.05)
    far = pose(1.0, 50.0)
    assert Glide(pose(0.0)).follow(far) == far
