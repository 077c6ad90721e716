"""What a policy may answer, and what is said of answers of another kind."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.errors import PluginError, SimulationError
from deepmf_sumo.scene import Plan
from deepmf_sumo.scene.policy import chosen, planned

from tests.support.predictor_doubles import view_of

VIEW = view_of({"av": (0, 0, 0, 10.0), "a": (12, 0, 0, 10.0), "b": (-12, 0, 0, 10.0)})


def plan(agent):
    return Plan(
        agent_id=agent,
        first_step=11,
        position_m=np.zeros((5, 2)),
        heading_rad=np.zeros(5),
        speed_mps=np.zeros(5),
    )


def answering(reset=(), plan=None):
    return SimpleNamespace(reset=lambda view, rng: reset, plan=lambda view: plan)


@pytest.mark.parametrize("answer", [(), ("a",), ("b", "a")])
def test_the_chosen_vehicles_keep_their_order(answer):
    assert chosen(answering(answer), VIEW, np.random.default_rng(0)) == answer


@pytest.mark.parametrize("answer", [None, "a", ["a", "b"]])
def test_a_choice_of_another_kind_is_refused_with_what_to_return(answer):
    with pytest.raises(PluginError, match=r"returned .*; return a tuple .* \('a',\) .* \(\)"):
        chosen(answering(answer), VIEW, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("answer", "said"),
    [(("gone",), "'gone'"), (("a", "av"), "'av'"), (("a", "a"), "'a' more than once")],
)
def test_a_vehicle_that_cannot_attack_is_refused(answer, said):
    with pytest.raises(SimulationError, match=said):
        chosen(answering(answer), VIEW, np.random.default_rng(0))


@pytest.mark.parametrize("answer", [None, plan("a"), [plan("a")]])
def test_a_plan_of_another_kind_is_refused_with_what_to_return(answer):
    kind = type(answer).__name__
    with pytest.raises(PluginError, match=rf"'{kind}'; return .*\{{plan.agent_id: plan\}}"):
        planned(answering(plan=answer), VIEW, ("a",))


@pytest.mark.parametrize("answer", [{"b": plan("b")}, {"a": plan("b")}])
def test_a_plan_of_a_vehicle_that_does_not_attack_is_refused(answer):
    with pytest.raises(SimulationError, match="planned for 'b', but its opponent is 'a'"):
        planned(answering(plan=answer), VIEW, ("a",))


@pytest.mark.parametrize("answer", [{}, {"b": plan("b")}, {"b": plan("b"), "a": plan("a")}])
def test_some_of_the_vehicles_may_get_new_plans(answer):
    assert planned(answering(plan=answer), VIEW, ("a", "b")) is answer
