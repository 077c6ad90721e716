"""STRIVE: latents of a learned traffic model, moved until a likely motion hits the AV.

Source: Rempe et al., Generating Useful Accident-Prone Driving Scenarios via a Learned Traffic
Prior, CVPR 2022. A conditional VAE over the graph of vehicles decodes latents into motions; Adam
moves the latents in three stages: match the unattacked motion, attack the AV, and save it.

Adapted: the prior is ours (`baselines.priors.strive`), trained on the data of the other
networks. The opponent is chosen as by the other methods; ``opponent: any`` is STRIVE's choice, the
vehicle that comes closest, of those that are not always behind the AV. The attack minimises the
distance to the AV's last rollout, and the AV is simulated against the attack every ``iterations /
rounds`` iterations. The stage ends as soon as a rollout hits: the latents stay as likely as the hit
allows. Only the opponent drives its motion; the others keep their unattacked motion, and are
obstacles for it.

Budget: ``match_iterations`` + ``iterations`` + ``solution_iterations`` steps of Adam, at most
``seconds`` if that is set; and ``rounds`` + 1 simulations. The last trial says whether the AV could
be saved: ``solvable`` is 1 if a motion of the AV without a contact was found, 0 if not within all
steps; the trial is missing if the time ran out before.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    OpponentChoice,
    OpponentSettings,
    Scouted,
    deadline,
    limited,
    motion_of,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines._open_loop import Aimed, attack_in_rounds
from deepmf_sumo.scene import AgentId, Attack, Budget, Case, Trial, View
from deepmf_sumo.scene.geometry import frames

if TYPE_CHECKING:
    from deepmf_sumo.baselines._scene_graph import GraphSituation
    from deepmf_sumo.baselines._strive import LatentSearch
    from deepmf_sumo.baselines.priors.strive import MotionPrior

ANY = "any"

FORESIGHT = (
    "the un-attacked motion of all agents, where it begins, and the AV's answer to every round"
)


class Settings(OpponentSettings):
    """The search over latents.

    Attributes:
        opponent: as of the other methods, or ``any``: the vehicle that comes closest, without those
            that are behind the AV all the time (if all are: the nearest vehicle).
        match_iterations, iterations, solution_iterations: of the three stages; 0 skips the last
            stage.
        rounds: rollouts of the attack, so that the AV can react to it.
        seconds: time limit; null: no limit. With a limit the result depends on the machine.
        others, road, prior, init: weights of overlap with others, of metres off the road, of
            unlikely latents, and of their change, in metres of distance to the AV.
    """

    match_iterations: int = Field(default=20, ge=0)
    iterations: int = Field(default=200, ge=1)
    solution_iterations: int = Field(default=50, ge=0)
    rounds: int = Field(default=10, ge=1)
    seconds: float | None = Field(default=None, gt=0.0)
    others: float = Field(default=40.0, ge=0.0)
    road: float = Field(default=4.0, ge=0.0)
    prior: float = Field(default=0.02, ge=0.0)
    init: float = Field(default=0.01, ge=0.0)


class STRIVE:
    """Attacks through latents; the first attack loads the prior."""

    several = True

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._opponent = (
            None if settings.opponent == ANY else OpponentChoice(settings.opponent, weights)
        )

    def check(self) -> None:
        """Raises WeightsError if the set of weights has no motion prior, or without torch."""
        from deepmf_sumo.deepmf.networks.weights import need

        need("torch", "The adversary strive, which follows gradients,")
        from deepmf_sumo.baselines.priors.reading import motion_prior  # imports torch

        motion_prior(self._weights)

    def load(self) -> None:
        """Load torch and the networks. Raises WeightsError if the set has no prior."""
        self.check()
        # Imports torch, which a check of a spec's settings must not do.
        from deepmf_sumo.baselines import _strive as strive  # noqa: F401

        if self._opponent is not None:
            self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds. Raises WeightsError if the set has no prior."""
        chosen = self._settings
        self.load()  # not timed
        from deepmf_sumo.baselines.priors.reading import motion_prior

        net = motion_prior(self._weights)
        choose = nearest_vehicle if self._opponent is None else self._opponent.of(case)
        limit = limited(budget, chosen.rounds + 1, chosen.seconds)
        stages = _Stages(chosen, net, case, limit)
        attack = attack_in_rounds(case, simulate, choose, stages.aim, chosen.rounds, limit)
        if not chosen.solution_iterations or not attack.rollout.plans:
            return attack
        begin = time.perf_counter()
        solved = stages.solution(attack)
        return replace(
            attack,
            trials=(*attack.trials, *solved),
            generation_s=attack.generation_s + time.perf_counter() - begin,
            out_of_time=attack.out_of_time or not solved,
        )


