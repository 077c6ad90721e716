"""No attack: the AV in unchanged traffic."""

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.scene import Attack, Budget, Case


class Settings(plugins.Settings):
    """No settings."""

    @property
    def takes_turns(self) -> bool:
        """True: ``opponents: in_turn`` is allowed, for comparison with attacks in turn."""
        return True


class NoAttack:
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


def build(settings: Settings, weights: str) -> NoAttack:
    """The adversary."""
    return NoAttack()
