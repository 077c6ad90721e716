"""What is measured of each run: one number per quantity, or none; with name, unit and headings.

Tables of benchmarks, thresholds, comparisons, readable tables and pages take their quantities from
here: a new one is one entry. A rate is the mean of zeros and ones, so that means and paired
differences treat all quantities alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Final, Literal, NamedTuple

from deepmf_sumo.results import findings
from deepmf_sumo.results.result import Result, attacked, av_contacts

Value = Callable[[Result], float | None]
Better = Literal["lower", "higher", "neither"]

OFFROAD_SHARE: Final = 0.05
"""Of its driven steps; with more of them off the road an opponent counts as off-road."""

TTC_CEILING_S: Final = 10.0
"""`ttc_s` of an attacked run in which AV and opponent were never on a collision course."""

SPARE: Final = "time_to_spare"
_CONFLICT_S: Final = 5.0
"""Longer post-encroachment times are not conflicts (Gettman et al., FHWA-HRT-08-051, 2008)."""

_NEGLIGIBLE: Final = 0.05
"""s, m and m/s: rounding on another machine moves all runs a little, and all in one direction."""

_NEGLIGIBLE_PER_S: Final = 0.005

_SHORTEST_S: Final = 1.0
"""A time to the contact below a driver's reaction time is as bad as this one."""

RATE: Final = 0.2
"""Worsening of a rate that a comparison must rule out."""
_SPEED: Final[Mapping[str, Any]] = {"rule_out": 3.0, "largest": 20.0}
"""Of speeds at a contact: 72 km/h where there was no contact, or the other way round."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A number of each run.

    Attributes:
        unit: 1 for rates and counts.
        better: for the attacker.
        value: of a run of ``over``; None where it is not defined.
        definition: what the mean of a table is. metric: whose definition this is made of; empty
            where ``definition`` says all.
        over: runs that can have a value: those that were ``attacked``, all that were ``done``, or
            those that say something about the AV, see `judged`.
        rate: of zeros and ones, with an interval. of_hits: it is defined for hits only.
        paired: whether differences between methods are given.
        rule_out: a worsening for the AV that must be ruled out where a comparison shall pass.
        largest: difference that intervals expect of a run that was not seen: of rates and of what
            has a ceiling the greatest that there can be, else about the greatest that is usual.
            None: what was seen says it.
        limit: no run may be worse: a rule of the road or of comfort, which needs no baseline.
        failure: what went wrong where it is worse, in words; empty: its name says it.
        in_table: whether it is a column of ``table.csv``.
        title: heading in readable tables, without unit. short: heading on the screen, with unit.
            digits: after the decimal point, there; of rates in per cent.
        label: heading in the table of runs on a page, without unit; empty: it has no column there.
        words: what `show` calls it. shown_digits: there, after the decimal point.
    """

    name: str
    unit: str
    better: Better
    value: Value
    definition: str
    metric: str = ""
    over: Literal["attacked", "done", "judged"] = "attacked"
    rate: bool = False
    of_hits: bool = False
    paired: bool = True
    rule_out: float = inf
    largest: float | None = None
    limit: float | None = None
    failure: str = ""
    in_table: bool = True
    title: str = ""
    short: str = ""
    digits: int = 2
    label: str = ""
    words: str = ""
    shown_digits: int = 1

    @property
    def heading(self) -> str:
        """``least TTC, s``: the label with its unit, where it has one."""
        return self.label if self.unit == "1" else f"{self.label}, {self.unit}"

    @property
    def worse(self) -> Literal["lower", "higher"]:
        """The direction that is worse for the AV: what is better for the attacker, else higher."""
        return "lower" if self.better == "lower" else "higher"

    @property
    def negligible(self) -> float:
        """A difference that does not matter, however sure it is; in ``unit``."""
        if self.rate:
            return 0.0
        return _NEGLIGIBLE_PER_S if self.unit == "1/s" else _NEGLIGIBLE

    @property
    def margin(self) -> float:
        """A difference that a comparison calls small, in ``unit``: see ``rule_out``."""
        return max(self.rule_out, self.negligible)

    def of(self, result: Result) -> float | None:
        """Value of a run; None where it can have none."""
        return self.value(result) if counted(self, result) else None


