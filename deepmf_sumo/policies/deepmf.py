"""DeepMF: attacks by factorised prediction, re-planned in closed loop (Algorithm 1 of the paper).

At 0, T, 2T, ...: the largest of P(Y_OV | X) * sum over Y_AV of P(Y_AV | Y_OV, X) * Coll(Y_OV, Y_AV)
among candidates Y_OV.
"""

import time
from typing import Literal, Protocol, Self

import numpy as np
from pydantic import Field, model_validator

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import (
    DT_S,
    FUTURE_STEPS,
    AgentId,
    AvDriver,
    Forecast,
    Futures,
    OpponentScores,
    Plan,
    PlanReason,
    View,
)
from deepmf_sumo.errors import RunError
from deepmf_sumo.policies.factorization import candidates, opponent
from deepmf_sumo.policies.factorization.candidates import Candidates, References
from deepmf_sumo.policies.factorization.collision import collisions
from deepmf_sumo.policies.factorization.goals import goal_paths
from deepmf_sumo.policies.factorization.selection import Rule, choose
from deepmf_sumo.policies.factorization.tracking import Limits, Start, track
from deepmf_sumo.predictors.base import ConditionalPredictor, MarginalPredictor, OpponentPredictor

_PERIOD_S = {"G": None, "S1": 1.0, "S2": 2.0, "S4": 4.0}


class DensePredictor(MarginalPredictor, candidates.Density, Protocol):
    """A marginal predictor that also knows the density of futures that it did not propose."""


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


