"""How DeepMF attacks: the keys of ``adversary: {name: deepmf, ...}``."""

from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    BeforeValidator,
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
from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.geometry.impact import SECTORS
from deepmf_sumo.scene.road_users import MotionLimits, MotionModel
from deepmf_sumo.spec.model import Strict
from deepmf_sumo.spec.profiles import FormName, with_preset

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
}
"""Of the form as published; other values contradict it."""
_PAPER_REACTIONS: Final = 6
_PAPER_RULES: Final = ("expected", "pair")
_NOT_PUBLISHED: Final = (
    "attackers", "sector", "aggressiveness", "constraints", "goal", "tries", "supporting",
)  # fmt: skip
"""Settings of which the method as published has the default."""


def _contradicts(key: str, value: Any, instead: str) -> ValueError:
    return ValueError(
        f"form 'paper' contradicts {key}: {value!r}; leave {key} out (it is {instead}), or use"
        " form 'extended'"
    )


class Form(Strict):
    """The method's own numbers, which studies vary; ``form: paper`` is short for its preset.

    Attributes:
        preset: ``paper`` is the method as published: one opponent, only the predictor's modes,
            reactions to all of them, Eq. 5 (or the text's pair), no comfort and no constraint; what
            contradicts that is refused. An opponent may be named, or ``labelled``. Else only
            vehicles are chosen: the published network scores no people.
            ``extended`` adds all that the other settings say.
        tried_opponents: number of top-scored vehicles to make a first plan for. The highest-scored
            one whose best candidate has at least 95 % of the largest collision mass attacks: a
            vehicle that interacts with the AV need not be able to reach it. 1 as published; more
            only with ``argmax`` and ``partner``. Null: 3 with these, else 1.
        likelihood_weight: exponent on P(OV) in the rules ``expected`` and ``pair``; 1 as published.
        comfort_weight: P(OV) falls with the mean square acceleration (s4/m2) and with the time off
            the road (`deepmf.candidates`). Null: 1 for the choices of the likeliest
            (``likeliest``, ``aggressiveness``), 0, as published, in the paper's product.
        candidates: modes of the opponent (N1).
        goal_candidates: maximum number of further candidates that end near the AV's predicted
            positions (0 as published).
        shortlist: maximum number of candidates to which the AV's reactions are predicted: those
            most likely to meet the unattacked AV, then the likeliest. Null: all, as always with
            constraints, which may leave few, apart from ``no_rear_end``, ``on_road`` and
            ``with_traffic``.
        reactions: modes of the AV (N2). The paper gives neither N1 nor N2; 16, and with ``paper``
            6, the number of M2I, which also predicts one vehicle given another.
        conditional: False predicts the AV as if it knew nothing of the opponent's future, with the
            same network: P(Y_AV | X) in place of P(Y_AV | Y_OV, X), to measure its effect.
    """

    preset: FormName = "extended"
    tried_opponents: int | None = Field(default=None, ge=1, le=16)
    likelihood_weight: float = Field(default=1.0, ge=0.0)
    comfort_weight: float | None = Field(default=None, ge=0.0)
    candidates: int = Field(default=32, ge=1, le=MOST_MODES)
    goal_candidates: int = Field(default=64, ge=0, le=256)
    shortlist: int | None = Field(default=32, ge=1, le=256)
    reactions: int = Field(default=16, ge=1, le=64)
    conditional: bool = True

    @model_validator(mode="before")
    @classmethod
    def _of_the_preset(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("preset") == "paper":
            return _PAPER | {"reactions": _PAPER_REACTIONS} | values
        return values

    @model_validator(mode="after")
    def _as_published(self) -> Self:
        for key, published in _PAPER.items():
            if self.preset == "paper" and getattr(self, key) != published:
                raise _contradicts(key, getattr(self, key), str(published))
        return self


class Settings(plugins.Settings):
    """Settings of DeepMF.

    Attributes:
        form: ``paper``, the method as published, ``extended``, or a map of what studies vary, see
            `Form`.
        period_s: seconds between plans, a multiple of 0.1; null plans once. In specs ``version``
            is short for it, as the paper calls them: G (one plan), S4, S2, S1. A spec that states
            it means one try (`spec.profiles`).
        opponent: ``argmax`` or ``sample`` (softmax) of the scores; ``partner``: argmax of the head
            trained on labelled partners; ``labelled``: the partner that the recording names; else
            the id of a vehicle, pedestrian or cyclist.
        attackers: who is chosen from: ``vehicles``, ``people`` (pedestrians and cyclists) or
            ``all`` (`deepmf.opponent`). Of ``all``, the highest-scored vehicle and the
            highest-scored person are among those that are tried (from 2 on).
        rule: how a candidate is chosen (`deepmf.scoring`). A spec of version 2 or 3 without it has
            ``likeliest`` in the form ``extended``; in Python the default is ``expected``.
        accel_mps2, brake_mps2, lateral_mps2: limits on the opponent's accelerations. Pedestrians
            and cyclists also keep to those of their class (`scene.road_users`).
        sector: the side of the AV to hit, in steps of 45 degrees (`scene.geometry.impact.SECTORS`).
            Only pairs that first touch there count; candidates that do so are added. Null: any
            side.
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
            avoidable, and not contrived (`judge.ladder`).
        tries: maximum number of episodes; each knows what the AV did in those before, see
            `deepmf.experience`. The first that reaches the goal is the attack, without one the
            best: a hit before a miss, then the nearest. Offline only.
        supporting: 1: beside the attacker another vehicle, within its own prediction, takes the
            AV's ways out without touching anybody, see `deepmf.support`. Offline only.
    """

    form: Annotated[
        Form, BeforeValidator(with_preset, json_schema_input_type=FormName | Form)
    ] = Form()  # fmt: skip
    period_s: float | None = Field(default=1.0, ge=DT_S)
    opponent: str = Field(default="argmax", min_length=1)
    attackers: Attackers = "vehicles"
    rule: Rule = "expected"
    accel_mps2: float = Field(default=LIMITS.accel, gt=0.0)
    brake_mps2: float = Field(default=LIMITS.brake, gt=0.0)
    lateral_mps2: float = Field(default=LIMITS.lateral, gt=0.0)
    sector: SectorName | None = None
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

    @model_validator(mode="after")
    def _as_published(self) -> Self:
        if self.form.preset != "paper":
            return self
        if self.opponent == "partner":
            raise ValueError(
                "form 'paper' contradicts opponent: 'partner', a head of its own; use argmax or"
                " sample, or form 'extended'"
            )
        if self.rule not in _PAPER_RULES:
            raise _contradicts("rule", self.rule, " or ".join(_PAPER_RULES))
        for key in _NOT_PUBLISHED:
            published = type(self).model_fields[key].default
            if getattr(self, key) != published:
                raise _contradicts(key, getattr(self, key), str(published))
        return self

    @model_validator(mode="after")
    def _whole_steps(self) -> Self:
        if self.period_s is not None and abs(self.period_s / DT_S % 1 - 0.5) < 0.499:
            raise ValueError(f"period_s {self.period_s} is not a multiple of {DT_S} s")
        return self

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        weighted = "likelihood_weight" in self.form.model_fields_set
        other = ["form.likelihood_weight"] * weighted + ["rule"] * ("rule" in self.model_fields_set)
        if self.aggressiveness is not None and other:
            raise ValueError(f"aggressiveness takes the place of {other[0]}; give one of them")
        return self

    @model_validator(mode="after")
    def _several_by_score(self) -> Self:
        tried = self.form.tried_opponents or 1
        if tried > 1 and self.opponent not in _RANKED:
            raise ValueError(
                f"form.tried_opponents {tried} goes with opponent argmax or partner, "
                f"not with {self.opponent!r}"
            )
        return self

    @model_validator(mode="after")
    def _not_both_ways(self) -> Self:
        if "no_rear_end" in self.constraints and self.sector == "rear":
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
        return tuple(sorted({*names}))

    @model_serializer(mode="wrap")
    def _without_empty(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Results contain these keys only with values that are not the defaults."""
        values: dict[str, Any] = handler(self)
        for key in ("goal", "tries", "supporting", "attackers"):
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
        return None if self.period_s is None else round(self.period_s / DT_S)

    @property
    def tried(self) -> int:
        """Number of opponents to make a first plan for."""
        return self.form.tried_opponents or (_TRIED if self.opponent in _RANKED else 1)

    @property
    def most_candidates(self) -> int | None:
        """Maximum number of candidates to which the AV's reactions are predicted; None: all."""
        return None if self.constrained - _SHORTLISTED else self.form.shortlist

    @property
    def comfort(self) -> float:
        """The weight of comfort in P(OV), s4/m2."""
        if self.form.comfort_weight is not None:
            return self.form.comfort_weight
        served = self.aggressiveness is not None or self.rule == "likeliest"
        return _COMFORT if served else 0.0

    @property
    def limits(self) -> MotionLimits:
        """Limits on the accelerations of a vehicle that attacks."""
        return MotionLimits(
            accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2
        ).times(self._more)

    def limits_of(self, motion: MotionModel) -> MotionLimits:
        """Limits on the accelerations of a person that attacks: also those of its class."""
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
        return None if self.sector is None else SECTORS.index(self.sector)
