"""How DeepMF attacks: the keys of ``adversary: {name: deepmf, ...}``."""

from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.networks.predict import MOST_MODES
from deepmf_sumo.deepmf.opponent import SCORED, Attackers
from deepmf_sumo.deepmf.scoring import Balance, Rule
from deepmf_sumo.errors import nearest
from deepmf_sumo.scene import DT_S, AgentKind, AvDriver
from deepmf_sumo.scene.geometry.impact import SECTORS
from deepmf_sumo.scene.road_users import MotionLimits, MotionModel
from deepmf_sumo.spec import VERSIONS
from deepmf_sumo.spec.profiles import SWITCHES, with_listed

SectorName = Literal[
    "front", "front_left", "left", "rear_left", "rear", "rear_right", "right", "front_right"
]
Goal = Literal["hit", "finding"]
LIMITS: Final = MotionLimits(accel=3.5, brake=5.0, lateral=3.5)
"""Default limits on an opponent's accelerations, which all aimed methods share."""
_RANKED = frozenset({"argmax", "partner"})
"""Values of ``opponent`` that rank vehicles by a score."""
_SHORTLISTED = frozenset({"no_rear_end", "on_road", "with_traffic"})
"""Constraints that a shortlist knows of."""
_TRIED = 3
_COMFORT = 1.0
_PAPER: Final[dict[str, Any]] = {
    "tried_opponents": 1,
    "likelihood_weight": 1.0,
    "comfort_weight": 0.0,
    "goal_candidates": 0,
    "shortlist": None,
    "conditional": True,
    "keep_tail": False,
    "attackers": "vehicles",
    "sector": None,
    "aggressiveness": None,
    "constraints": (),
    "goal": "hit",
    "tries": 1,
    "supporting": 0,
}
"""Values of ``form: paper``: keys with other values contradict it."""
_PAPER_RULES: Final = ("expected", "pair")
_PAPER_REACTIONS = 6


