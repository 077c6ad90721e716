"""Pedestrians and cyclists of recordings that a policy drives: SUMO's vehicles brake for them."""

import numpy as np
import pytest

from deepmf_sumo.planners import replay
from deepmf_sumo.planners import sumo as sumo_planner
from deepmf_sumo.scene import Driver, Plan
from deepmf_sumo.sumo.simulation import simulate

from tests.support.simulated_worlds import (
    LANE_M,
    NOW,
    case_of,
    scene_of,
    straight_motion,
    straight_road,
)

AT_M = 120.0


class StepsOut:
    """The walker goes 3 m at 1.5 m/s towards the right lane, and stands there for 4 s."""

    period_steps = None

    def reset(self, view, rng):
        return ("walker",)

    def plan(self, view):
        x, y = view.history.position_m[view.history.row("walker"), -1]
        gone = np.minimum(0.15 * np.arange(1, 61), 3.0)
        return {
            "walker": Plan(
                agent_id="walker",
                first_step=view.step + 1,
                position_m=np.column_stack([np.full(60, x), y - gone]),
                heading_rad=np.full(60, -np.pi / 2),
                speed_mps=np.where(gone < 3.0, 1.5, 0.0),
            )
        }


@pytest.fixture(scope="module", params=["pedestrian", "cyclist"])
def case(request, tmp_path_factory, starts_sumo):
    motions = {
        "av": straight_motion(40.0, 0.0, 0.0, 8.0),
        "b": straight_motion(70.0, LANE_M, 0.0, 9.0),
        "walker": straight_motion(AT_M, LANE_M + 3.0, -np.pi / 2, 0.0),
    }
    scene = scene_of(straight_road(), motions, kinds={"walker": request.param})
    return case_of(scene, tmp_path_factory.mktemp("people"), traffic="sumo")


def run(case, policy, planner=None):
    planner = planner or replay.build(replay.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0))


def test_it_is_where_the_plan_has_it_then_stops_where_the_log_does_not_have_it(case):
    rollout = run(case, StepsOut())
    row, (plan,) = rollout.tracks.row("walker"), rollout.plans
    driven = slice(NOW + 1, NOW + 61)
    assert rollout.tracks.position_m[row, driven] == pytest.approx(plan.position_m, abs=1e-9)
    assert (rollout.driver[row, NOW + 1 :] == Driver.POLICY).all()
    assert rollout.tracks.speed_mps[row, -1] == 0.0


def test_sumos_traffic_goes_around_it_and_straight_on_where_it_stays(case):
    attacked, alone = run(case, StepsOut()), run(case, None)
    b, walker = (attacked.tracks.row(one) for one in ("b", "walker"))
    beside = np.abs(attacked.tracks.position_m[b] - attacked.tracks.position_m[walker])
    passing = beside[:, 0] < 2.5
    assert passing.any()
    assert beside[passing, 1].min() > 1.4, "it has changed to the other lane"
    assert np.ptp(alone.tracks.position_m[b, :, 1]) < 0.5


def test_the_av_that_sumo_drives_brakes_for_it(case, tmp_path):
    """The twin that nobody attacks drives by."""
    motions = {
        "av": straight_motion(70.0, LANE_M, 0.0, 9.0),
        "walker": straight_motion(AT_M, LANE_M + 3.0, -np.pi / 2, 0.0),
    }
    tracks = case.scene.tracks
    kinds = {"walker": tracks.kinds[tracks.row("walker")]}
    alone = case_of(scene_of(straight_road(), motions, kinds=kinds), tmp_path)
    attacked, free = (
        run(alone, policy, sumo_planner.build(sumo_planner.Settings()))
        for policy in (StepsOut(), None)
    )
    av = attacked.tracks.row("av")
    assert not attacked.contacts
    assert attacked.tracks.position_m[av, -1, 0] < AT_M - 2.0
    assert attacked.tracks.speed_mps[av, -1] < 1.0
    assert free.tracks.position_m[av, -1, 0] > AT_M + 5.0
