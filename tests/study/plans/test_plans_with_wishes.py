"""``plans.npz`` says what was wished of each plan, and what the candidates would have done."""

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.results import artifacts

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import rollout_of, straight


def saved(tmp_path, **values):
    settings = plugins.settings("adversaries", "deepmf", {"opponent": "b", **values})
    policy = build(settings, Doubles())
    view = view_of({"av": (0, 0, 0, 10.0), "b": (12, 0, 0, 2.0)})
    policy.reset(view, np.random.default_rng(0))
    plan = plan_of(policy, view)
    rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(12, 0, 2)}, plans=[plan])
    artifacts.write_plans(tmp_path / "plans.npz", rollout)
    with np.load(tmp_path / "plans.npz") as arrays:
        return plan.reason, dict(arrays)


def test_wishes_are_kept(tmp_path):
    reason, arrays = saved(tmp_path, sector="rear", constraints=["fair"])
    assert arrays["00/wanted_sector"] == 4
    np.testing.assert_array_equal(arrays["00/sector"], reason.sector)
    assert ((arrays["00/sector"] == -1) == ~arrays["00/collides"]).all()
    np.testing.assert_array_equal(arrays["00/candidate_fair"], reason.fair)
    assert tuple(arrays["00/unmet"]) == reason.unmet != ()


def test_without_wishes_nothing_is_added(tmp_path):
    reason, arrays = saved(tmp_path)
    assert reason.unmet == ()
    names = {"00/wanted_sector", "00/sector", "00/candidate_fair", "00/unmet"}
    assert not names & set(arrays)
