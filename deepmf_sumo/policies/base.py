"""What a policy is: whatever drives the opponent, live."""

from typing import Protocol

import numpy as np

from deepmf_sumo.datatypes import AgentId, Plan, View


class Policy(Protocol):
    """Drives an opponent from views alone."""

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once (version G)."""
        ...

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """Choose the opponent at the first view; None if there is nobody to attack."""
        ...

    def plan(self, view: View) -> Plan | None:
        """A new plan from here on; None keeps the last one."""
        ...