class _Stages:
    """The stages of one attack."""

    def __init__(self, settings: Settings, net: "MotionPrior", case: Case, budget: Budget) -> None:
        self._settings, self._net, self._case = settings, net, case
        self._deadline = deadline(budget)
        self._search: LatentSearch | None = None
        self._situation: GraphSituation | None = None
        self._matched_m = 0.0

    def aim(self, scouted: Scouted, rollouts: Sequence[AgentMotion]) -> Aimed:
        """One round: match the AV's last rollout, then attack it."""
        if self._search is None or self._situation is None:
            self._begin(scouted)
        assert self._search is not None
        assert self._situation is not None
        rollout = self._situation.to_path(rollouts[-1])
        if len(rollouts) > 1:
            self._search.match_av(rollout, self._settings.match_iterations // 2)
        from deepmf_sumo.baselines import _strive as strive

        a_round = -(-self._settings.iterations // self._settings.rounds)
        found = self._search.attack(rollout, a_round)
        return Aimed(
            plan=strive.plan_of(
                self._situation, found.motions, found.closest, self._case.duration_steps
            ),
            parameters={
                "iterations": float(found.iterations),
                "match_error_m": self._matched_m,
                "predicted_gap_m": found.gap_m,
            },
        )

    def solution(self, attack: Attack) -> list[Trial]:
        """The third stage against the best attack, with its objective; empty out of time."""
        from deepmf_sumo.baselines._strive import Costs

        assert self._search is not None
        assert self._situation is not None
        plan = attack.rollout.plans[0]
        motion = AgentMotion(
            position_m=plan.position_m,
            heading_rad=plan.heading_rad,
            speed_mps=plan.speed_mps,
            valid=np.ones(len(plan.speed_mps), bool),
        )
        chosen = self._settings
        saved = self._search.save(
            {plan.agent_id: self._situation.to_path(motion)},
            chosen.solution_iterations,
            Costs(others=chosen.others, road=chosen.road, prior=chosen.prior / 4, init=0.0),
        )
        if saved is None:
            return []
        best = max(trial.objective for trial in attack.trials)
        return [Trial(values={"solvable": float(saved)}, objective=best)]

    def _begin(self, scouted: Scouted) -> None:
        from deepmf_sumo.baselines import _scene_graph as scene_graph
        from deepmf_sumo.baselines import _strive as strive

        chosen, view = self._settings, scouted.view
        attackers = [scouted.opponent_id]
        self._situation = scene_graph.situation_of(scouted, attackers)
        if chosen.opponent == ANY:
            able = (name for name in self._situation.ids if _can_attack(view, name))
            attackers = [name for name in able if not _always_behind(scouted, name)] or attackers
        weights = strive.Costs(chosen.others, chosen.road, chosen.prior, chosen.init)
        self._search = strive.LatentSearch(
            self._net, self._situation, attackers, weights, self._deadline
        )
        self._matched_m = self._search.match(chosen.match_iterations)


def nearest_vehicle(view: View, rng: np.random.Generator) -> AgentId | None:
    """The vehicle nearest to the AV, None if there is none; STRIVE only needs to know that."""
    tracks = view.history
    away = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[tracks.row(view.av_id), -1]).T)
    others = [row for row in np.argsort(away).tolist() if _can_attack(view, tracks.ids[row])]
    return tracks.ids[others[0]] if others else None


def _can_attack(view: View, agent_id: AgentId) -> bool:
    kind = view.history.kinds[view.history.row(agent_id)]
    return kind == "vehicle" and agent_id != view.av_id


def _always_behind(scouted: Scouted, agent_id: AgentId) -> bool:
    """Whether its centre is behind the AV's while both are there, without the attack."""
    other = motion_of(scouted.rollout, agent_id, len(scouted.av.valid))
    both = other.valid & scouted.av.valid
    away = other.position_m[both] - scouted.av.position_m[both]
    return bool(((away * frames.unit(scouted.av.heading_rad[both])).sum(-1) < 0.0).all())


def build(settings: Settings, weights: str) -> STRIVE:
    """The adversary; ``weights`` hold the networks, see `networks.weights.load`."""
    return STRIVE(settings, weights)
