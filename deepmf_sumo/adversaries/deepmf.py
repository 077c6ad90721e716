"""DeepMF as an adversary: one episode under its policy."""

import numpy as np

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case
from deepmf_sumo.deepmf.policy import Predictors
from deepmf_sumo.deepmf.policy import build as build_policy
from deepmf_sumo.deepmf.settings import Settings


class DeepMF:
    """Attacks in one episode, whatever the budget; the first attack loads the predictors."""

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._predictors: Predictors | None = None

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The episode; ``generation_s`` is the policy's time, without loading the predictors."""
        if self._predictors is None:
            # Imports torch, which a check of a spec's settings must not do.
            from deepmf_sumo.predictors.weights import cached_predictors

            self._predictors = cached_predictors(self._weights)
        policy = build_policy(self._settings, self._predictors, case.partner_id, case.av_driver)
        rollout = simulate(policy)
        return Attack(rollout=rollout, simulations=1, generation_s=policy.seconds)


def build(settings: Settings, weights: str) -> DeepMF:
    """The adversary; ``weights`` is a name or a folder as `predictors.weights.load` takes it."""
    return DeepMF(settings, weights)
