"""CAT: likely candidates of the opponent against the AV's last rollouts, chosen once.

Source: Zhang et al., CAT: Closed-loop Adversarial Training for Safe End-to-End Driving, CoRL 2023.
It maximises P(Y_OV | X) * sum over the AV's rollouts of P(Y_AV) * Coll: the AV is not predicted but
replayed, and does not react to the candidate. Against DeepMF's version G with
``comfort_weight: 0``, with which it shares the opponent, the candidates and their limits, it
isolates what conditional prediction is worth.

Adapted: our marginal network; candidates are tracked within limits before they are scored, and
include paths to goals around the AV's rollout (``goal_candidates: 0`` as published); contacts are
tested at 10 Hz with exact boxes, while CAT tests every fifth step. As published: candidates beyond
the sixth have equal weights, a contact counts 0.99 times as much per half second of delay, and if
no candidate touches the AV, the one whose centre comes closest is driven.

Budget: two simulations, one unattacked and the attack. With more, every further round adds the AV's
rollout under the attack before (the last five are kept, as in CAT's training), until it is hit.
"""

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import AgentMotion, OpponentChoice, Scouted
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines._open_loop import (
    Aimed,
    AimedSettings,
    Answers,
    Scored,
    attack_in_rounds,
)
from deepmf_sumo.deepmf.candidates import Candidates, References, ranked
from deepmf_sumo.deepmf.candidates import weights as candidate_weights
from deepmf_sumo.deepmf.networks.predict import MOST_MODES, Marginal
from deepmf_sumo.deepmf.reference_paths import goal_paths, own_paths
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import track
from deepmf_sumo.scene import Attack, Budget, Case, Plan, PlanReason, View

FORESIGHT = "the AV's un-attacked motion"


class Settings(AimedSettings):
    """Candidates and their weights.

    Attributes:
        candidates: modes of the opponent.
        goal_candidates: maximum number of further paths to goals around the AV's rollouts.
        tail_after: candidates beyond this number of likeliest ones have the weight of the next one;
            null keeps the predicted weights.
        memory: number of the AV's last rollouts that are kept.
    """

    candidates: int = Field(default=32, ge=1, le=MOST_MODES)
    goal_candidates: int = Field(default=32, ge=0, le=256)
    tail_after: int | None = Field(default=6, ge=1)
    memory: int = Field(default=5, ge=1)


class CAT:
    """Attacks with a likely candidate that meets the AV's rollouts."""

    several = True

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._weights = weights
        self._opponent = OpponentChoice(settings.opponent, weights)
        self._marginal: Marginal | None = None

    def load(self) -> None:
        """Load the networks."""
        # Imports torch, which a check of a spec's settings must not do.
        from deepmf_sumo.deepmf.networks.weights import cached_predictors

        if self._marginal is None:
            self._marginal = cached_predictors(self._weights).marginal
        self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds."""
        self.load()
        marginal = self._marginal
        assert marginal is not None

        def aim(scouted: Scouted, rollouts: Sequence[AgentMotion]) -> Aimed:
            return self._aim(scouted, rollouts, marginal)

        choose, rounds = self._opponent.of(case), self._settings.rounds
        return attack_in_rounds(case, simulate, choose, aim, rounds, budget)

    def _aim(self, scouted: Scouted, rollouts: Sequence[AgentMotion], marginal: Marginal) -> Aimed:
        """The best candidate, and its scores."""
        view = scouted.view
        last = Answers.of(view, rollouts[-self._settings.memory :])
        own = self._candidates(view, scouted.opponent_id, last, marginal)
        weight = own.forecast.probability
        if self._settings.tail_after is not None:
            weight = open_loop.flattened(weight, self._settings.tail_after)
        scored = open_loop.score(weight, own.forecast.futures, last, view)
        parameters = {
            "candidate": float(scored.chosen),
            "probability": float(own.forecast.probability[scored.chosen]),
            "value": float(scored.value[scored.chosen]),
            "fallback": float(scored.fallback),
        }
        return Aimed(plan=_plan(view, own, last, scored), parameters=parameters)

    def _candidates(
        self, view: View, opponent_id: str, last: Answers, marginal: Marginal
    ) -> Candidates:
        """Predicted and goal-directed candidates of the opponent, drivable, likeliest first."""
        settings, limits = self._settings, self._settings.limits
        situation = Situation.of(view, opponent_id, limits, unattacked=last.forecast)
        prediction = marginal.predict(view, opponent_id)
        modes = prediction.modes(settings.candidates)
        count = len(modes.probability)
        parts = [References.of("mode", modes.futures.position_m, limits.rows(count))]
        if settings.goal_candidates:
            paths = own_paths(modes, situation.start)
            parts.append(goal_paths(situation, paths, settings.goal_candidates))
        references = References.joined(parts)
        tracked = track(references.position_m, situation.start, references.limits)
        probability = candidate_weights(modes, tracked.position_m[count:], prediction)
        return ranked(references, tracked, probability, modes)


def _plan(view: View, own: Candidates, last: Answers, scored: Scored) -> Plan:
    futures, row = own.forecast.futures, scored.chosen
    mass = scored.collides @ last.forecast.probability
    return Plan(
        agent_id=futures.agent_id,
        first_step=view.step + 1,
        position_m=futures.position_m[row],
        heading_rad=futures.heading_rad[row],
        speed_mps=own.speed_mps[row],
        reason=PlanReason(
            scores=None,
            candidates=own.forecast,
            reactions=(last.forecast,) * len(mass),
            collides=scored.collides,
            collision_step=scored.collision_step,
            value=scored.value,
            product=own.forecast.probability * mass,
            chosen=row,
            rule="fallback" if scored.fallback else "rollouts",
            bent_m=own.bent_m,
            origin=own.origin,
        ),
    )


def build(settings: Settings, weights: str) -> CAT:
    """The adversary; ``weights`` hold the networks, see `networks.weights.load`."""
    return CAT(settings, weights)
