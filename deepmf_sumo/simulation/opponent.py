"""The opponent's schedule: when the policy plans, and where the plan wants the opponent."""

import numpy as np

from deepmf_sumo.datatypes import AgentId, Event, Floats, Plan, View
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation.frame import Pose

_MOVED_M = 0.05


class Opponent:
    """Asks the policy for plans at the first view and every period after it.

    ``id`` is None where there is no policy, or nobody to attack.
    """

    def __init__(self, policy: Policy | None, view: View, rng: np.random.Generator) -> None:
        self._policy = policy
        self._start = view.step
        self._follows = False
        self.plans: list[Plan] = []
        self.events: list[Event] = []
        self.id: AgentId | None = policy.reset(view, rng) if policy else None
        if self.id is not None and (self.id == view.av_id or self.id not in view.history.ids):
            raise SimulationError(
                f"The policy chose '{self.id}' as the opponent, which is not one of the agents "
                "around the AV at the current step."
            )

    def due(self, step: int) -> bool:
        """Whether the policy has to plan at this step."""
        if self._policy is None or self.id is None:
            return False
        period = self._policy.period_steps
        elapsed = step - self._start
        return elapsed == 0 or (period is not None and elapsed % period == 0)

    def replan(self, view: View) -> None:
        """A new plan, unless the policy keeps the last one or the opponent has gone."""
        if self._policy is None or self.id not in view.history.ids:
            return
        plan = self._policy.plan(view)
        if plan is None:
            return
        if plan.agent_id != self.id:
            raise SimulationError(
                f"The policy planned for '{plan.agent_id}', but its opponent is '{self.id}'."
            )
        self.plans.append(plan)

    def pose(self, step: int) -> Pose | None:
        """Where the opponent shall be at ``step``; None where no plan says so."""
        plan = self.plans[-1] if self.plans else None
        follows = plan is not None and plan.covers(step)
        if self.id is not None and self._follows and not follows:
            detail = "the opponent goes on without a plan"
            self.events.append(Event(step=step, agent_id=self.id, kind="plan_ended", detail=detail))
        self._follows = follows
        if plan is None or not follows:
            return None
        at = step - plan.first_step
        return Pose(
            x_m=float(plan.position_m[at, 0]),
            y_m=float(plan.position_m[at, 1]),
            heading_rad=float(plan.heading_rad[at]),
            speed_mps=float(plan.speed_mps[at]),
            course_rad=_course(plan.position_m[max(at - 1, 0) : at + 2]),
        )


def _course(position_m: Floats) -> float | None:
    """Direction of motion: a car's centre does not move along its heading in a bend."""
    x, y = position_m[-1] - position_m[0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > _MOVED_M else None
