"""DeepMF: attacks by factorised prediction, re-planned in closed loop (Algorithm 1 of the paper).

At 0, T, 2T, ...: the largest of P(Y_OV | X) * sum over Y_AV of P(Y_AV | Y_OV, X) * Coll(Y_OV, Y_AV)
among candidates Y_OV.
"""

from typing import Protocol

import numpy as np

from deepmf_sumo.datatypes import (
    AgentId,
    AvDriver,
    Forecast,
    Futures,
    OpponentScores,
    Plan,
    PlanReason,
    View,
)
from deepmf_sumo.deepmf import constraints, scoring
from deepmf_sumo.deepmf.candidates import Candidates, Stopwatch
from deepmf_sumo.deepmf.generation import DensePredictor, propose, shortlisted
from deepmf_sumo.deepmf.opponent import choose, highest
from deepmf_sumo.deepmf.scoring import Choice
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.traffic_rules import Law
from deepmf_sumo.predictors.base import ConditionalPredictor, OpponentPredictor

__all__ = ["DeepMF", "Predictors", "Settings", "build"]


class Predictors(Protocol):
    """The three networks of the paper."""

    @property
    def opponent(self) -> OpponentPredictor:
        """How suitable each vehicle is: phi in the paper."""
        ...

    @property
    def marginal(self) -> DensePredictor:
        """The opponent's futures: phi_M."""
        ...

    @property
    def conditional(self) -> ConditionalPredictor:
        """The AV's futures given the opponent's: phi_C."""
        ...


