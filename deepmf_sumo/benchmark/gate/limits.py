"""Thresholds against runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final, Literal

import numpy as np

from deepmf_sumo.benchmark.gate.rows import Row
from deepmf_sumo.benchmark.gate.thresholds import Limits, Thresholds
from deepmf_sumo.benchmark.quantities import COMPARABLE, Quantity
from deepmf_sumo.errors import UsageError, nearest
from deepmf_sumo.metrics.statistics import wilson

ALL: Final = "all runs"
UNFINISHED: Final = {"failed", "timeout", "missing"}
_PERCENTILES: Final = {"min_ttc_p05": "ttc_s", "min_gap_p05": "min_gap_m"}
_GREATEST: Final = {
    "max_delta_v_mps": "delta_v_mps",
    "max_collision_speed_mps": "collision_speed_mps",
}
_COUNTS: Final = ("max_failed_runs", "max_skipped_runs", "min_judged_runs")


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """One bound over one group of runs.

    Attributes:
        group: e.g. ``planner idm corridor``. limit: its key, e.g. ``max_av_collision_rate``.
        value: None where no run has one.
        interval: 95 % of a rate, for the reader; the value itself is judged.
        runs: with a value.
        state: ``unfit`` where the runs are no basis for a judgement; ``no value`` where there was
            nothing to measure, e.g. no hit whose speed could be too high.
        blamed: ids of the runs that a broken bound is due to.
    """

    group: str
    limit: str
    bound: float
    value: float | None
    unit: str
    runs: int
    state: Literal["held", "broken", "no value", "unfit"]
    interval: tuple[float, float] | None = None
    blamed: tuple[str, ...] = ()


def judge(thresholds: Thresholds, rows: Sequence[Row]) -> list[Judgement]:
    """Every bound, over all runs and over each group.

    Raises UsageError for a group that no run belongs to.
    """
    return [
        judgement
        for group, limits, members in _groups(thresholds, rows)
        for judgement in _judge(group, limits, members)
    ]


def _groups(thresholds: Thresholds, rows: Sequence[Row]) -> Iterator[tuple[str, Limits, list[Row]]]:
    yield ALL, thresholds, list(rows)
    for kind in ("spec", "network", "planner"):
        groups: dict[str, Limits] = getattr(thresholds, f"{kind}s")
        for pattern, limits in groups.items():
            members = [row for row in rows if fnmatchcase(getattr(row, kind), pattern)]
            if not members:
                known = list(dict.fromkeys(getattr(row, kind) for row in rows))
                hint = nearest(pattern, known) or f" There are {known[:5]}."
                raise UsageError(
                    f"thresholds of the {kind} '{pattern}': no run of the results is of it.{hint}"
                )
            yield f"{kind} {pattern}", limits, members


def _judge(group: str, limits: Limits, rows: Sequence[Row]) -> Iterator[Judgement]:
    for limit in Limits.model_fields:
        bound = getattr(limits, limit)
        if bound is None:
            continue
        if limit in _COUNTS:
            yield _count(group, limit, bound, rows)
        elif limit in _PERCENTILES:
            yield _percentile(group, limit, bound, rows)
        elif limit in _GREATEST:
            yield _greatest(group, limit, bound, rows)
        else:
            yield _rate(group, limit, bound, rows)


def _count(group: str, limit: str, bound: int, rows: Sequence[Row]) -> Judgement:
    if limit == "min_judged_runs":
        count, blamed = sum(row.judged for row in rows), []
        fits = count >= bound
    else:
        wanted = UNFINISHED if limit == "max_failed_runs" else {"skipped"}
        blamed = [row.run_id for row in rows if row.status in wanted]
        count, fits = len(blamed), len(blamed) <= bound
    return Judgement(
        group=group, limit=limit, bound=bound, value=count, unit="", runs=len(rows),
        state="held" if fits else "unfit", blamed=() if fits else tuple(blamed),
    )  # fmt: skip


def _rate(group: str, limit: str, bound: float, rows: Sequence[Row]) -> Judgement:
    name = limit.removeprefix("max_")
    values = _values(name, rows)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], rows)
    hits = [run_id for run_id, value in values.items() if value]
    rate, low, high = wilson(len(hits), len(values))
    broken = rate > bound
    return Judgement(
        group=group, limit=limit, bound=bound, value=rate, unit="1", runs=len(values),
        state="broken" if broken else "held", interval=(low, high),
        blamed=tuple(hits) if broken else (),
    )  # fmt: skip


def _percentile(group: str, limit: str, bound: float, rows: Sequence[Row]) -> Judgement:
    """The value of a run: at most 5 % of the runs are below it."""
    name = _PERCENTILES[limit]
    values = _values(name, rows)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], rows)
    value = float(np.percentile(list(values.values()), 5, method="inverted_cdf"))
    blamed = [run_id for run_id, each in values.items() if each < bound] if value < bound else []
    return Judgement(
        group=group, limit=limit, bound=bound, value=value, unit=COMPARABLE[name].unit,
        runs=len(values), state="broken" if blamed else "held", blamed=tuple(blamed),
    )  # fmt: skip


def _greatest(group: str, limit: str, bound: float, rows: Sequence[Row]) -> Judgement:
    name = _GREATEST[limit]
    values = _values(name, rows)
    if not values:
        return _without_value(group, limit, bound, COMPARABLE[name], rows)
    blamed = [run_id for run_id, each in values.items() if each > bound]
    return Judgement(
        group=group, limit=limit, bound=bound, value=max(values.values()),
        unit=COMPARABLE[name].unit, runs=len(values), state="broken" if blamed else "held",
        blamed=tuple(blamed),
    )  # fmt: skip


def _without_value(
    group: str, limit: str, bound: float, quantity: Quantity, rows: Sequence[Row]
) -> Judgement:
    """Fine where nothing happened that could be measured; no basis where it was not measured."""
    hits = _values("collision_rate", rows)
    missed = any(hits.values()) if quantity.of_hits else bool(hits)
    return Judgement(
        group=group, limit=limit, bound=bound, value=None, unit=quantity.unit, runs=0,
        state="unfit" if missed else "no value",
    )  # fmt: skip


def _values(name: str, rows: Sequence[Row]) -> dict[str, float]:
    return {row.run_id: row.values[name] for row in rows if name in row.values}
