"""What a plan says of each step is what happens at that step, and what views show of it."""

from dataclasses import dataclass

import numpy as np
import pytest

from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.planners import replay
from deepmf_sumo.scene import FUTURE_STEPS, Forecast, Futures, Plan, Tracks
from deepmf_sumo.sumo.simulation import simulate

from tests.support.predictor_doubles import Doubles, FanPrediction, FanPredictor
from tests.support.simulated_worlds import (
    LANE_M,
    NOW,
    case_of,
    scene_of,
    straight_motion,
    straight_road,
)

pytestmark = pytest.mark.jumps("a plan of the predictor's double begins far away")


class KnowsTheLog(FanPredictor):
    """Predicts the AV's true future, whatever it is given."""

    def __init__(self, tracks):
        super().__init__()
        self.tracks = tracks

    def predict(self, view, agent_id, *, planner=False):
        return Logged(view, agent_id, tracks=self.tracks)


@dataclass
class Logged(FanPrediction):
    tracks: Tracks | None = None

    def given(self, futures, modes):
        row = self.tracks.row(self.agent_id)
        steps = np.minimum(self.view.step + 1 + np.arange(FUTURE_STEPS), self.tracks.steps - 1)
        known = Futures(
            agent_id=self.agent_id,
            position_m=self.tracks.position_m[row, steps][None],
            heading_rad=self.tracks.heading_rad[row, steps][None],
        )
        forecast = Forecast(futures=known, probability=np.ones(1))
        return [forecast] * (1 if futures is None else len(futures.position_m))


class Watched:
    """A policy, and the views it was given."""

    def __init__(self, policy):
        self.policy, self.views = policy, []

    @property
    def period_steps(self):
        return self.policy.period_steps

    def reset(self, view, rng):
        return self.policy.reset(view, rng)

    def plan(self, view):
        self.views.append(view)
        return self.policy.plan(view)


class Bend:
    """Drives an arc whose boxes are turned into the bend; plans again every second."""

    period_steps = 10

    def __init__(self, agent, slip_rad):
        self.agent, self.slip_rad, self.views = agent, slip_rad, []

    def reset(self, view, rng):
        return (self.agent,)

    def plan(self, view):
        self.views.append(view)
        angle = 0.02 * (view.step - NOW + np.arange(1, 81))
        position = np.column_stack([100 + 50 * np.sin(angle), 40 - 50 * np.cos(angle)])
        return {
            self.agent: Plan(
                agent_id=self.agent,
                first_step=view.step + 1,
                position_m=position,
                heading_rad=angle - self.slip_rad,
                speed_mps=np.full(80, 10.0),
            )
        }


def braking_motion(x, y, speed, decel):
    motion = straight_motion(x, y, 0.0, speed)
    time = np.maximum(0.1 * (np.arange(len(motion)) - NOW), 0.0)
    time = np.minimum(time, speed / decel)
    motion[NOW:, 0] = x + speed * time[NOW:] - decel * time[NOW:] ** 2 / 2
    motion[NOW:, 3] = speed - decel * time[NOW:]
    return motion


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The AV slows down; a car drives beside and behind it."""
    motions = {
        "av": braking_motion(60.0, 0.0, 12.0, 1.0),
        "ov": straight_motion(48.0, LANE_M, 0.0, 13.0),
    }
    return case_of(scene_of(straight_road(), motions), tmp_path_factory.mktemp("beside"))


@pytest.mark.parametrize("period_s", [None, 4.0, 1.0])
@pytest.mark.parametrize("rule", ["expected", "likeliest"])
def test_with_the_avs_future_known_the_contact_comes_at_the_step_that_the_plan_says(
    beside, period_s, rule
):
    predictors = Doubles(conditional=KnowsTheLog(beside.scene.tracks))
    settings = Settings(period_s=period_s, rule=rule, form={"reactions": 1})
    policy = Watched(build(settings, predictors))
    planner = replay.build(replay.Settings())
    rollout = simulate(beside, planner, policy, rng=np.random.default_rng(0))
    contact = rollout.first("av_opponent")
    assert contact is not None
    plan = rollout.plans[-1]
    expected = plan.first_step + plan.reason.collision_step[plan.reason.chosen, 0]
    assert contact.step == expected
    row, at = rollout.tracks.row("ov"), contact.step - plan.first_step
    assert np.abs(rollout.tracks.position_m[row, contact.step] - plan.position_m[at]).max() < 1e-9
    # every plan begins one step after the view it was made from
    assert [one.first_step for one in rollout.plans] == [one.step + 1 for one in policy.views]


def test_views_show_what_happened_and_nothing_more(beside):
    policy = Bend("ov", slip_rad=0.1)
    rollout = simulate(
        beside, replay.build(replay.Settings()), policy, rng=np.random.default_rng(0)
    )
    assert [view.step for view in policy.views] == list(range(NOW, NOW + 80, 10))
    for view in policy.views:
        shown, happened = view.history, rollout.tracks.window(view.step - 10, view.step + 1)
        assert shown.steps == 11
        assert shown.ids == happened.ids
        np.testing.assert_array_equal(shown.position_m, happened.position_m)
        np.testing.assert_array_equal(shown.velocity_mps, happened.velocity_mps)
        assert view.av_path_m is None
        assert view.steps_left == 90 - view.step


def test_the_velocity_of_who_slips_is_that_of_its_centre(beside):
    rollout = simulate(
        beside,
        replay.build(replay.Settings()),
        Bend("ov", slip_rad=0.1),
        rng=np.random.default_rng(0),
    )
    row = rollout.tracks.row("ov")
    driven = slice(NOW + 2, None)
    moved = np.gradient(rollout.tracks.position_m[row], 0.1, axis=0)[driven][:-1]
    shown = rollout.tracks.velocity_mps[row, driven][:-1]
    # where a new plan begins, the difference is one-sided
    assert np.median(np.hypot(*(moved - shown).T)) < 0.01
    assert np.hypot(*(moved - shown).T).max() < 0.25


def test_an_av_that_rolls_backwards_is_shown_so(tmp_path):
    motion = straight_motion(60.0, 0.0, 0.0, -1.0)
    case = case_of(scene_of(straight_road(), {"av": motion}), tmp_path)
    rollout = simulate(case, replay.build(replay.Settings()), None, rng=np.random.default_rng(0))
    assert (rollout.tracks.velocity_mps[0, :, 0] < -0.99).all()