class Settings(plugins.Settings):
    """How DeepMF attacks.

    Attributes:
        version: the paper's name of a period: G (one plan), S4, S2, S1.
        period_s: seconds between plans, a multiple of 0.1; null plans once (G).
        opponent: ``argmax`` or ``sample`` (softmax) of the scores; ``partner``: argmax of the head
            trained on labelled partners; ``labelled``: the partner that the recording names; else
            the id of a vehicle.
        rule: see `factorization.selection`.
        likelihood_weight: exponent on P(OV) in the rules ``expected`` and ``pair``; 1 as published.
        candidates: modes of the opponent (N1).
        goal_candidates: at most so many ways to goals around the AV's predicted positions besides
            (0 as published).
        reactions: modes of the AV (N2).
        av_driver: whose reactions are predicted: an automated ``planner``'s, or a ``human``'s;
            null takes what the AV's planner is (``human`` for ``replay``).
        conditional: False predicts the AV as if it knew nothing of the opponent's future, by the
            same network: P(Y_AV | X) in place of P(Y_AV | Y_OV, X), to see what that is worth.
        accel_mps2, brake_mps2, lateral_mps2: limits of what the opponent drives.
        keep_tail: the rest of the last plan is a candidate too.
    """

    version: Literal["G", "S4", "S2", "S1"] | None = None
    period_s: float | None = Field(default=1.0, ge=DT_S)
    opponent: str = Field(default="argmax", min_length=1)
    rule: Rule = "expected"
    likelihood_weight: float = Field(default=1.0, ge=0.0)
    candidates: int = Field(default=32, ge=1, le=256)
    goal_candidates: int = Field(default=32, ge=0, le=256)
    reactions: int = Field(default=6, ge=1, le=64)
    av_driver: AvDriver | None = None
    conditional: bool = True
    accel_mps2: float = Field(default=3.0, gt=0.0)
    brake_mps2: float = Field(default=4.0, gt=0.0)
    lateral_mps2: float = Field(default=3.0, gt=0.0)
    keep_tail: bool = False

    @model_validator(mode="after")
    def _one_period(self) -> Self:
        both = self.version is not None and "period_s" in self.model_fields_set
        if both and self.period_s != _PERIOD_S[str(self.version)]:
            raise ValueError(f"version {self.version} and period_s {self.period_s} disagree")
        if self.period_s is not None and abs(self.period_s / DT_S % 1 - 0.5) < 0.499:
            raise ValueError(f"period_s {self.period_s} is no multiple of {DT_S} s")
        return self

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once."""
        period = self.period_s if self.version is None else _PERIOD_S[self.version]
        return None if period is None else round(period / DT_S)

    @property
    def limits(self) -> Limits:
        """Limits of what the opponent drives."""
        return Limits(accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2)


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
        self._opponent_id: AgentId | None = None
        self._scores: OpponentScores | None = None
        self._last: Plan | None = None
        self.seconds = 0.0

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once."""
        return self._settings.period_steps

    def reset(self, view: View, rng: np.random.Generator) -> AgentId | None:
        """Choose the opponent once, before the first plan.

        Raises RunError where the settings name an opponent that is not there.
        """
        watch = _Stopwatch()
        self._last, self._scores = None, None
        how = self._settings.opponent
        if how in {"argmax", "sample", "partner"}:
            self._scores = self._predictors.opponent.score(view)
            self._opponent_id = opponent.from_scores(self._scores, how, rng)
        elif how == "labelled":
            if self._partner_id is None:
                raise RunError(
                    "opponent is 'labelled', but the recording names no partner of the AV; use "
                    "argmax, sample or partner."
                )
            self._opponent_id = opponent.named(view, self._partner_id)
        else:
            self._opponent_id = opponent.named(view, how)
        watch.lap("opponent")
        self.seconds += watch.seconds
        return self._opponent_id

    def plan(self, view: View) -> Plan | None:
        """The opponent's next 8 s; None where the opponent or the AV is gone."""
        if self._opponent_id not in view.history.ids or view.av_id not in view.history.ids:
            return None
        watch = _Stopwatch()
        start = Start.of(view, self._opponent_id)
        own = self._candidates(view, start, watch)
        reactions = self._reactions(view, own)
        watch.lap("conditional")
        self._last = self._select(view, own, reactions, watch)
        self.seconds += watch.seconds
        return self._last

    def _candidates(self, view: View, start: Start, watch: "_Stopwatch") -> Candidates:
        """Predicted and made candidates of the opponent, drivable, with P(OV)."""
        settings, marginal = self._settings, self._predictors.marginal
        assert self._opponent_id is not None
        (modes,) = marginal.predict(view, [self._opponent_id], settings.candidates)
        limits = settings.limits
        count = len(modes.probability)
        parts = [References.of("mode", modes.futures.position_m, limits.rows(count))]
        watch.lap("marginal")
        if settings.goal_candidates:
            (av,) = self._react(view, None)
            watch.lap("conditional")
            parts.append(self._goals(view, modes, av, start))
            watch.lap("goals")
        if settings.keep_tail and self._last is not None:
            rest = candidates.tail(self._last, view, limits, FUTURE_STEPS)
            parts += [rest] if rest else []
        references = References.joined(parts)
        tracked = track(references.position_m, start, references.limits)
        watch.lap("track")
        probability = candidates.weights(modes, tracked.position_m[count:], marginal, view)
        watch.lap("marginal")
        return candidates.ranked(references, tracked, probability, modes)

    def _goals(self, view: View, modes: Forecast, av: Forecast, start: Start) -> References:
        paths = goal_paths(
            modes,
            av,
            start,
            _footprint(view, view.av_id),
            self._settings.limits,
            min(FUTURE_STEPS, view.steps_left),
            self._settings.goal_candidates,
        )
        return References.of("goal", paths.reference_m, paths.limits)

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
        self, view: View, own: Candidates, reactions: list[Forecast], watch: "_Stopwatch"
    ) -> Plan:
        """Collide all pairs within the time that is left, choose, and say why."""
        futures = own.forecast.futures
        collides, collision_step = collisions(
            futures,
            reactions,
            _footprint(view, futures.agent_id),
            _footprint(view, view.av_id),
            min(FUTURE_STEPS, view.steps_left),
        )
        watch.lap("collision")
        choice = choose(
            own.forecast.probability,
            np.stack([reaction.probability for reaction in reactions]),
            collides,
            collision_step,
            self._settings.rule,
            self._settings.likelihood_weight,
        )
        watch.lap("select")
        reason = PlanReason(
            scores=self._scores,
            candidates=own.forecast,
            reactions=tuple(reactions),
            collides=collides,
            collision_step=collision_step,
            value=choice.value,
            product=choice.product,
            chosen=choice.index,
            rule=choice.rule,
            bent_m=own.bent_m,
            milliseconds=watch.milliseconds,
            origin=own.origin,
        )
        return Plan(
            agent_id=futures.agent_id,
            first_step=view.step + 1,
            position_m=futures.position_m[choice.index],
            heading_rad=futures.heading_rad[choice.index],
            speed_mps=own.speed_mps[choice.index],
            reason=reason,
        )


def build(
    settings: Settings,
    predictors: Predictors,
    partner_id: AgentId | None = None,
    av_driver: AvDriver = "planner",
) -> DeepMF:
    """The policy; ``partner_id`` is what ``opponent: labelled`` attacks."""
    return DeepMF(settings, predictors, partner_id, av_driver)


def _footprint(view: View, agent_id: AgentId) -> np.ndarray:
    """(2) length and width of an agent."""
    size: np.ndarray = view.history.size_m[view.history.row(agent_id), :2]
    return size


class _Stopwatch:
    """Wall time by part."""

    def __init__(self) -> None:
        self._since = time.perf_counter()
        self.milliseconds: dict[str, float] = {}

    def lap(self, part: str) -> None:
        """Add the time since the last lap to a part."""
        now = time.perf_counter()
        spent = 1000 * (now - self._since)
        self.milliseconds[part] = self.milliseconds.get(part, 0.0) + spent
        self._since = now

    @property
    def seconds(self) -> float:
        """Sum of all laps."""
        return sum(self.milliseconds.values()) / 1000
