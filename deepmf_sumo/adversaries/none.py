"""Nobody attacks: how the AV fares in the traffic as it is."""

from typing import Final

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.datatypes import Attack, Budget, Case

IN_TURN: Final = True
"""Goes with ``opponents: in_turn``."""


class Settings(plugins.Settings):
    """Nothing to set."""


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
