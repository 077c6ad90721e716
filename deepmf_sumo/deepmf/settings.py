"""How DeepMF attacks: the keys of ``adversary: {name: deepmf, ...}``."""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import DT_S, AvDriver
from deepmf_sumo.deepmf.opponent import SCORED
from deepmf_sumo.deepmf.scoring import Balance, Rule
from deepmf_sumo.deepmf.tracking import Limits
from deepmf_sumo.geometry.impact import SECTORS
from deepmf_sumo.predictors.base import MOST_MODES
from deepmf_sumo.spec import VERSIONS

SectorName = Literal[
    "front", "front_left", "left", "rear_left", "rear", "rear_right", "right", "front_right"
]
LIMITS: Final = Limits(accel=3.5, brake=5.0, lateral=3.5)
"""Of what an opponent drives, where the settings say nothing: the same for all aimed methods."""
_RANKED = frozenset({"argmax", "partner"})
"""Opponents that a score puts in an order."""
_TRIED = 3
_COMFORT = 1.0


class Settings(plugins.Settings):
    """How DeepMF attacks.

    The paper's own form is ``tried_opponents: 1, goal_candidates: 0, reactions: 6``; by default it
    is given more to choose from, at the same cost.

    Attributes:
        version: the paper's name of a period: G (one plan), S4, S2, S1.
        period_s: seconds between plans, a multiple of 0.1; null plans once (G).
        opponent: ``argmax`` or ``sample`` (softmax) of the scores; ``partner``: argmax of the head
            trained on labelled partners; ``labelled``: the partner that the recording names; else
            the id of a vehicle.
        tried_opponents: a first plan is made for so many vehicles with the highest scores; of those
            that have a candidate with at least 95 % of the largest collision mass the highest score
            attacks, for a vehicle that interacts need not be one that can reach the AV. 1 as
            published. More go with ``argmax`` and ``partner`` alone; null is 3 with these, else 1.
        rule: see `deepmf.scoring`.
        likelihood_weight: exponent on P(OV) in the rules ``expected`` and ``pair``; 1 as published.
        comfort_weight: P(OV) falls with the mean square acceleration, see
            `deepmf.candidates`, s4/m2. Null: 1 where the likeliest of what serves is wanted
            (``likeliest``, ``aggressiveness``), 0, as published, in the paper's product.
        candidates: modes of the opponent (N1).
        goal_candidates: at most so many ways to goals around the AV's predicted positions besides
            (0 as published).
        shortlist: the AV's reactions are predicted to at most so many candidates: those most likely
            to meet its futures if nobody attacks, then the likeliest. Null: to all, as with
            ``sector``, ``fair`` and ``lawful``, which may leave few.
        reactions: modes of the AV (N2); 6 as published.
        av_driver: whose reactions are predicted: an automated ``planner``'s, or a ``human``'s;
            null takes what the AV's planner is (``human`` for ``replay``).
        conditional: False predicts the AV as if it knew nothing of the opponent's future, by the
            same network: P(Y_AV | X) in place of P(Y_AV | Y_OV, X), to see what that is worth.
        accel_mps2, brake_mps2, lateral_mps2: limits of what the opponent drives.
        keep_tail: the rest of the last plan is a candidate too.
        sector: the side of the AV to hit: 0 (front) to 7, counter-clockwise in steps of 45 degrees,
            or a name of `geometry.impact.SECTORS`. Only pairs that first touch there count;
            ways are made that lead there. Null: any side.
        aggressiveness: from 0 (the likeliest future, whatever comes of it) to 1 (the most
            dangerous), in place of ``rule`` and ``likelihood_weight``: see
            `deepmf.scoring.Balance`. 0.5 is the rule ``likeliest``; the limits are
            multiplied by 2^(aggressiveness - 0.5). Null: the rule decides.
        fair: only candidates that a competent driver in the AV's place could avoid
            (`avoidability.grading`), when they are chosen first; without one nobody is attacked.
        lawful: only candidates that break no rule of the road (`deepmf.traffic_rules`); without
            one that meets the AV nobody is attacked.
    """

    version: Literal["G", "S4", "S2", "S1"] | None = None
    period_s: float | None = Field(default=1.0, ge=DT_S)
    opponent: str = Field(default="argmax", min_length=1)
    tried_opponents: int | None = Field(default=None, ge=1, le=16)
    rule: Rule = "expected"
    likelihood_weight: float = Field(default=1.0, ge=0.0)
    comfort_weight: float | None = Field(default=None, ge=0.0)
    candidates: int = Field(default=32, ge=1, le=MOST_MODES)
    goal_candidates: int = Field(default=64, ge=0, le=256)
    shortlist: int | None = Field(default=32, ge=1, le=256)
    reactions: int = Field(default=16, ge=1, le=64)
    av_driver: AvDriver | None = None
    conditional: bool = True
    accel_mps2: float = Field(default=LIMITS.accel, gt=0.0)
    brake_mps2: float = Field(default=LIMITS.brake, gt=0.0)
    lateral_mps2: float = Field(default=LIMITS.lateral, gt=0.0)
    keep_tail: bool = False
    sector: SectorName | Annotated[int, Field(ge=0, le=7)] | None = None
    aggressiveness: float | None = Field(default=None, ge=0.0, le=1.0)
    fair: bool = False
    lawful: bool = False

    @property
    def takes_turns(self) -> bool:
        """Whether one opponent can follow another in an episode: scores choose, no name does."""
        return self.opponent in SCORED

    @model_validator(mode="after")
    def _one_period(self) -> Self:
        both = self.version is not None and "period_s" in self.model_fields_set
        if both and self.period_s != VERSIONS[str(self.version)]:
            raise ValueError(f"version {self.version} and period_s {self.period_s} disagree")
        if self.period_s is not None and abs(self.period_s / DT_S % 1 - 0.5) < 0.499:
            raise ValueError(f"period_s {self.period_s} is no multiple of {DT_S} s")
        return self

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        other = {"rule", "likelihood_weight"} & self.model_fields_set
        if self.aggressiveness is not None and other:
            raise ValueError(f"aggressiveness takes the place of {min(other)}; give one of them")
        return self

    @model_validator(mode="after")
    def _several_by_score(self) -> Self:
        if (self.tried_opponents or 1) > 1 and self.opponent not in _RANKED:
            raise ValueError(
                f"tried_opponents {self.tried_opponents} goes with opponent argmax or partner, "
                f"not with {self.opponent!r}"
            )
        return self

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None plans once."""
        period = self.period_s if self.version is None else VERSIONS[self.version]
        return None if period is None else round(period / DT_S)

    @property
    def tried(self) -> int:
        """Opponents that a first plan is made for."""
        return self.tried_opponents or (_TRIED if self.opponent in _RANKED else 1)

    @property
    def most_candidates(self) -> int | None:
        """Of which the AV's reactions are predicted; None for all."""
        steered = self.wanted_sector is not None or self.fair or self.lawful
        return None if steered else self.shortlist

    @property
    def comfort(self) -> float:
        """The weight of comfort in P(OV), s4/m2."""
        if self.comfort_weight is not None:
            return self.comfort_weight
        served = self.aggressiveness is not None or self.rule == "likeliest"
        return _COMFORT if served else 0.0

    @property
    def limits(self) -> Limits:
        """Limits of what the opponent drives."""
        more = 1.0 if self.aggressiveness is None else 2.0 ** (self.aggressiveness - 0.5)
        return Limits(
            accel=more * self.accel_mps2,
            brake=more * self.brake_mps2,
            lateral=more * self.lateral_mps2,
        )

    @property
    def choice_rule(self) -> Rule | Balance:
        """What chooses among the candidates."""
        return self.rule if self.aggressiveness is None else Balance.at(self.aggressiveness)

    @property
    def wanted_sector(self) -> int | None:
        """0..7; None where any will do."""
        return SECTORS.index(self.sector) if isinstance(self.sector, str) else self.sector
