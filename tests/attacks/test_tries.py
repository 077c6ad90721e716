"""DeepMF in several tries: what the AV did before takes the place of what was predicted."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.experience import Experience
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.policy import build
from deepmf_sumo.errors import PluginError
from deepmf_sumo.scene import Budget

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

AGENTS = {"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0), "c": (30, 3.5, 0, 9.0)}
VIEW = view_of(AGENTS)


@pytest.fixture(autouse=True)
def doubles(monkeypatch):
    monkeypatch.setattr(weights, "cached_predictors", lambda name: Doubles())


class Simulation:
    """The AV drives ``av``; the opponent its first plan; a hit in the tries ``hit``."""

    def __init__(self, av=None, hit=None):
        self.av = straight(0, 0, 10) if av is None else av
        self.hit, self.plans = hit or (), []

    def __call__(self, policy):
        (opponent,) = policy.reset(VIEW, np.random.default_rng(0))
        plan = plan_of(policy, VIEW)
        self.plans.append(plan)
        paths = {name: straight(x, y, v) for name, (x, y, _, v) in AGENTS.items()}
        begin = VIEW.step + 1
        own = paths[opponent].copy()
        count = min(len(own) - begin, len(plan.position_m))
        own[begin : begin + count, :2] = plan.position_m[:count]
        paths |= {"av": self.av, opponent: own}
        hits = len(self.plans) in self.hit
        contacts = [contact_of(step=begin + 20, second=opponent)] if hits else []
        return rollout_of(paths, opponent_id=opponent, plans=[plan], contacts=contacts)


def attack(simulate, budget=None, **values):
    settings = plugins.settings("adversaries", "deepmf", values)
    made = plugins.load("adversaries", "deepmf").build(settings, "open")
    return made.attack(case_of(), simulate, budget or Budget(), np.random.default_rng(0))


def test_a_hit_ends_the_tries():
    simulate = Simulation(hit=(3,))
    found = attack(simulate, tries=5)
    assert found.simulations == len(simulate.plans) == 3
    assert found.rollout.first("av_opponent") is not None
    assert [trial.values["hit"] for trial in found.trials] == [0.0, 0.0, 1.0]


def test_one_try_leaves_no_trials():
    found = attack(Simulation())
    assert (found.simulations, found.trials) == (1, ())


@pytest.mark.parametrize(("budget", "made"), [(Budget(simulations=2), 2), (Budget(seconds=0.0), 1)])
def test_a_budget_limits_the_tries(budget, made):
    found = attack(Simulation(), budget, tries=6)
    assert found.simulations == made
    assert found.out_of_time == (budget.seconds is not None)


def test_the_nearest_miss_is_the_attack_where_no_try_hits():
    simulate = Simulation()
    found = attack(simulate, tries=4)
    objectives = [trial.objective for trial in found.trials]
    plans = [trial.plans[0] for trial in [found.rollout]]
    assert plans[0] is simulate.plans[int(np.argmax(objectives))]


def test_the_answer_to_what_was_tried_is_known():
    braking = straight(0, 0, 10, accel=-5)[:, :3]
    simulate = Simulation(av=braking[:31])  # stands 2 s after now
    simulate.av = np.concatenate([braking[:31], np.repeat(braking[30:31], 60, axis=0)])
    attack(simulate, tries=2, opponent="b", form={"tried_opponents": 1})
    first, second = (plan.reason for plan in simulate.plans)
    assert len(second.reactions[0].probability) == len(first.reactions[0].probability) + 1
    driven = first.candidates.futures.position_m[first.chosen]
    apart = np.abs(second.candidates.futures.position_m - driven).max(axis=(1, 2))
    again = second.reactions[int(apart.argmin())]
    assert apart.min() < 0.01
    likeliest = int(again.probability.argmax())
    assert again.probability[likeliest] > 0.99
    np.testing.assert_allclose(again.futures.position_m[likeliest][:60], simulate.av[11:71, :2])
    np.testing.assert_allclose([one.probability.sum() for one in second.reactions], 1.0)
    # it passed where it was predicted to hit, so something else is tried
    assert first.collides[first.chosen].any()
    assert not np.allclose(simulate.plans[0].position_m, simulate.plans[1].position_m, atol=0.1)


@pytest.mark.parametrize(
    "values", [{}, {"constraints": ["fair", "clean"]}, {"form": {"conditional": False}}]
)
@pytest.mark.slow_unit
def test_what_no_try_changes_is_predicted_once(monkeypatch, values):
    made = {}
    for shared in (True, False):
        predictors = Doubles()
        monkeypatch.setattr(weights, "cached_predictors", lambda name, it=predictors: it)
        monkeypatch.setattr(
            "deepmf_sumo.attacks.deepmf.Experience",
            lambda several, shared=shared, **others: Experience(
                several=several and shared, **others
            ),
        )
        simulate = Simulation()
        attack(simulate, tries=4, **values)
        calls = [agent for agent, _ in predictors.marginal.calls]
        made[shared] = simulate.plans, calls.count("b"), calls.count("c")
    assert made[True][1:] < made[False][1:]
    assert len(made[True][0]) == len(made[False][0]) == 4
    for one, other in zip(made[True][0], made[False][0], strict=True):
        assert one.agent_id == other.agent_id
        np.testing.assert_array_equal(one.position_m, other.position_m)
        np.testing.assert_array_equal(one.reason.value, other.reason.value)
        np.testing.assert_array_equal(one.reason.collides, other.reason.collides)


def test_nothing_is_kept_where_no_try_follows():
    """A policy of a live attack has no end: it may not gather predictions."""
    settings = plugins.settings("adversaries", "deepmf", {"form": {"tried_opponents": 2}})
    experience = Experience()
    Simulation()(build(settings, Doubles(), experience=experience))
    assert experience.predicted == {}


def test_the_weight_of_an_answer_falls_with_the_distance_from_what_was_tried():
    simulate = Simulation()
    attack(simulate, tries=2, opponent="b", form={"tried_opponents": 1})
    reason = simulate.plans[1].reason
    apart = reason.candidates.futures.position_m - simulate.plans[0].position_m
    square = (apart[:, :30] ** 2).sum(-1).mean(-1)
    assert square.max() > 4.0
    new = simulate.av[11:91, :2]
    for one, away in zip(reason.reactions, square, strict=True):
        row = np.abs(one.futures.position_m - new).max(axis=(1, 2)).argmin()
        assert one.probability[row] >= np.exp(-away / (2 * 1.5**2)) - 1e-9


def test_a_collision_that_missed_the_goal_does_not_count_again(monkeypatch):
    settings = plugins.settings("adversaries", "deepmf", {"opponent": "b"})
    simulate, experience = Simulation(), Experience()
    rollout = simulate(build(settings, Doubles(), experience=experience))
    experience.add(rollout, wanted=False)
    simulate(build(settings, Doubles(), experience=experience))
    first, second = (plan.reason for plan in simulate.plans)
    apart = second.candidates.futures.position_m - simulate.plans[0].position_m
    again = int(np.abs(apart).max(axis=(1, 2)).argmin())
    assert first.collides[first.chosen].any()
    likeliest = int(second.reactions[again].probability.argmax())
    np.testing.assert_allclose(
        second.reactions[again].futures.position_m[likeliest], simulate.av[11:91, :2]
    )
    assert not second.collides[again, likeliest]
    assert second.collision_step[again, likeliest] == 80


def verdicts(monkeypatch, *rungs):
    """The rungs of the hits of successive tries."""
    told = iter(rungs)

    def verdict(episode):
        if episode.rollout.first("av_opponent") is None:
            return None
        rung = next(told)
        return SimpleNamespace(rung=rung, finding=rung in "AB")

    monkeypatch.setattr("deepmf_sumo.attacks.deepmf.verdict", verdict)


@pytest.mark.parametrize("rung", ["A", "B"])
def test_a_finding_ends_the_tries(monkeypatch, rung):
    verdicts(monkeypatch, "C", "D", rung)
    simulate = Simulation(hit=(1, 2, 3, 4))
    found = attack(simulate, tries=6, goal="finding")
    assert [trial.values["rung"] for trial in found.trials] == [2.0, 3.0, "AB".index(rung)]
    assert [trial.values["finding"] for trial in found.trials] == [0.0, 0.0, 1.0]
    assert found.rollout.plans[0] is simulate.plans[2]


def test_a_hit_that_is_no_finding_is_the_attack_where_there_is_none(monkeypatch):
    verdicts(monkeypatch, "C")
    simulate = Simulation(hit=(2,))
    found = attack(simulate, tries=3, goal="finding")
    assert [trial.values for trial in found.trials] == [
        {"hit": 0.0, "finding": 0.0},
        {"hit": 1.0, "finding": 0.0, "rung": 2.0},
        {"hit": 0.0, "finding": 0.0},
    ]
    assert found.rollout.plans[0] is simulate.plans[1]


def test_an_opponent_that_repeats_itself_gives_way_to_another():
    experience = Experience()
    rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    assert experience.add(rollout, wanted=False)
    assert experience.add(rollout, wanted=False)
    assert experience.given_up == {"b"}
    assert not experience.add(rollout, wanted=False)


def test_nobody_attacks():
    rollout = rollout_of({"av": straight(0, 0, 10)}, opponent_id=None)
    assert not Experience().add(rollout, wanted=False)


@pytest.mark.parametrize("values", [{"tries": 2}, {"goal": "finding"}])
def test_the_published_form_has_one_try_and_one_goal(values):
    with pytest.raises(PluginError, match=next(iter(values))):
        plugins.settings("adversaries", "deepmf", {"form": "paper", **values})


def test_opponents_in_turn_are_for_one_try():
    assert plugins.settings("adversaries", "deepmf", {}).takes_turns
    assert not plugins.settings("adversaries", "deepmf", {"tries": 2}).takes_turns


def test_an_only_opponent_that_repeats_itself_ends_the_tries():
    experience = Experience(one_opponent=True)
    rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    assert experience.add(rollout, wanted=False)
    assert not experience.add(rollout, wanted=False)


def test_a_case_without_an_opponent_has_no_trials():
    alone = rollout_of({"av": straight(0, 0, 10)}, opponent_id=None)
    found = attack(lambda policy: alone, tries=5)
    assert (found.simulations, found.trials) == (1, ())  # their objective would be infinite
