"""The contract of a policy, which drives the opponent step by step."""

from typing import Protocol

import numpy as np

from deepmf_sumo.datatypes import AgentId, Plan, View


class Policy(Protocol):
    """Drives an opponent from views alone.

    An adversary that makes `several` episodes may find its policy unchanged after one, for that may
    be simulated in another process; the attributes that ``KEPT`` names come back.
    """

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once (version G)."""
        ...

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """Choose the opponent at the first view; None if no vehicle can attack."""
        ...

    def plan(self, view: View) -> Plan | None:
        """A new plan from here on; None keeps the last one."""
        ...
