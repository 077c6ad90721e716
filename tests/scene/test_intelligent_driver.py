"""The desired gap of the Intelligent Driver Model, against SUMO's own model."""

import pytest

from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.car_following import TREIBER, desired_gap_m
from deepmf_sumo.sumo.simulation import log_world

from tests.support.simulated_worlds import case_of, scene_of, straight_motion, straight_road


@pytest.fixture(scope="module")
def follow(tmp_path_factory, starts_sumo):
    """Speed that SUMO's driver with `TREIBER` has a step later, from speed, gap, leader's speed."""
    scene = scene_of(straight_road(), {"av": straight_motion(50.0, 0.0, 0.0, 10.0)})
    case = case_of(scene, tmp_path_factory.mktemp("following"))
    with log_world.opened(case, TREIBER, "libsumo") as (api, _):
        limit = api.vehicle.getAllowedSpeed("av")

        def speed_after(speed, gap_m, leader_mps):
            # SUMO counts gaps from where the driver wants to stop
            short = gap_m - TREIBER.gap_m
            return api.vehicle.getFollowSpeed("av", speed, short, leader_mps, 4.5, ""), limit

        yield speed_after


@pytest.mark.parametrize(
    ("speed", "gap_m", "leader_mps"),
    [(10.0, 30.0, 10.0), (10.0, 30.0, 6.0), (10.0, 25.0, 14.0), (5.0, 12.0, 4.0), (3.0, 8.0, 12.0)],
)
def test_a_step_of_sumo_is_that_of_the_formula(follow, speed, gap_m, leader_mps):
    after, limit = follow(speed, gap_m, leader_mps)
    wanted = desired_gap_m(TREIBER, speed, leader_mps, lambda keep: max(0.0, keep))
    free = 1 - (speed / limit) ** TREIBER.exponent
    expected = speed + TREIBER.accel_mps2 * (free - (wanted / gap_m) ** 2) * DT_S
    assert after == pytest.approx(expected, abs=1e-9)


def test_a_driver_who_is_left_behind_desires_the_least_gap_alone():
    assert desired_gap_m(TREIBER, 2.0, 30.0, lambda keep: max(0.0, keep)) == TREIBER.gap_m
