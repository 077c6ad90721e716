"""One plan as a policy: how a search has a trajectory driven."""

import numpy as np

from deepmf_sumo.datatypes import AgentId, Plan, View


class Planned:
    """The opponent of the plan drives the plan, whatever the AV does."""

    period_steps: int | None = None

    def __init__(self, plan: Plan) -> None:
        self._plan = plan

    def reset(self, view: View, rng: np.random.Generator) -> AgentId:
        """The plan's agent."""
        return self._plan.agent_id

    def plan(self, view: View) -> Plan:
        """The plan."""
        return self._plan
