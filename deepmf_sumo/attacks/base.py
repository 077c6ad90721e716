"""Adversaries: methods that find an attack."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from deepmf_sumo.scene import Attack, Budget, Case, Rollout
from deepmf_sumo.scene.policy import Policy

Simulate = Callable[[Policy | None], Rollout]
"""One episode under a policy; without one, no vehicle attacks."""


class Adversary(Protocol):
    """Finds an attack through simulated episodes; never sees SUMO."""

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The best attack found within the budget."""
        ...


@runtime_checkable
class Checkable(Protocol):
    """An adversary that needs more than its settings name."""

    def check(self) -> None:
        """Raise WeightsError or PluginError if that is missing; called before hours of work."""
        ...


@runtime_checkable
class Loading(Protocol):
    """An adversary that reads weights."""

    def load(self) -> None:
        """Read what all attacks need, once: the copies of a worker then share it.

        Raises WeightsError.
        """
        ...


@runtime_checkable
class Several(Protocol):
    """An adversary that makes several episodes.

    Each may be simulated in another process: of its policies it reads only what their ``KEPT``
    names, see `scene.policy.Policy`.
    """

    @property
    def several(self) -> bool:
        """Whether it may make more than one."""
        ...
