"""Plans with the wish that the opponent breaks no rule of the road."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import policy, scoring
from deepmf_sumo.deepmf.scoring import Mask, Objective, Pairs
from deepmf_sumo.deepmf.settings import Form

from tests.support import one_attacker
from tests.support.predictor_doubles import Doubles, view_of

BESIDE = {"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)}
BEHIND = {"av": (0, 0, 0, 10.0), "b": (-12, 0, 0, 12.0)}


def plan_of(agents, **values):
    settings = plugins.settings("adversaries", "deepmf", {"opponent": "b", **values})
    made = policy.build(settings, Doubles())
    view = view_of(agents)
    made.reset(view, np.random.default_rng(0))
    return one_attacker.plan_of(made, view)


def choice(lawful, collides=(True, True, False), fair=None, rule="expected"):
    hits = np.array(collides)[:, None]
    pairs = Pairs(
        probability=np.array([0.5, 0.3, 0.2]),
        reaction_probability=np.ones((3, 1)),
        collides=hits,
        collision_step=np.where(hits, 20.0, 80.0),
    )
    masks = [Mask("lawful", "driven", np.array(lawful))]
    masks += [] if fair is None else [Mask("fair", "attack", np.array(fair))]
    chosen = scoring.choose_allowed(pairs, masks, Objective(rule))
    return chosen, chosen.unmet


@pytest.mark.parametrize("rule", ["expected", "pair", "likeliest"])
def test_the_best_of_the_lawful_is_chosen(rule):
    chosen, unmet = choice([False, True, True], rule=rule)
    assert (chosen.index, chosen.rule, unmet) == (1, rule, ())
    assert len(chosen.value) == len(chosen.product) == 3
    assert chosen.value[0] == 0.0


def test_where_only_breaking_a_rule_meets_the_av_nobody_is_attacked():
    chosen, unmet = choice([False, False, True])
    assert (chosen.index, chosen.rule, unmet) == (2, "nothing lawful", ("lawful",))


def test_where_nobody_can_be_met_the_likeliest_lawful_one_is_driven():
    chosen, unmet = choice([False, True, True], collides=(False, False, False))
    assert (chosen.index, chosen.rule, unmet) == (1, "fallback", ())


def test_where_nothing_is_lawful_what_does_least_is_driven():
    chosen, unmet = choice([False, False, False])
    assert (chosen.index, unmet) == (2, ("lawful",))
    chosen, unmet = choice([False] * 3, collides=(False, False, False))
    assert (chosen.index, unmet) == (0, ())


def test_a_lawful_attack_can_be_asked_to_be_fair_too():
    chosen, unmet = choice([True, True, True], fair=[False, True, True])
    assert (chosen.index, unmet) == (1, ())
    chosen, unmet = choice([True, False, True], fair=[False, True, True])
    assert (chosen.index, unmet) == (2, ("fair",))


def test_no_plan_rams_the_av_from_behind():
    wild = plan_of(BEHIND)
    assert wild.reason.collides[wild.reason.chosen].any()
    assert wild.reason.lawful is None
    tame = plan_of(BEHIND, constraints=["lawful"])
    assert not tame.reason.collides[tame.reason.chosen].any()
    assert tame.reason.unmet == ("lawful",)
    assert "stop" in tame.reason.origin


def test_the_driven_candidate_is_lawful_and_the_plan_says_which_are():
    plan = plan_of(BESIDE, constraints=["lawful"])
    reason = plan.reason
    assert reason.lawful.shape == reason.candidates.probability.shape
    assert reason.lawful[reason.chosen]
    assert not reason.lawful.all()
    assert (reason.wished_mass <= reason.collision_mass).all()
    assert (reason.wished_mass[~reason.lawful] == 0.0).all()
    assert "lawful" in reason.milliseconds


WITH_FOUR = {"form": {"tried_opponents": 4}, "constraints": ["lawful"]}


def test_an_opponent_without_lawful_ways_to_the_av_is_not_chosen():
    agents = {"av": (0, 0, 0, 10.0), "behind": (-12, 0, 0, 12.0), "beside": (30, 3.5, 0, 6.0)}
    settings = plugins.settings("adversaries", "deepmf", WITH_FOUR)
    made = policy.build(settings, Doubles())
    view = view_of(agents)
    (opponent,) = made.reset(view, np.random.default_rng(0))
    plan = one_attacker.plan_of(made, view)
    assert plan.agent_id == opponent
    every = {}
    for name in ("behind", "beside"):
        alone = policy.build(replace_opponent(settings, name), Doubles())
        alone.reset(view, np.random.default_rng(0))
        every[name] = one_attacker.plan_of(alone, view).reason.wished_mass.max()
    assert every[opponent] == max(every.values())


def replace_opponent(settings, name):
    return settings.model_copy(update={"opponent": name, "form": Form(tried_opponents=1)})


def test_plans_say_nothing_of_a_law_that_nobody_asked_for():
    assert plan_of(BESIDE).reason.lawful is None
