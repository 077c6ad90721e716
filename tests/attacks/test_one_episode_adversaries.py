import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.scene import Budget

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, rollout_of, straight

VIEW = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})
PATHS = {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)}


class Simulation:
    """Counts episodes; asks the policy for one plan."""

    def __init__(self):
        self.policies = []

    def __call__(self, policy):
        self.policies.append(policy)
        if policy is None:
            return rollout_of(PATHS, opponent_id=None)
        (opponent,) = policy.reset(VIEW, np.random.default_rng(0))
        return rollout_of(PATHS, opponent_id=opponent, plans=[plan_of(policy, VIEW)])


def attack(name, values, case=None, weights_name="open"):
    simulate = Simulation()
    made = plugins.load("adversaries", name).build(
        plugins.settings("adversaries", name, values), weights_name
    )
    found = made.attack(case or case_of(), simulate, Budget(), np.random.default_rng(0))
    return found, simulate


@pytest.fixture
def loads(monkeypatch):
    """Names of the weights that were loaded; the predictors are doubles."""
    names = []

    def load(name):
        names.append(name)
        return Doubles()

    monkeypatch.setattr(weights, "cached_predictors", load)
    return names


def test_deepmf_attacks_in_one_episode(loads):
    found, simulate = attack("deepmf", {"period_s": 2.0, "rule": "likeliest"}, weights_name="mine")
    assert loads == ["mine"]
    assert (found.simulations, len(simulate.policies)) == (1, 1)
    assert simulate.policies[0].period_steps == 20
    assert found.rollout.opponent_id == "b"
    spent = sum(found.rollout.plans[0].reason.milliseconds.values()) / 1000
    assert spent <= found.generation_s < spent + 1.0


def test_deepmf_loads_its_predictors_once_and_late(loads):
    module = plugins.load("adversaries", "deepmf")
    made = module.build(module.Settings(), "open")
    assert loads == []
    for _ in range(2):
        made.attack(case_of(), Simulation(), Budget(), np.random.default_rng(0))
    assert loads == ["open"]


def test_deepmf_attacks_the_labelled_partner(loads):
    _, simulate = attack("deepmf", {"opponent": "labelled"}, case_of(partner_id="b"))
    assert simulate.policies[0].reset(VIEW, np.random.default_rng(0)) == ("b",)


def test_nobody_attacks():
    found, simulate = attack("none", {})
    assert simulate.policies == [None]
    assert (found.rollout.opponent_id, found.generation_s) == (None, 0.0)


def test_a_fixed_trajectory_is_replayed():
    poses = straight(-8, 3.5, 12)[11:].tolist()
    found, simulate = attack("trajectory", {"agent": "b", "poses": poses})
    assert len(simulate.policies) == 1
    np.testing.assert_allclose(found.rollout.plans[0].position_m, np.array(poses)[:, :2])
