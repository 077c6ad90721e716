"""A fixed trajectory: replays a known attack."""

import numpy as np

from deepmf_sumo.attacks import _fixed_path
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.scene import Attack, Budget, Case

Settings = _fixed_path.Settings


class TrajectoryAttack:
    """One episode under the fixed trajectory."""

    def __init__(self, settings: Settings) -> None:
        self._policy = _fixed_path.build(settings)

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The episode."""
        return Attack(rollout=simulate(self._policy), simulations=1, generation_s=0.0)


def build(settings: Settings, weights: str) -> TrajectoryAttack:
    """The adversary. Raises PluginError if the trajectory's file cannot be used."""
    return TrajectoryAttack(settings)
