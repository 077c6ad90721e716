"""What a gate measures of each run: numbers, each with the direction that is worse for the AV."""

from dataclasses import dataclass
from typing import Final, Literal

from deepmf_sumo.benchmark.result import Result, attacked
from deepmf_sumo.benchmark.study.columns import BY_NAME, Value, counted, metric

TTC_CEILING_S: Final = 10.0
"""What an attacked run counts with whose AV and opponent were never on a collision course."""

_NEGLIGIBLE: Final = 0.05
"""s, m and m/s: rounding on another machine moves all runs a little, and all in one direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A number a run.

    Attributes:
        worse: the direction that is bad for the AV.
        value: of a run that went through; None where it is not defined.
        rate: of zeros and ones. hits_only: defined for hits alone.
        negligible: a difference that does not matter, however sure it is; in ``unit``.
        rule_out: a worsening of this size must be ruled out where a comparison shall pass.
    """

    name: str
    unit: str
    worse: Literal["higher", "lower"]
    value: Value
    definition: str
    rate: bool = False
    hits_only: bool = False
    negligible: float = 0.0
    rule_out: float


def judged(result: Result) -> bool:
    """Whether a run says something about the AV: it was attacked, or meant to go without attack."""
    return attacked(result) or bool(result["status"] == "ok" and result["adversary"] == "none")


def _av_collision(result: Result) -> float | None:
    if not judged(result):
        return None
    kinds = {contact["kind"] for contact in result["contacts"]}
    return float(bool(kinds & {"av_opponent", "av_other"}))


def _impact(result: Result) -> float | None:
    """Of the AV's contacts with anything, also those with vehicles that did not attack."""
    if not judged(result):
        return None
    hits = (one for one in result["contacts"] if one["kind"] in {"av_opponent", "av_other"})
    return max((float(one["relative_mps"]) for one in hits), default=0.0)


def _ttc(result: Result) -> float | None:
    if not attacked(result) or "ttc_min" not in result["metrics"]:
        return None
    found = metric(result, "ttc_min")
    return TTC_CEILING_S if found is None else min(found, TTC_CEILING_S)


def _required_braking(result: Result) -> float | None:
    return metric(result, "required_deceleration") if attacked(result) else None


def _of_table(
    name: str,
    worse: Literal["higher", "lower"],
    rule_out: float,
    definition: str = "",
    *,
    hits_only: bool = False,
) -> Quantity:
    """A quantity that ``table.csv`` of benchmarks has too."""
    column = BY_NAME[name]
    return Quantity(
        name=name,
        unit=column.unit,
        worse=worse,
        value=lambda result: column.value(result) if counted(column, result) else None,
        definition=definition or column.definition,
        rate=column.rate,
        hits_only=hits_only,
        negligible=0.0 if column.rate else _NEGLIGIBLE,
        rule_out=rule_out,
    )


_RATE: Final = 0.2

QUANTITIES: Final = (
    Quantity(
        name="impact_mps", unit="m/s", worse="higher", value=_impact, negligible=_NEGLIGIBLE,
        rule_out=3.0,
        definition="relative speed of the AV's worst contact with anything, 0 without a contact",
    ),
    Quantity(
        name="av_collision_rate", unit="1", worse="higher", value=_av_collision, rate=True,
        rule_out=_RATE, definition="share of the judged runs in which the AV touched anything",
    ),
    _of_table("collision_rate", "higher", _RATE),
    _of_table(
        "valid_collision_rate", "higher", _RATE,
        "share of the attacked runs with a collision that is possible, lawful in space, avoidable",
    ),
    _of_table(
        "avoidable_rate", "higher", _RATE,
        "share of the hits that a reference driver would have avoided", hits_only=True,
    ),
    _of_table(
        "av_at_fault_rate", "higher", _RATE, "share of the hits that are the AV's fault",
        hits_only=True,
    ),
    Quantity(
        name="ttc_s", unit="s", worse="lower", value=_ttc, negligible=_NEGLIGIBLE, rule_out=1.0,
        definition="least time to collision of AV and opponent in an attacked run, at most"
        f" {TTC_CEILING_S:g} s",
    ),
    _of_table("min_gap_m", "lower", 2.0, "least gap of AV and opponent in an attacked run"),
    Quantity(
        name="required_braking_mps2", unit="m/s2", worse="higher", value=_required_braking,
        negligible=_NEGLIGIBLE, rule_out=1.0,
        definition="hardest braking that the opponent asks of the AV, up to 1 s before a contact",
    ),
    _of_table("collision_speed_mps", "higher", 3.0, "relative speed at a hit", hits_only=True),
    _of_table(
        "delta_v_mps", "higher", 1.5, "change of the AV's velocity by a hit", hits_only=True
    ),
)  # fmt: skip

BY_QUANTITY: Final = {quantity.name: quantity for quantity in QUANTITIES}
