"""DeepMF: attacks by factorised prediction, re-planned in closed loop (Algorithm 1 of the paper).

At 0, T, 2T, ...: the largest of P(Y_OV | X) * sum over Y_AV of P(Y_AV | Y_OV, X) * Coll(Y_OV, Y_AV)
among candidates Y_OV (rule ``expected``; specs have ``likeliest`` by default, see `scoring`).
`DeepMF._plan` is the whole of it: generate candidates, predict the AV's
reactions, collide all pairs, apply the constraints, choose.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from deepmf_sumo.deepmf import candidates, constraints, scoring, support
from deepmf_sumo.deepmf.candidates import Candidates, References
from deepmf_sumo.deepmf.constraints import Constraint
from deepmf_sumo.deepmf.experience import Experience, Predicted
from deepmf_sumo.deepmf.networks.opponent import Opponent
from deepmf_sumo.deepmf.networks.people import People
from deepmf_sumo.deepmf.networks.predict import Conditional, ConditionalPrediction, Marginal
from deepmf_sumo.deepmf.off_lane_paths import on_ground, staying_on_ground
from deepmf_sumo.deepmf.opponent import ByClass, choose_opponent, highest, tried
from deepmf_sumo.deepmf.reference_paths import goals, own_paths
from deepmf_sumo.deepmf.scoring import Choice, Mask, Objective, Pairs
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import track
from deepmf_sumo.scene import (
    FUTURE_STEPS,
    AgentId,
    AvDriver,
    Forecast,
    Heat,
    OpponentScores,
    Plan,
    PlanReason,
    View,
)
from deepmf_sumo.scene.road_users import MotionLimits, road_user

__all__ = ["DeepMF", "PredictorSet", "Settings", "build"]


class PredictorSet(Protocol):
    """The three networks of the paper, and the one for people."""

    @property
    def opponent(self) -> Opponent:
        """Scores of vehicles as opponents: phi. People are scored without weights."""
        ...

    @property
    def marginal(self) -> Marginal:
        """Futures of the opponent: phi_M."""
        ...

    @property
    def conditional(self) -> Conditional:
        """Futures of the AV given the opponent's: phi_C."""
        ...

    @property
    def people(self) -> People:
        """Futures of an opponent on foot or on a bicycle."""
        ...


@dataclass(slots=True, kw_only=True, eq=False)
class _Attack:
    """An opponent, and the state that is kept from one plan to the next.

    Attributes:
        begun: step of the first plan; None before it.
        last: the last plan.
        ready: ``last`` was made when opponents were compared, and has not been returned yet.
        supporter: the last plan of the vehicle that supports it; None without one.
    """

    opponent_id: AgentId
    constraints: tuple[Constraint, ...]
    begun: int | None = None
    last: Plan | None = None
    ready: bool = False
    supporter: Plan | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Av:
    """The AV's prediction at one moment, and its futures without an attack (None: not needed)."""

    prediction: ConditionalPrediction
    unattacked: Forecast | None


class Stopwatch:
    """Wall time by part."""

    def __init__(self) -> None:
        self._since = time.perf_counter()
        self.milliseconds: dict[str, float] = {}

    def lap(self, part: str) -> None:
        """Add the time since the last call to a part."""
        now = time.perf_counter()
        spent = 1000 * (now - self._since)
        self.milliseconds[part] = self.milliseconds.get(part, 0.0) + spent
        self._since = now

    @property
    def seconds(self) -> float:
        """Sum of all laps."""
        return sum(self.milliseconds.values()) / 1000