class Settings(plugins.Settings):
    """Settings of DeepMF.

    Attributes:
        form: ``paper`` is the method as published: one opponent, only the predictor's modes,
            reactions to all of them, Eq. 5 (or the text's pair), no comfort and no constraint; keys
            that contradict it are refused. An opponent may be named (also ``labelled``); of those
            that are chosen only vehicles: the published network scores no people.
            ``extended`` adds the extensions of the keys below.
        version: the paper's name of a period: G (one plan), S4, S2, S1.
        period_s: seconds between plans, a multiple of 0.1; null plans once (G).
        opponent: ``argmax`` or ``sample`` (softmax) of the scores; ``partner``: argmax of the head
            trained on labelled partners; ``labelled``: the partner that the recording names; else
            the id of a vehicle, pedestrian or cyclist.
        attackers: who is chosen from: ``vehicles``, ``people`` (pedestrians and cyclists) or
            ``all``; see `deepmf.opponent` for the scores of people. Of ``all``, the highest-scored
            vehicle and the highest-scored person are among the ``tried_opponents`` (from 2 on).
        tried_opponents: number of top-scored vehicles to make a first plan for. The highest-scored
            one whose best candidate has at least 95 % of the largest collision mass attacks: a
            vehicle that interacts with the AV need not be able to reach it. 1 as published; more
            only with ``argmax`` and ``partner``. Null: 3 with these, else 1.
        rule: see `deepmf.scoring`. Specs of versions 2 and 3 that say nothing have ``likeliest`` in
            the form ``extended``; these settings know of no versions.
        likelihood_weight: exponent on P(OV) in the rules ``expected`` and ``pair``; 1 as published.
        comfort_weight: P(OV) falls with the mean square acceleration and with the time off the
            road, see `deepmf.candidates`, s4/m2. Null: 1 for the choices of the likeliest
            (``likeliest``, ``aggressiveness``), 0, as published, in the paper's product.
        candidates: modes of the opponent (N1).
        goal_candidates: maximum number of further candidates that end near the AV's predicted
            positions (0 as published).
        shortlist: maximum number of candidates to which the AV's reactions are predicted: those
            most likely to meet the unattacked AV, then the likeliest. Null: all, as always with
            constraints, which may leave few, apart from ``no_rear_end``, ``on_road`` and
            ``with_traffic``.
        reactions: modes of the AV (N2). The paper gives neither N1 nor N2; 16, and with
            ``form: paper`` 6, the number of M2I, which also predicts one vehicle given another.
        av_driver: whose reactions are predicted: an automated ``planner``'s, or a ``human``'s;
            null follows the AV's planner (``human`` for ``replay``).
        conditional: False predicts the AV as if it knew nothing of the opponent's future, with the
            same network: P(Y_AV | X) in place of P(Y_AV | Y_OV, X), to measure its effect.
        accel_mps2, brake_mps2, lateral_mps2: limits on the opponent's accelerations. Pedestrians
            and cyclists also keep to those of their class (`scene.road_users`).
        keep_tail: the rest of the last plan is a candidate too.
        sector: the side of the AV to hit: 0 (front) to 7, counter-clockwise in steps of 45 degrees,
            or a name of `scene.geometry.impact.SECTORS`. Only pairs that first touch there count;
            candidates that do so are added. Null: any side.
        aggressiveness: from 0 (the likeliest future, even if it misses) to 1 (the most
            dangerous), in place of ``rule`` and ``likelihood_weight``: see
            `deepmf.scoring.Balance`. 0.5 is the rule ``likeliest``; the limits are
            multiplied by 2^(aggressiveness - 0.5). Null: the rule decides.
        constraints: names, see `deepmf.constraints`, of what every candidate must fulfil; if none
            that meets the AV does, there is no attack. ``fair``: a competent driver in the AV's
            place could avoid it (`avoidability.grading`) at the time of the choice; ``lawful``: it
            breaks no traffic rule (`deepmf.traffic_rules`); ``no_rear_end``: it does not drive into
            the AV's rear end from behind; ``on_road``, ``with_traffic``, ``clean``. By default
            those of the spec's profile.
        goal: what ends the tries: a ``hit``, or a ``finding``: a hit that is the AV's error or
            avoidable, and not contrived (`judge.ladder`). ``avoidable`` of earlier specs is a
            finding, with the constraints ``fair`` and ``clean``.
        tries: maximum number of episodes; each knows what the AV did in those before, see
            `deepmf.experience`. The first that reaches the goal is the attack, without one the
            best: a hit before a miss, then the nearest. Offline only.
        supporting: 1: beside the attacker another vehicle, within its own prediction, takes the
            AV's ways out without touching anybody, see `deepmf.support`. Offline only.
    """

    form: Literal["paper", "extended"] = "extended"
    version: Literal["G", "S4", "S2", "S1"] | None = None
    period_s: float | None = Field(default=1.0, ge=DT_S)
    opponent: str = Field(default="argmax", min_length=1)
    attackers: Attackers = "vehicles"
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
    constraints: tuple[str, ...] = Field(default=(), strict=False)
    goal: Goal = "hit"
    tries: int = Field(default=1, ge=1, le=1000)
    supporting: int = Field(default=0, ge=0, le=1)

    @property
    def takes_turns(self) -> bool:
        """Whether opponents can attack in turn in an episode: chosen by score, in one try."""
        return self.opponent in SCORED and self.tries == 1

    @property
    def names_opponent(self) -> bool:
        """Whether ``opponent`` is an id: a person may be named, whoever is chosen from."""
        return self.opponent not in SCORED and self.opponent != "labelled"

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_the_form(cls, values: Any) -> Any:
        if isinstance(values, dict):
            values = with_listed(values)
            for switch in SWITCHES:
                if switch in values:
                    raise ValueError(f"{switch} is {values[switch]!r}; it must be true or false")
        if isinstance(values, dict) and values.get("form") == "paper":
            return _PAPER | {"reactions": _PAPER_REACTIONS} | values
        return values

    @model_validator(mode="after")
    def _as_published(self) -> Self:
        if self.form != "paper":
            return self
        if self.opponent == "partner":
            raise ValueError(
                "form 'paper' contradicts opponent: 'partner', a head of its own; use argmax or"
                " sample, or form 'extended'"
            )
        allowed = {key: (value,) for key, value in _PAPER.items()} | {"rule": _PAPER_RULES}
        for key, those in allowed.items():
            if getattr(self, key) not in those:
                raise ValueError(
                    f"form 'paper' contradicts {key}: {getattr(self, key)!r}; leave {key} out "
                    f"(it is {' or '.join(map(str, those))}), or use form 'extended'"
                )
        return self

    @model_validator(mode="after")
    def _one_period(self) -> Self:
        both = self.version is not None and "period_s" in self.model_fields_set
        if both and self.period_s != VERSIONS[str(self.version)]:
            raise ValueError(f"version {self.version} and period_s {self.period_s} disagree")
        if self.period_s is not None and abs(self.period_s / DT_S % 1 - 0.5) < 0.499:
            raise ValueError(f"period_s {self.period_s} is not a multiple of {DT_S} s")
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

    @model_validator(mode="after")
    def _not_both_ways(self) -> Self:
        if "no_rear_end" in self.constraints and self.wanted_sector == SECTORS.index("rear"):
            raise ValueError("sector 'rear' and no_rear_end contradict each other; leave one out")
        return self

    @field_validator("constraints")
    @classmethod
    def _known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        # Constraints are made from settings, so these cannot import them before.
        from deepmf_sumo.deepmf.constraints import CONSTRAINTS

        known = [one.name for one in CONSTRAINTS if one.name != "sector"]
        for name in names:
            if name not in known:
                raise ValueError(
                    f"there is no constraint '{name}'.{nearest(name, known)}"
                    f" Known: {', '.join(known)}"
                )
        return names

    @model_serializer(mode="wrap")
    def _without_empty(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Results contain these keys only with values that are not the defaults."""
        values: dict[str, Any] = handler(self)
        for key in ("form", "goal", "tries", "supporting", "attackers"):
            if getattr(self, key) == type(self).model_fields[key].default:
                del values[key]
        return values

    @property
    def constrained(self) -> frozenset[str]:
        """Names of the constraints on the choice."""
        sector = () if self.sector is None else ("sector",)
        return frozenset({*sector, *self.constraints})

    @property
    def period_steps(self) -> int | None:
        """Steps between plans; None: one plan."""
        period = self.period_s if self.version is None else VERSIONS[self.version]
        return None if period is None else round(period / DT_S)

    @property
    def tried(self) -> int:
        """Number of opponents to make a first plan for."""
        return self.tried_opponents or (_TRIED if self.opponent in _RANKED else 1)

    @property
    def most_candidates(self) -> int | None:
        """Maximum number of candidates to which the AV's reactions are predicted; None: all."""
        return None if self.constrained - _SHORTLISTED else self.shortlist

    @property
    def comfort(self) -> float:
        """The weight of comfort in P(OV), s4/m2."""
        if self.comfort_weight is not None:
            return self.comfort_weight
        served = self.aggressiveness is not None or self.rule == "likeliest"
        return _COMFORT if served else 0.0

    @property
    def limits(self) -> MotionLimits:
        """Limits on the accelerations of a vehicle that attacks."""
        return MotionLimits(
            accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2
        ).times(self._more)

    def limits_of(self, kind: AgentKind, motion: MotionModel) -> MotionLimits:
        """Limits on the accelerations of an opponent; people also keep to their class's."""
        if kind == "vehicle":
            return self.limits
        return self.limits.within(motion.planned.times(self._more).within(motion.possible))

    @property
    def _more(self) -> float:
        return 1.0 if self.aggressiveness is None else 2.0 ** (self.aggressiveness - 0.5)

    @property
    def choice_rule(self) -> Rule | Balance:
        """The rule by which a candidate is chosen."""
        return self.rule if self.aggressiveness is None else Balance.at(self.aggressiveness)

    @property
    def wanted_sector(self) -> int | None:
        """0..7; None for any."""
        return SECTORS.index(self.sector) if isinstance(self.sector, str) else self.sector
