"""What is measured of each run of a benchmark: a number a column, or nothing.

A rate is the mean of zeros and ones, so that tables and paired differences treat all columns alike.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

from deepmf_sumo.benchmark.result import Result, attacked, first_contact

Value = Callable[[Result], float | None]
Better = Literal["lower", "higher", "neither"]

OFFROAD_SHARE: Final = 0.05
"""Of its driven steps; with more of them off the road an opponent counts as off-road."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of ``table.csv``.

    Attributes:
        value: of a run whose AV was attacked; None where it is not defined.
        better: for the attacker. rate: of zeros and ones, with a Wilson interval.
        metric: whose definition this is made of; empty where ``definition`` says all.
        paired: whether differences between methods are given.
        of_all: of all runs that went through, whether or not somebody attacked.
    """

    name: str
    unit: str
    better: Better
    value: Value
    definition: str
    rate: bool = False
    metric: str = ""
    paired: bool = True
    of_all: bool = False


def counted(column: Column, result: Result) -> bool:
    """Whether a run can have a value in the column."""
    return bool(result["status"] == "ok") if column.of_all else attacked(result)


def hit(result: Result) -> bool:
    """Whether the opponent hit the AV."""
    return bool(result["outcome"] == "av_opponent")


def metric(result: Result, name: str) -> float | None:
    """Value of a metric; None where it has none, or is not measured."""
    value: float | None = result["metrics"].get(name, {}).get("value")
    return value


def sector(result: Result) -> int | None:
    """Where the opponent hit the AV, 0 (front) to 7, counter-clockwise; None if it did not."""
    contact = first_contact(result) if hit(result) else None
    return int(contact["sector"]) if contact else None


def accident(result: Result) -> int | None:
    """Number of the accident's name; None without a hit, or where it was not measured."""
    number = metric(result, "accident_type")
    return None if number is None else round(number)


def _of(name: str) -> Value:
    return lambda result: metric(result, name)


def _flag(name: str, test: Callable[[float], bool]) -> Value:
    def value(result: Result) -> float | None:
        found = metric(result, name)
        return None if found is None else float(test(found))

    return value


def _timing(name: str) -> Value:
    return lambda result: result["timings"].get(name)


def _valid(result: Result) -> float | None:
    found = result["metrics"].get("valid_collision")
    return None if found is None else float(found["value"] == 1)


def _mean(column: str, unit: str, better: Better, name: str, what: str, **more: Any) -> Column:
    return Column(
        name=column, unit=unit, better=better, value=_of(name), definition=what, metric=name, **more
    )


def _rate(
    column: str, better: Better, value: Value, what: str, name: str = "", **more: Any
) -> Column:
    return Column(
        name=column, unit="1", better=better, value=value, definition=what, rate=True, metric=name,
        **more,
    )  # fmt: skip


def _positive(value: float) -> bool:
    return value > 0


_RUNS: Final = "mean over attacked runs"
_HITS: Final = "mean over hits"

COLUMNS: Final = (
    _rate(
        "collision_rate", "higher", lambda result: float(hit(result)),
        "share of the attacked runs in which the opponent hit the AV",
    ),
    _mean("collision_time_s", "s", "lower", "collision_time_s", _HITS),
    _mean("collision_speed_mps", "m/s", "higher", "collision_speed", _HITS),
    _mean("kl", "nat", "lower", "acceleration_kl", _RUNS),
    _mean("wasserstein", "m/s2", "lower", "acceleration_wasserstein", _RUNS),
    _mean("sspd_m", "m", "lower", "path_sspd", _RUNS),
    _mean("hausdorff_m", "m", "lower", "path_hausdorff", _RUNS),
    Column(
        name="generation_time_s", unit="s", better="lower", value=_timing("generation_s"),
        definition="mean wall time of finding an attack: features, networks, candidates, and the"
        " simulations that a search scores them by; without loading weights",
    ),
    _rate(
        "feasible_rate", "higher", _flag("feasible", lambda value: value >= 1),
        "share of the attacked runs with a value of 1", "feasible",
    ),
    _rate(
        "offroad_rate", "lower", _flag("offroad_share", lambda value: value > OFFROAD_SHARE),
        f"share of the attacked runs with a value above {OFFROAD_SHARE:g}", "offroad_share",
    ),
    _rate(
        "third_party_rate", "lower", _flag("third_party", _positive),
        "share of the attacked runs with a value above 0", "third_party",
    ),
    _rate(
        "valid_collision_rate", "higher", _valid, "share of the attacked runs with a value of 1",
        "valid_collision",
    ),
    _rate(
        "avoidable_rate", "higher", _flag("avoidable", _positive), "share of the hits with a value"
        " of 1", "avoidable",
    ),
    _rate(
        "av_at_fault_rate", "neither", _flag("av_at_fault", _positive),
        "share of the hits with a value of 1", "av_at_fault",
    ),
    _rate(
        "av_other_rate", "neither", _flag("av_third_party", _positive),
        "share of all runs that went through, attacked or not, with a value above 0",
        "av_third_party", of_all=True,
    ),
    _mean("planner_saw_opponent", "1", "neither", "planner_saw_opponent", _RUNS, paired=False),
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
    _mean("delta_v_mps", "m/s", "higher", "delta_v", _HITS),
    _mean("rms_acceleration_mps2", "m/s2", "lower", "opponent_rms_acceleration", _RUNS),
    _mean("min_gap_m", "m", "lower", "min_gap", _RUNS),
    _mean("ttc_min_s", "s", "lower", "ttc_min", _RUNS),
    _mean("drac_max_mps2", "m/s2", "higher", "drac_max", _RUNS),
    _mean(
        "planner_hardest_braking_mps2", "m/s2", "neither", "planner_hardest_braking", _RUNS,
        paired=False,
    ),
    Column(
        name="simulations", unit="1", better="neither", paired=False,
        value=lambda result: float(result["search"]["simulations"]),
        definition="mean number of simulated episodes of an attack",
    ),
)  # fmt: skip
"""In the order of ``table.csv``."""

BY_NAME: Final = {column.name: column for column in COLUMNS}
