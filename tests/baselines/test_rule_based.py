"""The Bezier rule, and the rounds that it shares with CAT and ART."""

import time

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import nearest_m
from deepmf_sumo.baselines._open_loop import curve_into, headings
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import Budget

from tests.support.driven_world import NOW, World, driven_limits
from tests.support.predictor_doubles import Doubles
from tests.support.rollout_doubles import case_of, rollout_of, straight


def attack(world, values=None, budget=None):
    settings = plugins.settings("adversaries", "rule", {"opponent": "b", **(values or {})})
    made = plugins.load("adversaries", "rule").build(settings, "open")
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(0))


def de_casteljau(control, share):
    points = np.array(control, float)
    while len(points) > 1:
        points = (1 - share) * points[:-1] + share * points[1:]
    return points[0]


def test_the_curve_has_cats_control_points():
    own = np.stack([np.arange(1, 13), np.full(12, 4.0)], -1).astype(float)
    av = np.stack([np.full(12, 20.0), np.arange(1, 13)], -1).astype(float)
    curve = curve_into(np.array([0.0, 4.0]), own, av, 9)
    control = [[0.0, 4.0], [3.0, 4.0], [20.0, 6.0], [20.0, 9.0]]
    expected = [de_casteljau(control, step / 9) for step in range(1, 10)]
    np.testing.assert_allclose(curve[:9], expected)
    np.testing.assert_array_equal(curve[9:], av[9:])


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_short_curves_end_at_the_av(steps):
    own, av = np.zeros((3, 2)), np.arange(6.0).reshape(3, 2)
    assert np.array_equal(curve_into(np.zeros(2), own, av, steps)[steps - 1], av[steps - 1])


def test_it_meets_an_av_that_does_not_react():
    world = World()
    found = attack(world)
    assert found.rollout.first("av_opponent") is not None
    assert (found.simulations, len(world.policies)) == (2, 2)
    assert found.trials[0].values == {"meeting_s": 6.0}
    assert found.trials[0].objective == 0.0
    plan = found.rollout.plans[0]
    assert (plan.agent_id, plan.first_step, len(plan.position_m)) == ("b", NOW + 1, 80)
    np.testing.assert_allclose(plan.position_m[59], [60.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(plan.heading_rad[70:], 0.0, atol=1e-9)


def test_within_limits_it_drives_like_a_car_and_hits_earliest():
    found = attack(World(), {"within_limits": True, "meeting_share": None})
    accel, brake, lateral = driven_limits(found.rollout)
    assert accel <= 3.5 + 1e-6
    assert brake <= 5.0 + 1e-6
    assert lateral <= 3.5 * 1.05
    contact = found.rollout.first("av_opponent")
    late = attack(World(), {"within_limits": True, "meeting_share": 1.0})
    assert contact.step < late.rollout.first("av_opponent").step


def test_a_standing_opponent_gets_going():
    found = attack(World(opponent=(30.0, 8.0, np.pi / 2, 0.0)))
    assert found.rollout.first("av_opponent") is not None
    assert np.isfinite(found.rollout.plans[0].heading_rad).all()


def test_further_rounds_aim_at_the_answer_to_the_last():
    # Scouted on its lane, the AV is 10 m off it from the first attack on.
    world = World(av_y_m=(0.0, -10.0))
    found = attack(world, {"rounds": 5})
    assert (found.simulations, len(world.policies)) == (3, 3)
    assert [trial.objective == 0.0 for trial in found.trials] == [False, True]
    assert found.rollout.first("av_opponent") is not None


def test_the_nearest_miss_is_kept_when_the_budget_ends():
    # It never is where it was the time before.
    world = World(av_y_m=(0.0, -10.0, 12.0, -30.0, 40.0))
    found = attack(world, budget=Budget(simulations=4))
    assert (found.simulations, len(found.trials)) == (4, 3)
    objectives = [trial.objective for trial in found.trials]
    assert max(objectives) < 0.0
    av, own = (found.rollout.tracks.row(name) for name in ("av", "b"))
    apart = found.rollout.tracks.position_m[av] - found.rollout.tracks.position_m[own]
    assert np.hypot(*apart[NOW:].T).min() < -max(objectives) + 4.0


def test_one_attack_is_driven_whatever_the_budget():
    world = World(av_y_m=(0.0, -10.0))
    found = attack(world, {"rounds": 9}, Budget(seconds=0.0))
    assert (found.simulations, len(found.trials)) == (2, 1)


@pytest.mark.slow_unit
def test_time_of_the_only_attack_is_no_search():
    class Slow(World):
        def __call__(self, policy):
            if self.policies:
                time.sleep(0.3)
            return super().__call__(policy)

    assert attack(Slow()).generation_s < 0.25
    assert attack(Slow(av_y_m=(0.0, -10.0)), {"rounds": 2}).generation_s > 0.6
    # It hits at once, which is known from the episode alone.
    assert attack(Slow(), {"rounds": 2}).generation_s > 0.3


def test_a_gap_is_that_after_the_attack_began():
    own = straight(0.0, 3.5, 10.0)
    own[NOW + 1 :, 1] = 32.0
    rollout = rollout_of({"av": straight(0.0, 0.0, 10.0), "b": own})
    assert nearest_m(rollout) == pytest.approx(30.0)


def test_nobody_to_attack(monkeypatch):
    monkeypatch.setattr(weights, "cached_predictors", lambda name: Doubles())
    world = World(others=False)
    found = attack(world, {"opponent": "argmax"})
    assert found.rollout.opponent_id is None
    assert (found.trials, found.simulations, world.policies[-1]) == ((), 2, None)


def test_an_opponent_that_is_not_there_is_refused():
    with pytest.raises(RunError, match="opponent 'z' is not a vehicle"):
        attack(World(), {"opponent": "z"})


def test_a_vehicle_whose_motion_reverses_backs_up():
    x = np.array([1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0])
    start = Start(
        position_m=np.zeros(2), heading_rad=0.0, course_rad=0.0, speed_mps=10.0, length_m=4.8
    )
    found = headings(np.column_stack([x, 0 * x]), start)
    assert np.cos(found) == pytest.approx(1.0)
    angle = np.linspace(0.0, np.pi, 40)[1:]  # a U-turn is none
    turned = headings(10 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), start)
    assert turned[-1] == pytest.approx(np.pi, abs=0.2)
