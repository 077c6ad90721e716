"""DeepMF as an adversary: one episode under its policy."""

import numpy as np

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case
from deepmf_sumo.deepmf import policy as policy_module

Settings = policy_module.Settings


class DeepMF:
    """Attacks in one episode, whatever the budget; the predictors are loaded at the first."""

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._predictors: policy_module.Predictors | None = None

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The episode; ``generation_s`` is what the policy did, without loading the predictors."""
        if self._predictors is None:
            # Brings torch along, which checking a spec's settings must not.
            from deepmf_sumo.predictors.weights import cached_predictors

            self._predictors = cached_predictors(self._weights)
        policy = policy_module.build(
            self._settings, self._predictors, case.partner_id, case.av_driver
        )
        rollout = simulate(policy)
        return Attack(rollout=rollout, simulations=1, generation_s=policy.seconds)


def build(settings: Settings, weights: str) -> DeepMF:
    """The adversary; ``weights`` is a name or a folder as `predictors.weights.load` takes it."""
    return DeepMF(settings, weights)
