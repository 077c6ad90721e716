"""The contract of a policy, which drives the vehicles that attack, step by step."""

from collections.abc import Collection, Mapping
from typing import Any, Protocol

import numpy as np

from deepmf_sumo.errors import PluginError, SimulationError
from deepmf_sumo.scene import AgentId, Plan, View


class Policy(Protocol):
    """Drives one vehicle or several from views alone.

    An adversary that makes `several` episodes may find its policy unchanged after one, for that may
    be simulated in another process; the attributes that ``KEPT`` names come back.
    """

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once (version G)."""
        ...

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """Choose the vehicles that attack, at the first view; empty if none can."""
        ...

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """New plans from here on, by vehicle; the others keep their last ones.

        A plan whose ``supports`` is an attacker may be of any other road user: it supports.
        """
        ...


def chosen(policy: Policy, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
    """The vehicles with which a policy attacks.

    Raises PluginError for an answer that is no tuple, SimulationError for one that names a vehicle
    twice, or one that is not among the agents of the view.
    """
    found: Any = policy.reset(view, rng)
    if not isinstance(found, tuple):
        raise PluginError(
            f"The policy's reset returned {found!r}; return a tuple of the ids of the vehicles that"
            " attack, ('a',) for a vehicle 'a', and () if none can."
        )
    for agent in found:
        if agent == view.av_id or agent not in view.history.ids:
            raise SimulationError(
                f"The policy chose '{agent}' as the opponent, which is not one of the agents "
                "around the AV at the current step."
            )
        if found.count(agent) > 1:
            raise SimulationError(f"The policy chose '{agent}' more than once; name it once.")
    return found


def planned(policy: Policy, view: View, attackers: Collection[AgentId]) -> Mapping[AgentId, Plan]:
    """The new plans of a policy for the vehicles with which it attacks, and their supporters.

    Raises PluginError for an answer that is no mapping, SimulationError for a plan of another
    vehicle.
    """
    found: Any = policy.plan(view)
    if not isinstance(found, Mapping):
        raise PluginError(
            f"The policy's plan returned an object of type '{type(found).__name__}'; return plans"
            " by vehicle, {plan.agent_id: plan}, and {} where all keep their last plans."
        )
    for agent, plan in found.items():
        if plan.agent_id == agent and _supports(plan, view, attackers):
            continue
        if agent not in attackers or plan.agent_id != agent:
            known = ", ".join(f"'{one}'" for one in attackers)
            other = agent if agent not in attackers else plan.agent_id
            raise SimulationError(f"The policy planned for '{other}', but its opponent is {known}.")
    return found


def _supports(plan: Plan, view: View, attackers: Collection[AgentId]) -> bool:
    """Whether a plan is one of another road user that is there, for one of the attackers."""
    others = {*view.history.ids} - {view.av_id, *attackers}
    return plan.supports in attackers and plan.agent_id in others