def counted(quantity: Quantity, result: Result) -> bool:
    """Whether a run can have a value."""
    if quantity.over == "judged":
        return judged(result)
    return bool(result["status"] == "ok") if quantity.over == "done" else attacked(result)


def judged(result: Result) -> bool:
    """Whether a run says something about the AV: it was attacked, or meant to go without attack."""
    return attacked(result) or bool(result["status"] == "ok" and result["adversary"] == "none")


def unit(result: Result) -> tuple[str, str]:
    """The situation of a run: runs with other seeds repeat it, see `statistics`."""
    return result["spec"], result["scene"]


def hit(result: Result) -> bool:
    """Whether the opponent hit the AV."""
    return bool(result["outcome"] == "av_opponent")


def metric(result: Result, name: str) -> float | None:
    """Value of a metric; None where it has none, or is not measured."""
    found = result["metrics"].get(name)
    return None if found is None else found["value"]


def _flag(name: str, test: Callable[[float], bool]) -> Value:
    def value(result: Result) -> float | None:
        found = metric(result, name)
        return None if found is None else float(test(found))

    return value


def values(result: Result) -> dict[str, float | None]:
    """All metrics by name; None where one has no value."""
    return {name: one["value"] for name, one in result["metrics"].items()}


def worth(result: Result) -> findings.Worth | None:
    """What the hit of a run is worth; None without a hit, or where that is not known."""
    return findings.worth(values(result)) if hit(result) else None


def _ttc(result: Result) -> float | None:
    if "ttc_min" not in result["metrics"]:
        return None
    found = metric(result, "ttc_min")
    return TTC_CEILING_S if found is None else min(found, TTC_CEILING_S)


def criticality(spare_s: float | None) -> float:
    """1 in contact, 0 where the AV's encounters left 5 s or more, or no path crossed its own."""
    return 0.0 if spare_s is None else max(0.0, 1.0 - spare_s / _CONFLICT_S)


def _criticality(result: Result) -> float | None:
    found = result["metrics"].get(SPARE)
    return None if found is None else criticality(found["value"])


def _worse(name: str, better: Better = "lower") -> Value:
    """Of the attacked episode and of the same one without attack, where a run has that."""

    def value(result: Result) -> float | None:
        kept = result.get("plain", {}).get(name)
        plain = kept["value"] if kept else None
        found = [one for one in (metric(result, name), plain) if one is not None]
        worst = min if better == "lower" else max
        return worst(found) if found else None

    return value


def _inverse(name: str) -> Value:
    """1 over a time in seconds: a change counts the more, the shorter the time."""
    least = _worse(name)

    def value(result: Result) -> float | None:
        found = least(result)
        return None if found is None else 1.0 / max(found, _SHORTEST_S)

    return value


def _mean(name: str, unit: str, better: Better, of: str, what: str, **more: Any) -> Quantity:
    return Quantity(
        name=name, unit=unit, better=better, value=lambda result: metric(result, of),
        definition=what, metric=of, **more,
    )  # fmt: skip


def _rate(
    name: str, better: Better, value: Value, what: str, of: str = "", **more: Any
) -> Quantity:
    return Quantity(
        name=name, unit="1", better=better, value=value, definition=what, rate=True, metric=of,
        **{"digits": 0, "largest": 1.0, **more},
    )  # fmt: skip


def _positive(value: float) -> bool:
    return value > 0


_RUNS: Final = "mean over attacked runs"
_HITS: Final = "mean over hits"
_BOTH: Final = "mean over judged runs, the worse of the attacked and the plain episode"


class _OfTheAv(NamedTuple):
    """A quantity of the AV alone, see `Quantity`; ``metric``: whose worse value counts."""

    name: str
    unit: str
    better: Better
    metric: str
    failure: str
    rule_out: float
    largest: float
    limit: float | None = None


