"""A policy beside somebody else's script, with one thread as on the workers of a sweep."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import AgentId, Plan, View
from deepmf_sumo.policies.base import Policy


@dataclass(frozen=True, slots=True)
class OneThread:
    """The policy ``inner``, whose networks compute within ``one_thread``."""

    inner: Policy
    one_thread: Callable[[], AbstractContextManager[None]]

    @property
    def period_steps(self) -> int | None:
        """As of the policy."""
        return self.inner.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """As the policy's."""
        with self.one_thread():
            return self.inner.reset(view, rng)

    def plan(self, view: View) -> Plan | None:
        """As the policy's."""
        with self.one_thread():
            return self.inner.plan(view)
