"""A constraint that is not in the package: one class is enough for it."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf import constraints
from deepmf_sumo.deepmf.constraints import Constraint
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.errors import PluginError
from deepmf_sumo.results import artifacts

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of

AGENTS = {"av": (0, 0, 0, 10.0), "near": (-8, 3.5, 0, 12.0), "far": (60, -40, np.pi / 2, 9.0)}


class Late(Constraint):
    name = "late"
    scope = "attack"
    step = 14

    def allowed(self, situation, own, reactions, pairs):
        return pairs.collision_step.min(axis=1) >= self.step


@pytest.fixture
def known(monkeypatch):
    monkeypatch.setattr(constraints, "CONSTRAINTS", (*constraints.CONSTRAINTS, Late))


def first_plan(**values):
    made = build(plugins.settings("adversaries", "deepmf", values), Doubles())
    view = view_of(AGENTS)
    made.reset(view, np.random.default_rng(0))
    return plan_of(made, view)


def test_a_new_constraint_narrows_the_choice_and_is_recorded(known):
    reason = first_plan(constraints=["late"], opponent="near").reason
    hits = reason.collides[reason.chosen]
    assert hits.any()
    assert reason.collision_step[reason.chosen].min() >= Late.step
    assert (reason.wished_mass[~reason.allowed["late"]] == 0.0).all()
    assert not reason.allowed["late"].all()
    assert "late" in reason.milliseconds
    np.testing.assert_array_equal(
        artifacts._reason(reason)["candidate_late"], reason.allowed["late"]
    )


@pytest.mark.parametrize("name", sorted(one.name for one in constraints.CONSTRAINTS))
def test_every_constraint_is_recorded_and_kept(name):
    keys = type(plugins.settings("adversaries", "deepmf", {})).model_fields
    own_key = {"sector": "rear"} if name == "sector" else {name: True}
    values = own_key if name in keys else {"constraints": [name]}
    reason = first_plan(opponent="near", **values).reason
    allowed = reason.allowed[name]
    of_pairs = constraint_of(name).scope == "preferred"
    assert allowed.dtype == bool
    assert allowed.shape == (reason.collides.shape if of_pairs else reason.collides.shape[:1])
    assert allowed[reason.chosen].any() or reason.unmet == (name,)
    if not of_pairs:
        np.testing.assert_array_equal(artifacts._reason(reason)[f"candidate_{name}"], allowed)


def constraint_of(name):
    return next(one for one in constraints.CONSTRAINTS if one.name == name)


def test_a_new_constraint_that_nothing_meets_is_named(known, monkeypatch):
    monkeypatch.setattr(Late, "step", 1000)
    reason = first_plan(constraints=["late"], opponent="near").reason
    assert (reason.rule, reason.unmet) == ("nothing late", ("late",))


def test_an_unknown_constraint_is_refused_with_the_nearest_name():
    with pytest.raises(PluginError, match=r"no constraint .fare.*Did you mean .fair"):
        plugins.settings("adversaries", "deepmf", {"constraints": ["fare"]})


def test_results_name_each_constraint_once_in_order():
    for values, expected in (
        ({}, []),
        ({"constraints": ["fair"]}, ["fair"]),
        ({"constraints": ["on_road", "lawful", "on_road"]}, ["lawful", "on_road"]),
    ):
        written = plugins.settings("adversaries", "deepmf", values).model_dump(mode="json")
        assert written["constraints"] == expected