_OF_THE_AV: Final = (
    _OfTheAv("av_ttc_s", "s", "lower", "av_ttc_min", "near collision", 1.0, 10.0),
    _OfTheAv("av_time_gap_s", "s", "lower", "av_time_gap_min", "short time gap", 0.5, 10.0),
    _OfTheAv("av_required_braking_mps2", "m/s2", "higher", "av_required_braking",
             "near collision", 1.0, 10.0),
    _OfTheAv("av_hardest_braking_mps2", "m/s2", "higher", "planner_hardest_braking",
             "harsh braking", 1.0, 10.0),
    _OfTheAv("av_over_limit_mps", "m/s", "higher", "av_over_limit", "over the speed limit",
             1.0, 10.0, limit=2.0),
    _OfTheAv("av_late_at_signal_s", "s", "higher", "av_late_at_signal", "late at a signal",
             1.0, 10.0),
    _OfTheAv("av_signal_braking_mps2", "m/s2", "higher", "av_signal_braking",
             "late at a signal", 1.0, 10.0, limit=5.0),
    _OfTheAv("av_beyond_line_m", "m", "higher", "av_beyond_stop_line",
             "stopped beyond the line", 1.0, 10.0, limit=2.0),
    _OfTheAv("av_red_run_rate", "1", "higher", "av_red_run", "red run", RATE, 1.0, limit=0.0),
    _OfTheAv("av_right_of_way_mps2", "m/s2", "higher", "av_right_of_way_taken",
             "right of way taken", 1.0, 10.0, limit=6.0),
    _OfTheAv("av_crossing_taken_rate", "1", "higher", "av_crossing_taken",
             "did not give way at a crossing", RATE, 1.0, limit=0.0),
    _OfTheAv("av_unexplained_stop_s", "s", "higher", "av_unexplained_stop",
             "stop without reason", 1.0, 10.0, limit=3.0),
    _OfTheAv("av_unexplained_braking_mps2", "m/s2", "higher", "av_unexplained_braking",
             "braking without reason", 1.0, 10.0, limit=3.0),
    _OfTheAv("av_close_following_s", "s", "higher", "av_close_following", "short time gap",
             1.0, 10.0, limit=1.0),
    _OfTheAv("av_off_lane_m", "m", "higher", "av_off_lane", "off the road", 0.5, 10.0,
             limit=0.6),
    _OfTheAv("av_frozen_s", "s", "higher", "av_frozen", "frozen command", 0.5, 10.0, limit=0.25),
    _OfTheAv("av_progress_m", "m", "lower", "av_progress", "slow", 10.0, 100.0),
)  # fmt: skip

_INVERSE: Final = {
    "av_inverse_ttc_per_s": ("av_ttc_min", "near collision"),
    "av_inverse_time_gap_per_s": ("av_time_gap_min", "short time gap"),
}

