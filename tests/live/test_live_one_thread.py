"""Beside somebody else's script the networks leave the cores to SUMO."""

from contextlib import closing, contextmanager

import numpy as np

from deepmf_sumo.live import attacker
from deepmf_sumo.live.attacker import OneThread


class Noting:
    """Notes whether it is asked within one thread."""

    period_steps = 20

    def __init__(self):
        self.within = False
        self.asked = []

    @contextmanager
    def one_thread(self):
        self.within = True
        yield
        self.within = False

    def reset(self, view, rng):
        self.asked.append(("reset", self.within))
        return ("opponent",)

    def plan(self, view):
        self.asked.append(("plan", self.within))
        return {}


def test_choice_and_plans_are_made_with_one_thread():
    inner = Noting()
    policy = OneThread(inner, inner.one_thread)
    assert policy.period_steps == 20
    assert policy.reset(None, np.random.default_rng(0)) == ("opponent",)
    assert policy.plan(None) == {}
    assert inner.asked == [("reset", True), ("plan", True)]
    assert not inner.within


def test_predictors_are_loaded_where_an_attack_begins(monkeypatch, tmp_path):
    made = []
    monkeypatch.setattr(attacker, "policy_of", lambda spec: made.append(Noting()) or made[-1])
    wish = attacker.AttackRequest(avs=("ego",))
    with closing(attacker.prepare(wish, tmp_path / "out")) as prepared:
        [policy] = prepared.policies
        assert made == []
        assert policy.reset(None, np.random.default_rng(0)) == ("opponent",)
        assert (policy.plan(None), policy.period_steps, len(made)) == ({}, 20, 1)


def test_live_attacks_have_such_a_policy():
    spec = attacker.spec_of(attacker.AttackRequest(avs=("ego",)))
    assert isinstance(attacker.policy_of(spec), OneThread)
