"""DeepMF as an adversary: an episode under its policy, or several that learn from each other."""

import time
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.attacks._episodes import deadline, nearest_m
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.deepmf.experience import Experience
from deepmf_sumo.deepmf.policy import DeepMF as Policy
from deepmf_sumo.deepmf.policy import PredictorSet
from deepmf_sumo.deepmf.policy import build as build_policy
from deepmf_sumo.deepmf.settings import Goal, Settings
from deepmf_sumo.judge.ladder import RUNGS, verdict
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.scene import Attack, Budget, Case, Rollout, Trial


class _Reached(NamedTuple):
    """What an episode reached.

    Attributes:
        rank: of two episodes that with the higher one is better; the first says whether the goal
            is reached.
        values: of its trial.
    """

    rank: tuple[bool, ...]
    values: dict[str, float]


class DeepMFAttack:
    """Attacks in one episode, or in at most ``tries``; the first attack loads the predictors."""

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._predictors: PredictorSet | None = None

    @property
    def several(self) -> bool:
        """With several tries."""
        return self._settings.tries > 1

    def load(self) -> None:
        """Load the predictors."""
        if self._predictors is None:
            # Imports torch, which a check of a spec's settings must not do.
            from deepmf_sumo.deepmf.networks.weights import cached_predictors

            self._predictors = cached_predictors(self._weights)

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The first try that reaches the goal, or the best.

        Of a budget the episodes and seconds limit the tries; the first is always made.
        ``generation_s`` of one try is the policy's time, without loading the predictors; of several
        all time until the last ended, since each depends on those before.
        """
        self.load()
        settings = self._settings
        experience = Experience(one_opponent=settings.tried == 1, several=self.several)
        begin, end = time.perf_counter(), deadline(budget)
        most = min(settings.tries, budget.simulations or settings.tries)
        best: tuple[tuple[bool, ...], float, Rollout] | None = None
        trials: list[Trial] = []
        while True:
            policy = self._policy(case, experience)
            rollout = simulate(policy)
            rank, values = _REACHED[settings.goal](rollout, case)
            gap = _gap_m(rollout)
            trials.append(Trial(values=values, objective=0.0 - gap))
            if best is None or (rank, -gap) > (best[0], -best[1]):
                best = rank, gap, rollout
            more = experience.add(rollout, wanted=rank[0]) and not rank[0] and len(trials) < most
            out_of_time = more and time.perf_counter() >= end
            if not more or out_of_time:
                break
        single = len(trials) == 1
        return Attack(
            rollout=best[2],
            trials=() if settings.tries == 1 or best[2].opponent_id is None else tuple(trials),
            simulations=len(trials),
            generation_s=policy.seconds if single else time.perf_counter() - begin,
            out_of_time=out_of_time,
        )

    def _policy(self, case: Case, experience: Experience) -> Policy:
        assert self._predictors is not None
        who = case.partner_id, case.av_driver
        return build_policy(self._settings, self._predictors, *who, experience)


def _hit(rollout: Rollout, case: Case) -> _Reached:
    hit = rollout.first("av_opponent") is not None
    return _Reached((hit,), {"hit": float(hit)})


def _finding(rollout: Rollout, case: Case) -> _Reached:
    """A finding; of hits that are none any is better than a miss. ``rung``: as of the metric."""
    found = verdict(Episode(rollout, case))
    if found is None:
        return _Reached((False, False), {"hit": 0.0, "finding": 0.0})
    values = {"hit": 1.0, "finding": float(found.finding), "rung": float(RUNGS.index(found.rung))}
    return _Reached((found.finding, True), values)


_REACHED: Final[dict[Goal, Callable[[Rollout, Case], _Reached]]] = {
    "hit": _hit,
    "finding": _finding,
}


def _gap_m(rollout: Rollout) -> float:
    return np.inf if rollout.opponent_id is None else nearest_m(rollout)


def build(settings: Settings, weights: str) -> DeepMFAttack:
    """The adversary; ``weights`` is a name or a folder, see `networks.weights.load`."""
    return DeepMFAttack(settings, weights)
