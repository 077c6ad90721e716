"""A plan for the opponent, and why it was chosen."""

from dataclasses import dataclass, field

import numpy as np

from deepmf_sumo.datatypes.arrays import Bools, Floats, Ints, frozen
from deepmf_sumo.datatypes.forecast import Forecast, OpponentScores
from deepmf_sumo.datatypes.scene import AgentId


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanReason:
    """What a plan was chosen from.

    Attributes:
        scores: of the surrounding vehicles, or None where the opponent was given.
        candidates: N1 futures of the opponent with P(OV), weighed by comfort if the policy does so.
        reactions: N1 forecasts of the AV, N2 modes each, given the candidate.
        collides: (N1, N2) boxes overlap at the same time.
        collision_step: (N1, N2) first step of overlap, counted from 0; F where there is none.
        value: (N1) the rule's value of each candidate.
        product: (N1) the paper's plain product P_j * sum_k P_jk * Coll_jk.
        chosen: index of the candidate.
        rule: the rule that chose it; ``<rule>, any sector`` where no pair hits the wanted one,
            ``nothing fair`` where none can be avoided, ``nothing lawful`` where all break a rule of
            the road, ``fallback`` where no pair collides.
        bent_m: (N1) farthest that the kinematic limits moved a candidate from its prediction.
        milliseconds: wall time by part.
        origin: (N1) where each candidate comes from: ``mode`` of the prediction, ``goal`` near the
            AV's predicted way, ``aim`` at the wanted side of it, ``stop`` as the law demands,
            ``tail`` of the last plan; empty where all are modes.
        wanted_sector: the AV's sector that was to be hit, 0..7; None: any.
        sector: (N1, N2) sector in which a pair first overlaps, -1 where it does not; None where
            none is wanted.
        fair: (N1) a competent driver could avoid the candidate; None where that was not asked.
        lawful: (N1) the candidate breaks no rule of the road; None where that was not asked.
        unmet: wishes that no candidate meets: ``sector``, ``fair``, ``lawful``.
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
    fair: Bools | None = None
    lawful: Bools | None = None
    unmet: tuple[str, ...] = ()

    @property
    def collision_mass(self) -> Floats:
        """(N1) probability that the AV's reaction to each candidate collides with it."""
        chance = np.stack([reaction.probability for reaction in self.reactions])
        mass: Floats = (chance * self.collides).sum(axis=1)
        return mass

    @property
    def wished_mass(self) -> Floats:
        """(N1) the same; 0 for candidates that are not fair or not lawful where they had to be."""
        mass = self.collision_mass
        for wish in (self.fair, self.lawful):
            mass = mass if wish is None else mass * wish
        return mass


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """K poses for the opponent, for the steps first_step, first_step + 1, ...

    Attributes:
        position_m: (K, 2) box centre. heading_rad, speed_mps: (K).
    """

    agent_id: AgentId
    first_step: int
    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    reason: PlanReason | None = None

    def __post_init__(self) -> None:
        for name in ("position_m", "heading_rad", "speed_mps"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def covers(self, step: int) -> bool:
        """Whether the plan says where the opponent is at ``step``."""
        return self.first_step <= step < self.first_step + len(self.position_m)
