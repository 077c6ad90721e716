"""Nobody attacks: how the AV fares in the traffic as it is."""

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case


class Settings(plugins.Settings):
    """Nothing to set."""


class Nobody:
    """One episode without a policy."""

    def attack(
        self,
        case: Case,  # noqa: ARG002
        simulate: Simulate,
        budget: Budget,  # noqa: ARG002
        rng: np.random.Generator,  # noqa: ARG002
    ) -> Attack:
        """The episode."""
        return Attack(rollout=simulate(None), simulations=1, generation_s=0.0)


def build(settings: Settings, weights: str) -> Nobody:  # noqa: ARG001
    """The adversary that is none."""
    return Nobody()
