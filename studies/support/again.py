"""An adversary that repeats a run: attacker and supporters drive again what they drove."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.results import artifacts
from deepmf_sumo.scene import AgentId, Attack, Budget, Case, Driver, Plan, Rollout, View


class Settings(plugins.Settings):
    """The run's folder, and whether its supporters drive too, or are left to log or SUMO."""

    folder: str
    supporters: bool = True


class Policy:
    """One plan each, made at the first view."""

    period_steps: int | None = None

    def __init__(self, rollout: Rollout, *, supporters: bool) -> None:
        self._rollout, self._supporters = rollout, supporters

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """The attacker."""
        assert self._rollout.opponent_id is not None
        return (self._rollout.opponent_id,)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """As driven, to the last step; a supporter's plan begins where it joined."""
        opponent = self._rollout.opponent_id
        assert opponent is not None
        plans = {opponent: self._driven(opponent, None)}
        if self._supporters:
            plans |= {one: self._driven(one, opponent) for one in self._rollout.supporters}
        return plans

    def _driven(self, agent: AgentId, supports: AgentId | None) -> Plan:
        rollout = self._rollout
        row = rollout.tracks.row(agent)
        steps = np.flatnonzero(rollout.driver[row] == Driver.POLICY)
        steps = np.arange(steps[0], steps[-1] + 1)
        return Plan(
            agent_id=agent,
            first_step=int(steps[0]),
            position_m=rollout.tracks.position_m[row, steps],
            heading_rad=rollout.tracks.heading_rad[row, steps],
            speed_mps=rollout.tracks.speed_mps[row, steps],
            supports=supports,
        )


class Again:
    """One episode under the policy."""

    Settings = Settings

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    @classmethod
    def build(cls, settings: Settings, weights: str) -> "Again":
        """The adversary; it needs no weights."""
        return cls(settings)

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The episode."""
        rollout = artifacts.read_rollout(Path(self._settings.folder), (), "")
        return Attack(rollout=simulate(Policy(rollout, supporters=self._settings.supporters)))
