"""CAT: candidates against the AV's last rollouts."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks._episodes import AgentMotion
from deepmf_sumo.baselines._open_loop import Answers, flattened, score
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.scene import Budget, Futures

from tests.support.driven_world import World, driven_limits
from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles
from tests.support.rollout_doubles import case_of

STEPS = np.arange(1, 81)
VIEW = World().view


@pytest.fixture
def doubles(monkeypatch):
    made = Doubles()
    monkeypatch.setattr(weights, "cached_predictors", lambda name: made)
    return made


def attack(world, values=None, budget=None):
    settings = plugins.settings("adversaries", "cat", values or {})
    made = plugins.load("adversaries", "cat").build(settings, "open")
    return made.attack(case_of(), world, budget or Budget(), np.random.default_rng(0))


def motion(speed, y=0.0, valid=80):
    return AgentMotion(
        position_m=np.stack([0.1 * speed * STEPS, np.full(80, y)], -1),
        heading_rad=np.zeros(80),
        speed_mps=np.full(80, speed),
        valid=valid >= STEPS,
    )


def straight_futures(*lines):
    """Futures of b along x, each (speed, y) from x = 0 on."""
    position = np.stack([np.stack([0.1 * speed * STEPS, np.full(80, y)], -1) for speed, y in lines])
    return Futures(agent_id="b", position_m=position, heading_rad=np.zeros(position.shape[:2]))


def test_the_tail_is_flat():
    weight = flattened(np.array([0.5, 0.2, 0.15, 0.1, 0.04, 0.01]), 3)
    np.testing.assert_allclose(weight * 1.15, [0.5, 0.2, 0.15, 0.1, 0.1, 0.1])
    np.testing.assert_array_equal(flattened(np.array([0.6, 0.4]), 6), [0.6, 0.4])


def test_values_are_weights_times_hits_that_fade():
    # The first candidate begins where the first rollout does, the last where the second does.
    futures = straight_futures((7.0, 0.0), (10.0, 30.0), (10.0, 3.0))
    rollouts = [motion(10.0), motion(10.0, y=3.0)]
    weight = np.array([0.5, 0.3, 0.2])
    found = score(weight, futures, Answers.of(VIEW, rollouts), VIEW)
    np.testing.assert_array_equal(found.collides, [[True, False], [False, False], [False, True]])
    np.testing.assert_allclose(found.value, [0.5 * 0.5 * 0.99, 0.0, 0.2 * 0.5 * 0.99])
    assert (found.chosen, found.fallback) == (0, False)


def test_a_later_hit_counts_less():
    # 30.1 m ahead, 4 m/s slower: contact after (30.1 - 4.8) / 4 = 6.3 s, in the 13th half second.
    late = np.stack([30.1 + 0.6 * STEPS, np.zeros(80)], -1)
    futures = Futures(agent_id="b", position_m=late[None], heading_rad=np.zeros((1, 80)))
    found = score(np.ones(1), futures, Answers.of(VIEW, [motion(10.0)]), VIEW)
    assert found.collision_step[0, 0] == 63
    np.testing.assert_allclose(found.value, 0.99**13)


def test_without_any_hit_the_nearest_centre_is_taken():
    futures = straight_futures((10.0, 30.0), (10.0, 6.0), (10.0, -8.0))
    found = score(np.array([0.8, 0.1, 0.1]), futures, Answers.of(VIEW, [motion(10.0)]), VIEW)
    assert (found.chosen, found.fallback) == (1, True)
    np.testing.assert_allclose(found.value, [-30.0, -6.0, -8.0])


def test_an_av_that_has_gone_is_not_hit():
    late = np.stack([30.0 + 0.6 * STEPS, np.zeros(80)], -1)
    futures = Futures(agent_id="b", position_m=late[None], heading_rad=np.zeros((1, 80)))
    answers = Answers.of(VIEW, [motion(10.0, valid=50)])
    assert score(np.ones(1), futures, answers, VIEW).fallback
    np.testing.assert_allclose(answers.forecast.futures.position_m[0, :, 0], STEPS * 1.0, atol=1e-9)


def test_it_hits_an_av_that_does_not_react(doubles):
    found = attack(World())
    assert found.rollout.first("av_opponent") is not None
    assert found.simulations == 2
    reason = found.rollout.plans[0].reason
    assert reason.rule == "rollouts"
    assert reason.collides[reason.chosen].any()
    assert {"mode", "goal"} == set(reason.origin)
    np.testing.assert_allclose(
        reason.reactions[0].futures.position_m[0, -1], [80.0, 0.0], atol=1e-9
    )
    accel, brake, _ = driven_limits(found.rollout)
    assert accel <= 3.0 + 1e-6
    assert brake <= 4.0 + 1e-6


def test_as_published_it_takes_modes_alone(doubles):
    reason = attack(World(), {"goal_candidates": 0}).rollout.plans[0].reason
    assert (set(reason.origin), len(reason.origin)) == ({"mode"}, 32)
    assert doubles.conditional.calls == []


def test_it_remembers_the_last_rollouts(doubles):
    world = World(av_y_m=(0.0, -60.0, 60.0, -60.0))
    values = {"goal_candidates": 0, "memory": 2}
    found = attack(world, values, Budget(simulations=4))
    plans = [plan_of(policy, world.view) for policy in world.policies[1:]]
    assert [plan.reason.collides.shape[1] for plan in plans] == [1, 2, 2]
    seen = [
        reaction.futures.position_m[:, 0, 1].tolist()
        for reaction in (plan.reason.reactions[0] for plan in plans)
    ]
    assert seen == [[0.0], [0.0, -60.0], [-60.0, 60.0]]
    assert len(found.trials) == 3
