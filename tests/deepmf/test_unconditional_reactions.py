"""DeepMF whose AV is predicted without the opponent's future."""

from dataclasses import dataclass, field

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.policy import build

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, FanPrediction, FanPredictor, view_of

AGENTS = {"av": (0, 0, 0, 10.0), "near": (-8, 3.5, 0, 12.0)}


@dataclass
class Heard(FanPredictor):
    given: list = field(default_factory=list)

    def predict(self, view, agent_id, *, planner=False):
        return HeardPrediction(view, agent_id, self.calls, self.given)


@dataclass
class HeardPrediction(FanPrediction):
    conditions: list = field(default_factory=list)

    def given(self, futures, modes):
        self.conditions.append(futures)
        return super().given(futures, modes)


def plan_and_conditions(**values):
    predictors = Doubles(conditional=Heard())
    policy = build(plugins.settings("adversaries", "deepmf", values), predictors)
    view = view_of(AGENTS)
    policy.reset(view, np.random.default_rng(0))
    return plan_of(policy, view), predictors.conditional.given


def test_the_network_is_asked_without_condition_and_all_candidates_meet_the_same_av():
    plan, given = plan_and_conditions(form={"conditional": False, "reactions": 4})
    assert all(each is None for each in given)
    candidates = len(plan.reason.candidates.probability)
    assert len(plan.reason.reactions) == candidates
    assert len({id(each) for each in plan.reason.reactions}) == 1
    assert plan.reason.collides.shape == (candidates, 4)


def test_by_default_every_candidate_is_given():
    plan, given = plan_and_conditions(form={"goal_candidates": 0})
    (candidates,) = given
    assert np.array_equal(candidates.position_m, plan.reason.candidates.futures.position_m)
