"""The exam of the policies with which adversaries of the package attack."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.deepmf import policy as deepmf_policy
from deepmf_sumo.scene import Plan

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of

# Settings without which a policy cannot be built; all others must have defaults.
NEEDED = {"trajectory": {"agent": "b", "poses": [[-6.8 + 1.2 * k, 3.5, 0.0] for k in range(80)]}}
POLICIES = {
    "deepmf": deepmf_policy.build,
    "trajectory": lambda settings, *_: trajectory.TrajectoryPolicy(settings),
}
VIEW = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})


@pytest.mark.parametrize("name", POLICIES)
def test_policy(name):
    settings = plugins.settings("adversaries", name, NEEDED.get(name, {}))
    policy = POLICIES[name](settings, Doubles(), None)
    period = policy.period_steps
    assert period is None or (isinstance(period, int) and period >= 1)
    assert policy.reset(VIEW, np.random.default_rng(0)) in {("b",), ()}
    plan = plan_of(policy, VIEW)
    assert isinstance(plan, Plan)
    assert (plan.agent_id, plan.first_step) == ("b", VIEW.step + 1)
    for values in (plan.position_m, plan.heading_rad, plan.speed_mps):
        assert len(values) == len(plan.position_m) > 0
        assert np.isfinite(values).all()
    # The first pose is where 12 m/s lead to, give or take 10 m/s2.
    assert np.hypot(*(plan.position_m[0] - [-6.8, 3.5])) < 0.1


@pytest.mark.parametrize("name", POLICIES)
def test_unknown_settings_are_refused(name):
    with pytest.raises(plugins.PluginError, match="no_such_key"):
        plugins.settings("adversaries", name, {**NEEDED.get(name, {}), "no_such_key": 1})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("deepmf", {"period_s": float("inf")}),
        ("deepmf", {"form": {"likelihood_weight": float("nan")}}),
        ("trajectory", {"agent": "b", "poses": [[float("nan"), 3.5, 0.0]]}),
    ],
)
def test_numbers_that_are_not_finite_are_refused(name, values):
    with pytest.raises(plugins.PluginError, match="finite"):
        plugins.settings("adversaries", name, values)
