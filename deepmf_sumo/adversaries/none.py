"""Nobody attacks: how the AV fares in the traffic as it is."""

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case


class Settings(plugins.Settings):
    """Nothing to set."""

    @property
    def takes_turns(self) -> bool:
        """Goes with ``opponents: in_turn``: for comparison with those who attack in turn."""
        return True


class Nobody:
    """One episode without a policy."""

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The episode."""
        return Attack(rollout=simulate(None), simulations=1, generation_s=0.0)


def build(settings: Settings, weights: str) -> Nobody:
    """The adversary that is none."""
    return Nobody()