QUANTITIES: Final = (
    _rate(
        "collision_rate", "higher", lambda result: float(hit(result)),
        "share of the attacked runs in which the opponent hit the AV",
        title="Coll Rate", rule_out=RATE,
    ),
    _mean("collision_time_s", "s", "lower", "collision_time_s", _HITS,
          title="Coll Time", short="time s", label="contact", words="time to the hit"),
    _mean("collision_speed_mps", "m/s", "higher", "collision_speed", _HITS,
          title="Coll Vel", short="speed m/s", label="speed", of_hits=True,
          words="relative speed at the hit", **_SPEED),
    _mean("kl", "nat", "lower", "acceleration_kl", _RUNS, title="KL", short="KL"),
    _mean("wasserstein", "m/s2", "lower", "acceleration_wasserstein", _RUNS,
          title="Wasserstein", short="W m/s2"),
    _mean("sspd_m", "m", "lower", "path_sspd", _RUNS, title="SSP", short="SSPD m"),
    _mean("hausdorff_m", "m", "lower", "path_hausdorff", _RUNS,
          title="Hausdorff", short="Hausd. m"),
    Quantity(
        name="generation_time_s", unit="s", better="lower", title="Generate Time", short="gen. s",
        words="computing time of the attack", shown_digits=2,
        value=lambda result: result["timings"].get("generation_s"),
        definition="mean wall time of finding an attack: features, networks, candidates, and the"
        " simulations that a search scores them by; without loading weights",
    ),
    _rate(
        "feasible_rate", "higher", _flag("feasible", lambda value: value >= 1),
        "share of the attacked runs with a value of 1", "feasible", title="Feasible",
    ),
    _rate(
        "offroad_rate", "lower", _flag("offroad_share", lambda value: value > OFFROAD_SHARE),
        f"share of the attacked runs with a value above {OFFROAD_SHARE:g}", "offroad_share",
        title="Off-road",
    ),
    _rate(
        "third_party_rate", "lower", _flag("third_party", _positive),
        "share of the attacked runs with a value above 0", "third_party", title="Third party",
    ),
    _rate(
        "finding_rate", "higher", lambda result: findings.finding(values(result)),
        "share of the attacked runs with a value of 1", "finding", title="Findings",
        label="finding", rule_out=RATE,
    ),
    _rate(
        "avoidable_rate", "higher", _flag("avoidable", _positive), "share of the hits with a value"
        " of 1", "avoidable", title="Avoidable", of_hits=True, rule_out=RATE,
    ),
    _rate(
        "av_at_fault_rate", "neither", _flag("av_at_fault", _positive),
        "share of the hits with a value of 1", "av_at_fault", title="AV at fault", of_hits=True,
        rule_out=RATE,
    ),
    _rate(
        "av_other_rate", "neither", _flag("av_third_party", _positive),
        "share of all runs that succeeded, attacked or not, with a value above 0",
        "av_third_party", over="done", title="AV hit others",
    ),
    _mean("planner_saw_opponent", "1", "neither", "planner_saw_opponent", _RUNS, paired=False,
          title="Planner saw OV"),
    _mean("collision_time_restricted_s", "s", "lower", "collision_time_restricted_s", _RUNS),
    _mean("kl_smooth", "nat", "lower", "acceleration_kl_smooth", _RUNS),
    _mean("wasserstein_smooth", "m/s2", "lower", "acceleration_wasserstein_smooth", _RUNS),
    _mean("sspd_cut_m", "m", "lower", "path_sspd_cut", _RUNS),
    _mean("hausdorff_cut_m", "m", "lower", "path_hausdorff_cut", _RUNS),
    _rate(
        "wrong_way_rate", "lower", _flag("wrong_way_share", lambda value: value > OFFROAD_SHARE),
        f"share of the attacked runs with a value above {OFFROAD_SHARE:g}", "wrong_way_share",
    ),
    _rate(
        "red_light_rate", "lower", _flag("red_light", _positive),
        "share of the attacked runs with a value above 0", "red_light",
    ),
    _mean("delta_v_mps", "m/s", "higher", "delta_v", _HITS, label="Δv", of_hits=True,
          rule_out=1.5, largest=10.0, words="change of the AV's velocity (delta-v)"),
    _mean("rms_acceleration_mps2", "m/s2", "lower", "opponent_rms_acceleration", _RUNS,
          title="RMS a"),
    _mean("min_gap_m", "m", "lower", "min_gap", _RUNS, label="least gap", rule_out=2.0,
          largest=20.0, words="least gap of AV and opponent"),
    _mean("ttc_min_s", "s", "lower", "ttc_min", _RUNS, label="least TTC", words="least TTC"),
    _mean("drac_max_mps2", "m/s2", "higher", "drac_max", _RUNS),
    _mean(
        "planner_hardest_braking_mps2", "m/s2", "neither", "planner_hardest_braking", _RUNS,
        paired=False,
    ),
    Quantity(
        name="simulations", unit="1", better="neither", paired=False, title="Simulations", digits=1,
        value=lambda result: float(result["search"]["simulations"]),
        definition="mean number of simulated episodes of an attack",
    ),
    Quantity(
        name="impact_mps", unit="m/s", better="higher", over="judged", in_table=False, **_SPEED,
        value=lambda result: max((float(one["relative_mps"]) for one in av_contacts(result)),
                                 default=0.0),
        definition="relative speed of the AV's worst contact with anything, 0 without a contact",
    ),
    _rate(
        "av_collision_rate", "higher", lambda result: float(bool(av_contacts(result))),
        "share of the judged runs in which the AV touched anything",
        over="judged", in_table=False, rule_out=RATE,
    ),
    Quantity(
        name="ttc_s", unit="s", better="lower", value=_ttc, in_table=False, rule_out=1.0,
        largest=TTC_CEILING_S,
        definition="least time to collision of AV and opponent in an attacked run, at most"
        f" {TTC_CEILING_S:g} s",
    ),
    Quantity(
        name="criticality", unit="1", better="higher", value=_criticality, metric=SPARE,
        in_table=False, rule_out=0.1, largest=1.0,
        definition="mean over attacked runs of 1 - value / 5 s, at least 0, and 0 without an"
        " encounter: what places of the risk map are ranked by",
    ),
    _mean(
        "required_braking_mps2", "m/s2", "higher", "required_deceleration",
        "hardest braking that the opponent asks of the AV, up to 1 s before a contact",
        in_table=False, rule_out=1.0, largest=10.0,
    ),
    *(
        Quantity(
            name=one.name, unit=one.unit, better=one.better, over="judged", in_table=False,
            rule_out=one.rule_out, value=_worse(one.metric, one.better), definition=_BOTH,
            metric=one.metric, rate=one.unit == "1", digits=0 if one.unit == "1" else 2,
            largest=one.largest, limit=one.limit, failure=one.failure,
        )
        for one in _OF_THE_AV
    ),
    *(
        Quantity(
            name=name, unit="1/s", better="higher", over="judged", in_table=False, rule_out=0.1,
            largest=1.0 / _SHORTEST_S, value=_inverse(of), metric=of,
            definition=f"{_BOTH}, of 1 over the value, of at least {_SHORTEST_S:g} s",
            failure=failure,
        )
        for name, (of, failure) in _INVERSE.items()
    ),
)  # fmt: skip

