"""Predicted motion, the opponent's plan and why it was chosen, and when opponents take turns."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from deepmf_sumo.scene._arrays import Bools, Floats, Frozen, Ints
from deepmf_sumo.scene.scene import AgentId


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Futures(Frozen):
    """M possible futures of one agent, from the step after the view's.

    Attributes:
        position_m: (M, F, 2) box centre. heading_rad: (M, F).
    """

    agent_id: AgentId
    position_m: Floats
    heading_rad: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast(Frozen):
    """M weighted futures of one agent.

    Attributes:
        futures: shapes (M, F, ...).
        probability: (M) sums to 1, most likely first.
        temperature: the one applied to the scores before the softmax.
    """

    futures: Futures
    probability: Floats
    temperature: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heat(Frozen):
    """Where an agent may be 8 s later: the likeliest dense goals of a forecast.

    Attributes:
        position_m: (N, 2). probability: (N), likeliest first.
    """

    position_m: Floats
    probability: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpponentScores(Frozen):
    """Suitability of each surrounding road user as an opponent.

    Attributes:
        ids: (A) candidates: vehicles in range, not the AV, not parked; people, if they may attack.
        logits: (A) before the sigmoid.
        partner_logits: (A) of the head trained on labelled partners.
    """

    ids: tuple[AgentId, ...]
    logits: Floats
    partner_logits: Floats


Way = Literal["brake", "left", "right"]
"""A way out of an attack: the AV brakes, or swerves to a side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Support:
    """Another road user that helps a plan by taking the AV's ways out, or why there is none.

    Attributes:
        agent_id: the supporter; None without one.
        ways: share of each way out that it takes, of those that are open without it.
        probability: of its motion, among the candidates of its own prediction.
        note: why there is none, or what kept it from taking more; empty if nothing did.
    """

    agent_id: AgentId | None = None
    ways: dict[Way, float] = field(default_factory=dict)
    probability: float = 0.0
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanReason(Frozen):
    """Diagnostics of a plan: what it was chosen from, and why.

    Attributes:
        scores: of the surrounding vehicles, or None if the opponent was given.
        candidates: N1 futures of the opponent with P(OV), weighted by comfort if the policy does.
        reactions: N1 forecasts of the AV, N2 modes each, given the candidate.
        collides: (N1, N2) boxes overlap at the same time.
        collision_step: (N1, N2) first step of overlap, counted from 0; F if there is none.
        value: (N1) the rule's value of each candidate.
        product: (N1) the paper's plain product P_j * sum_k P_jk * Coll_jk.
        chosen: index of the candidate.
        rule: the rule that chose it; ``<rule>, any sector`` if no pair hits the wanted one,
            ``nothing fair`` if none can be avoided, ``nothing lawful`` if all break a traffic rule,
            ``fallback`` if no pair collides.
        bent_m: (N1) farthest that the kinematic limits moved a candidate from its prediction.
        milliseconds: wall time by part.
        origin: (N1) source of each candidate: ``mode`` of the prediction, ``goal`` near the AV's
            predicted path, ``aim`` at the wanted side of it, ``stop`` as the law demands, ``tail``
            of the last plan; of people also ``wait``, ``halt``, ``return``
            (`deepmf.off_lane_paths`); empty if all are modes.
        wanted_sector: the AV's sector to hit, 0..7; None: any.
        sector: (N1, N2) sector in which a pair first overlaps, -1 if it does not; None if
            none is wanted.
        allowed: by name of the constraint what it allows: (N1) candidates if an attack requires it
            (``fair``, ``lawful``), (N1, N2) pairs if it is a preference (``sector``).
        unmet: names of the constraints that no candidate meets.
        heat: where the opponent may be; None unless its predictor has dense goals.
        support: of the plan by another road user; None if none was asked for.
    """

    scores: OpponentScores | None
    candidates: Forecast
    reactions: tuple[Forecast, ...]
    collides: Bools
    collision_step: Floats
    value: Floats
    product: Floats
    chosen: int
    rule: str
    bent_m: Floats
    milliseconds: dict[str, float] = field(default_factory=dict)
    origin: tuple[str, ...] = ()
    wanted_sector: int | None = None
    sector: Ints | None = None
    allowed: dict[str, Bools] = field(default_factory=dict)
    unmet: tuple[str, ...] = ()
    heat: Heat | None = None
    support: Support | None = None

    @property
    def fair(self) -> Bools | None:
        """(N1) a competent driver could avoid the candidate; None if this was not computed."""
        return self.allowed.get("fair")

    @property
    def lawful(self) -> Bools | None:
        """(N1) the candidate breaks no traffic rule; None if this was not computed."""
        return self.allowed.get("lawful")

    @property
    def collision_mass(self) -> Floats:
        """(N1) probability that the AV's reaction to each candidate collides with it."""
        chance = np.stack([reaction.probability for reaction in self.reactions])
        return (chance * self.collides).sum(axis=1)

    @property
    def wished_mass(self) -> Floats:
        """(N1) the same; 0 for candidates that violate a required constraint."""
        mass = self.collision_mass
        for allowed in self.allowed.values():
            mass = mass * allowed if allowed.ndim == 1 else mass
        return mass


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan(Frozen):
    """K poses for an attacker or a supporter, for the steps first_step, first_step + 1, ...

    Attributes:
        position_m: (K, 2) box centre. heading_rad, speed_mps: (K).
        supports: the attacker that it helps by its motion, while it touches nobody itself; None of
            an attacker.
    """

    agent_id: AgentId
    first_step: int
    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    reason: PlanReason | None = None
    supports: AgentId | None = None

    def covers(self, step: int) -> bool:
        """Whether the plan has a pose for ``step``."""
        return self.first_step <= step < self.first_step + len(self.position_m)


TurnEnd = Literal[
    "contact",
    "other_hit",
    "out_of_reach",
    "gone",
    "too_long",
    "plan_ended",
    "harmless",
    "time",
    "av_gone",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnRules:
    """When an attack ends, and which vehicle can attack next.

    Attributes:
        longest_s: maximum duration of one attack.
        reach_m: maximum distance of the opponent from the AV, between centres.
        harmless_s: maximum time without a plan that collides with a predicted future of the AV.
        again_after_s: time before a vehicle attacks again, unless no other vehicle can.
        clear_s: time after an attack for the AV to separate from all other vehicles.
    """

    longest_s: float = 15.0
    reach_m: float = 80.0
    harmless_s: float = 4.0
    again_after_s: float = 30.0
    clear_s: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """The attack of one vehicle of several in an episode, which attack together or in turn.

    Attributes:
        first_step: at which the opponent was chosen; the policy drives it from the next step on.
            Those that attack together have the same.
        last_step: the last of the turn; from the next step on SUMO drives or, off the lanes, no
            driver yet.
        ended: ``contact`` with the AV; ``other_hit``: of a vehicle that attacked together with
            it; ``out_of_reach``; ``gone`` (left the simulation);
            ``too_long``; ``plan_ended`` (by a policy that does not replan); ``harmless``;
            ``time`` and ``av_gone``: the episode's end.
        gap_m: least distance of the boxes of AV and opponent in the turn.
    """

    opponent_id: AgentId
    first_step: int
    last_step: int
    ended: TurnEnd
    gap_m: float