class DeepMF:
    """The policy. ``seconds`` is the wall time of all resets and plans so far."""

    def __init__(
        self,
        settings: Settings,
        predictors: Predictors,
        partner_id: AgentId | None = None,
        av_driver: AvDriver = "planner",
    ) -> None:
        self._settings = settings
        self._predictors = predictors
        self._partner_id = partner_id
        self._av_driver = settings.av_driver or av_driver
        self._rng: np.random.Generator | None = None
        self._opponent_id: AgentId | None = None
        self._scores: OpponentScores | None = None
        self._last: Plan | None = None
        self._first: Plan | None = None  # made while the opponent was chosen
        self._committed = False  # the last plan attacks, and was fair when it was chosen
        self._law: Law | None = None  # with the wish for lawful attacks
        self.seconds = 0.0

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once."""
        return self._settings.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """Choose the opponent once, before the first plan.

        Raises RunError where the settings name an opponent that is not there.
        """
        watch = Stopwatch()
        self._rng = rng
        self._first = None
        self._begin()
        self._opponent_id, self._scores = choose(
            view, self._settings.opponent, self._predictors.opponent, self._partner_id, rng
        )
        watch.lap("opponent")
        self.seconds += watch.seconds
        if self._settings.tried > 1 and self._scores and self._scores.ids:
            self._opponent_id = self._most_promising(view, self._scores)
        return self._opponent_id

    def _most_promising(self, view: View, scores: OpponentScores) -> AgentId:
        """The highest score among those that meet the AV at least 95 % as likely as the best."""
        settings, firsts = self._settings, {}
        tried = highest(scores, settings.opponent, settings.tried)
        for self._opponent_id in tried:
            self._begin()
            firsts[self._opponent_id] = self._plan(view), self._committed, self._law
        mass = {agent_id: _most_mass(plan) for agent_id, (plan, *_) in firsts.items()}
        enough = scoring.MASS_SHARE * max(mass.values())
        best = next(agent_id for agent_id in firsts if mass[agent_id] >= enough)
        self._first, self._committed, self._law = firsts[best]
        return best

    def _begin(self) -> None:
        """Nothing is planned yet."""
        self._last, self._committed = None, False
        self._law = Law() if self._settings.lawful else None

    def plan(self, view: View) -> Plan | None:
        """The opponent's next 8 s; None where the opponent or the AV is gone."""
        if self._opponent_id not in view.history.ids or view.av_id not in view.history.ids:
            return None
        if self._first is not None:
            self._last, self._first = self._first, None
            return self._last
        self._last = self._plan(view)
        return self._last

    def _plan(self, view: View) -> Plan:
        watch = Stopwatch()
        alone = self._alone(view, watch)
        own = self._proposed(view, alone, watch)
        watch.lap("collision")
        reactions = self._reactions(view, own)
        watch.lap("conditional")
        plan = self._select(view, own, reactions, alone, watch)
        self.seconds += watch.seconds
        return plan

    def _alone(self, view: View, watch: Stopwatch) -> Forecast | None:
        """The AV's futures if nobody attacks; None where nothing needs them."""
        settings = self._settings
        if not (settings.goal_candidates or settings.fair or settings.lawful):
            return None
        (av,) = self._react(view, None)
        watch.lap("conditional")
        return av

    def _proposed(self, view: View, alone: Forecast | None, watch: Stopwatch) -> Candidates:
        """Candidates of the opponent that reactions are predicted to."""
        settings = self._settings
        assert self._opponent_id is not None
        kept = settings.keep_tail or self._committed or settings.wanted_sector is not None
        last = self._last if kept else None
        marginal = self._predictors.marginal
        own = propose(view, self._opponent_id, marginal, alone, last, settings, watch)
        return shortlisted(view, own, alone, settings)

    def _reactions(self, view: View, own: Candidates) -> list[Forecast]:
        """The AV's futures under each candidate; without condition the same ones under all."""
        if self._settings.conditional:
            return self._react(view, own.forecast.futures)
        return self._react(view, None) * len(own.forecast.probability)

    def _react(self, view: View, given: Futures | None) -> list[Forecast]:
        return self._predictors.conditional.react(
            view,
            view.av_id,
            given,
            self._settings.reactions,
            planner=self._av_driver == "planner",
        )

    def _select(
        self,
        view: View,
        own: Candidates,
        reactions: list[Forecast],
        alone: Forecast | None,
        watch: Stopwatch,
    ) -> Plan:
        """Collide all pairs within the time that is left, choose, and say why."""
        futures = own.forecast.futures
        pairs = constraints.pairs(
            view, own, reactions, alone, self._settings, self._committed, self._law, watch
        )
        pairs, choice, unmet = self._choose(view, own, reactions, pairs)
        self._committed = pairs.fair is not None and bool(
            (pairs.fair & pairs.collides.any(axis=1))[choice.index]
        )
        watch.lap("select")
        return Plan(
            agent_id=futures.agent_id,
            first_step=view.step + 1,
            position_m=futures.position_m[choice.index],
            heading_rad=futures.heading_rad[choice.index],
            speed_mps=own.speed_mps[choice.index],
            reason=self._reason(own, reactions, pairs, choice, unmet, watch),
        )

    def _choose(
        self, view: View, own: Candidates, reactions: list[Forecast], pairs: constraints.Pairs
    ) -> constraints.Decision:
        """The choice; with ``fair`` the first that is fair also against what it collides with."""
        settings, futures = self._settings, own.forecast.futures

        def verify(row: int) -> bool:
            kept = self._committed and own.origin[row] == "tail"
            hits = pairs.collides[row]
            return kept or constraints.verified(view, row, futures, reactions[row], hits)

        return constraints.decide(
            pairs,
            settings.choice_rule,
            settings.likelihood_weight,
            settings.wanted_sector,
            verify,
            self._rng,
        )

    def _reason(
        self,
        own: Candidates,
        reactions: list[Forecast],
        pairs: constraints.Pairs,
        choice: Choice,
        unmet: tuple[str, ...],
        watch: Stopwatch,
    ) -> PlanReason:
        return PlanReason(
            scores=self._scores,
            candidates=own.forecast,
            reactions=tuple(reactions),
            collides=pairs.collides,
            collision_step=pairs.collision_step,
            value=choice.value,
            product=choice.product,
            chosen=choice.index,
            rule=choice.rule,
            bent_m=own.bent_m,
            milliseconds=watch.milliseconds,
            origin=own.origin,
            wanted_sector=self._settings.wanted_sector,
            sector=pairs.sector,
            fair=pairs.fair,
            lawful=pairs.lawful,
            unmet=unmet,
        )


def _most_mass(plan: Plan) -> float:
    assert plan.reason is not None
    return float(plan.reason.wished_mass.max())


def build(
    settings: Settings,
    predictors: Predictors,
    partner_id: AgentId | None = None,
    av_driver: AvDriver = "planner",
) -> DeepMF:
    """The policy; ``partner_id`` is what ``opponent: labelled`` attacks."""
    return DeepMF(settings, predictors, partner_id, av_driver)