BY_NAME: Final = {quantity.name: quantity for quantity in QUANTITIES}

COLUMNS: Final = tuple(quantity for quantity in QUANTITIES if quantity.in_table)
"""In the order of ``table.csv``."""

AVERAGED: Final = {
    "opponent_rms_acceleration": "rms_a_mps2",
    "feasible": "feasible",
    "on_road": "on_road",
    "candidate_perplexity": "perplexity",
    "colliding_plans": "colliding_plans",
    "predicted_contact": "predicted_rate",
    "av_ade": "av_ade_m",
}
"""Metrics that the rows of `show` average over all runs that succeeded, and their columns there."""

COMPARABLE: Final = {
    name: BY_NAME[name]
    for name in (
        "impact_mps", "av_collision_rate", "collision_rate", "finding_rate",
        "avoidable_rate", "av_at_fault_rate", "criticality", "ttc_s", "min_gap_m",
        "required_braking_mps2", "collision_speed_mps", "delta_v_mps",
        *(one.name for one in _OF_THE_AV), *_INVERSE,
    )
}  # fmt: skip
"""What `check` and `compare` judge, by name: what is worse for the AV is said of each."""
RULES: Final = {name: one for name, one in COMPARABLE.items() if one.limit is not None}
"""What no run may break, whatever it is compared with, see `Quantity.limit`."""


def share(name: str) -> Quantity:
    """A rate that a comparison makes of runs, as bad for the AV as hits are; not of a result."""
    return replace(BY_NAME["collision_rate"], name=name)


_NOW: Final = {"valid_collision_rate": "finding_rate"}
"""Names of earlier versions."""


def no_quantity(name: str) -> str:
    """The sentence, without its full stop, on a name that is none of `COMPARABLE`."""
    if name in _NOW:
        return f"'{name}' is no quantity any more; write '{_NOW[name]}'"
    return f"'{name}' is not a quantity. Known: {', '.join(COMPARABLE)}"