class DeepMF:
    """The policy. ``seconds`` is the wall time of all resets and plans so far."""

    KEPT: tuple[str, ...] = ("seconds", "predicted")

    def __init__(
        self,
        settings: Settings,
        predictors: PredictorSet,
        partner_id: AgentId | None = None,
        av_driver: AvDriver = "planner",
        experience: Experience | None = None,
    ) -> None:
        self._experience = experience or Experience()
        self._settings = settings
        self._limits, self._constrained = settings.limits, settings.constrained
        self._comfort, self._most = settings.comfort, settings.most_candidates
        self._sector = settings.wanted_sector
        self._predictors = predictors
        self._partner_id = partner_id
        self._planner = av_driver == "planner"
        self._objective = Objective()
        self._scores: OpponentScores | None = None
        self._attack: _Attack | None = None
        self.seconds = 0.0

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None: one plan."""
        return self._settings.period_steps

    @property
    def predicted(self) -> dict[tuple[int, AgentId], Predicted]:
        """What the next try need not predict again."""
        return self._experience.predicted

    @predicted.setter
    def predicted(self, found: dict[tuple[int, AgentId], Predicted]) -> None:
        self._experience.predicted = found

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """Choose the opponent, before the first plan.

        Raises RunError if the settings name an opponent that is not in the view.
        """
        settings, watch = self._settings, Stopwatch()
        self._objective = Objective(
            rule=settings.choice_rule, likelihood_weight=settings.form.likelihood_weight, rng=rng
        )
        self._attack = None
        who = "all" if settings.names_opponent else settings.attackers
        scorer = ByClass(self._predictors.opponent, who, self._av_ahead)
        chosen, self._scores = choose_opponent(
            view, settings.opponent, scorer, self._partner_id, rng, who
        )
        watch.lap("opponent")
        self.seconds += watch.seconds
        if chosen is None:
            return ()
        if settings.tried > 1 and self._scores:
            first = self._not_given_up(view, self._scores)
            self._attack = self._most_promising(view, [self._new_attack(one) for one in first])
        else:
            self._attack = self._new_attack(chosen)
        return (self._attack.opponent_id,)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """The next 8 s of the opponent, and of a supporter where there is one.

        Empty if the opponent or the AV is not in the view.
        """
        attack, present = self._attack, view.history.ids
        if attack is None or attack.opponent_id not in present or view.av_id not in present:
            return {}
        plan = attack.last
        if plan is None or not attack.ready:
            watch = Stopwatch()
            plan = self._plan(view, attack, self._predict_av(view, watch), watch)
        if self._settings.supporting:
            plan = self._supported(view, attack, plan)
        attack.last, attack.ready = plan, False
        supporter = attack.supporter
        beside = {supporter.agent_id: supporter} if supporter is not None else {}
        return {attack.opponent_id: plan, **beside}

    def _supported(self, view: View, attack: _Attack, plan: Plan) -> Plan:
        """The plan, which says who supports it; the supporter's own is kept in the attack."""
        watch, last = Stopwatch(), self._experience.last
        situation = Situation.of(view, plan.agent_id, self._limits, None, None, last)
        found = support.supported(
            support.AttackPlan.of(situation, plan),
            self._predictors.marginal,
            self._settings.form.candidates,
            attack.supporter,
        )
        attack.supporter = found.plan
        watch.lap("support")
        self.seconds += watch.seconds
        assert plan.reason is not None
        spent = plan.reason.milliseconds | watch.milliseconds
        reason = replace(plan.reason, support=found.support, milliseconds=spent)
        return replace(plan, reason=reason)

    def _not_given_up(self, view: View, scores: OpponentScores) -> list[AgentId]:
        """The road users to make a first plan for; all again after each was given up."""
        settings, away = self._settings, self._experience.given_up
        ranked = highest(scores, settings.opponent, len(scores.ids))
        left = [one for one in ranked if one not in away]
        return tried(view, left or ranked, settings.tried)

    def _new_attack(self, opponent_id: AgentId) -> _Attack:
        return _Attack(opponent_id=opponent_id, constraints=constraints.made(self._settings))

    def _most_promising(self, view: View, attacks: Sequence[_Attack]) -> _Attack:
        """The first attack with at least 95 % of the largest collision mass of all attacks."""
        watch = Stopwatch()
        av, mass = self._predict_av(view, watch), {}
        for attack in attacks:
            attack.last, attack.ready = self._plan(view, attack, av, watch), True
            mass[attack.opponent_id] = _most_mass(attack.last)
            watch = Stopwatch()
        enough = scoring.MASS_SHARE * max(mass.values())
        return next(attack for attack in attacks if mass[attack.opponent_id] >= enough)

    def _predict_av(self, view: View, watch: Stopwatch) -> _Av:
        """The AV's prediction, which does not depend on the opponent."""
        settings, conditional = self._settings, self._predictors.conditional
        prediction = conditional.predict(view, view.av_id, planner=self._planner)
        needed = settings.form.goal_candidates or self._constrained
        unattacked = prediction.given(None, settings.form.reactions)[0] if needed else None
        watch.lap("conditional")
        return _Av(prediction, unattacked)

    def _av_ahead(self, view: View) -> Forecast:
        """The AV's futures without an attack."""
        prediction = self._predictors.conditional.predict(view, view.av_id, planner=self._planner)
        return prediction.given(None, self._settings.form.reactions)[0]

    def _plan(self, view: View, attack: _Attack, av: _Av, watch: Stopwatch) -> Plan:
        """The opponent's plan: generate, predict, collide, constrain, choose."""
        limits = self._limits_of(view, attack.opponent_id)
        unattacked = av.unattacked and self._experience.aimed_at(
            view, attack.opponent_id, av.unattacked
        )
        situation = Situation.of(
            view,
            attack.opponent_id,
            limits,
            unattacked,
            attack.last,
            self._experience.last,
        )
        if attack.begun is None:
            attack.begun = view.step
        predicted = self._predict(situation, attack, av, watch)
        own, heat = predicted.own, predicted.heat
        reactions, counts = self._experience.informed(situation, own, predicted.reactions)
        pairs = candidates.pairs(
            situation,
            own,
            reactions,
            sectors="sector" in self._constrained,
            severity=self._settings.aggressiveness is not None,
        )
        pairs = pairs if counts is None else pairs.counting(counts)
        watch.lap("collision")
        choice, masks = self._choose(situation, attack, own, reactions, pairs, watch)
        watch.lap("select")
        self.seconds += watch.seconds
        reason = self._reason(own, heat, reactions, pairs, choice, masks, watch)
        return _planned(situation, own, choice, reason)

    def _limits_of(self, view: View, opponent_id: AgentId) -> MotionLimits:
        """Limits on the accelerations of an opponent; people also keep to their class's."""
        tracks, row = view.history, view.history.row(opponent_id)
        if tracks.kinds[row] == "vehicle":
            return self._limits
        motion = road_user(tracks.kinds[row], tracks.size_m[row]).motion
        return self._settings.limits_of(motion)

    def _predict(
        self, situation: Situation, attack: _Attack, av: _Av, watch: Stopwatch
    ) -> Predicted:
        """Candidates and reactions; those of an earlier try as long as it tells nothing new."""
        kept, moment = self._experience, (situation.view.step, situation.opponent_id)
        same = kept.several and attack.last is None and situation.unattacked is av.unattacked
        if same and moment in kept.predicted:
            return kept.predicted[moment]
        own, heat = self._generate(situation, attack, watch)
        found = Predicted(own, heat, self._reactions(av, own))
        watch.lap("conditional")
        if same:
            kept.predicted[moment] = found
        return found

    def _generate(
        self, situation: Situation, attack: _Attack, watch: Stopwatch
    ) -> tuple[Candidates, Heat | None]:
        """Drivable candidates of the opponent with their probabilities P(OV), and its heat map."""
        settings, limits, start = self._settings, situation.limits, situation.start
        predictor = self._predictors.people if situation.person else self._predictors.marginal
        prediction = predictor.predict(situation.view, situation.opponent_id)
        modes, heat = prediction.modes(settings.form.candidates), prediction.heat()
        count = len(modes.probability)
        parts = [References.of("mode", modes.futures.position_m, limits.rows(count))]
        watch.lap("marginal")
        paths = own_paths(modes, start) if situation.unattacked else []
        parts += goals(situation, paths, settings.form.goal_candidates)
        for constraint in attack.constraints:
            parts += constraint.references(situation, paths)
        if any(one.keeps_plan for one in attack.constraints):
            parts += candidates.tail(situation, FUTURE_STEPS)
        watch.lap("goals")
        references = References.joined(parts)
        if situation.person:
            references = staying_on_ground(situation, references)
        tracked = track(references.position_m, start, references.limits)
        watch.lap("track")
        probability = candidates.weights(modes, tracked.position_m[count:], prediction)
        watch.lap("marginal")
        if self._comfort > 0.0:
            probability = candidates.comfortable(situation, probability, tracked, self._comfort)
        own = candidates.ranked(references, tracked, probability, modes)
        if situation.person:
            own = on_ground(situation, own)
        if self._most is not None:
            own = candidates.shortlisted(
                situation, own, self._most, self._constrained, attack.begun
            )
        watch.lap("collision")
        return own, heat

    def _reactions(self, av: _Av, own: Candidates) -> list[Forecast]:
        """The AV's futures given each candidate; without condition the same ones for all."""
        if self._settings.form.conditional:
            return av.prediction.given(own.forecast.futures, self._settings.form.reactions)
        alone = av.unattacked or av.prediction.given(None, self._settings.form.reactions)[0]
        return [alone] * len(own.forecast.probability)

    def _choose(
        self,
        situation: Situation,
        attack: _Attack,
        own: Candidates,
        reactions: Sequence[Forecast],
        pairs: Pairs,
        watch: Stopwatch,
    ) -> tuple[Choice, list[Mask]]:
        """The choice under the constraints, and their masks."""
        masks = []
        for one in attack.constraints:
            allowed = one.allowed(situation, own, reactions, pairs)
            masks.append(Mask(one.name, one.scope, allowed))
            watch.lap(one.name)

        def confirmed(number: int, row: int) -> bool:
            one = attack.constraints[number]
            return one.confirmed(situation, own, reactions[row], pairs, row)

        return scoring.decide(pairs, masks, self._objective, confirmed)

    def _reason(
        self,
        own: Candidates,
        heat: Heat | None,
        reactions: list[Forecast],
        pairs: Pairs,
        choice: Choice,
        masks: Sequence[Mask],
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
            wanted_sector=self._sector,
            sector=pairs.sector,
            allowed={mask.name: mask.allowed for mask in masks},
            unmet=choice.unmet,
            heat=heat,
        )


def _planned(situation: Situation, own: Candidates, choice: Choice, reason: PlanReason) -> Plan:
    futures = own.forecast.futures
    return Plan(
        agent_id=futures.agent_id,
        first_step=situation.view.step + 1,
        position_m=futures.position_m[choice.index],
        heading_rad=futures.heading_rad[choice.index],
        speed_mps=own.speed_mps[choice.index],
        reason=reason,
    )


def _most_mass(plan: Plan) -> float:
    assert plan.reason is not None
    return float(plan.reason.wished_mass.max())


def build(
    settings: Settings,
    predictors: PredictorSet,
    partner_id: AgentId | None = None,
    av_driver: AvDriver = "planner",
    experience: Experience | None = None,
) -> DeepMF:
    """The policy.

    ``partner_id`` is the opponent of ``opponent: labelled``; ``experience``: of earlier tries.
    """
    return DeepMF(settings, predictors, partner_id, av_driver, experience)
