"""Runs of a method on a planner -> its row: means with their denominators, rates with intervals."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from statistics import fmean, median
from typing import Any, Final

import numpy as np

from deepmf_sumo.benchmark.quantities import (
    COLUMNS,
    Quantity,
    accident,
    counted,
    hit,
    sector,
)
from deepmf_sumo.benchmark.result import Result, attacked
from deepmf_sumo.datatypes import Floats
from deepmf_sumo.metrics.naturalness import Samples
from deepmf_sumo.metrics.statistics import (
    distinct,
    diversity_m,
    diversity_within_m,
    effectively_distinct,
    pooled,
    wilson,
)

Row = dict[str, Any]
STATUSES: Final = ("ok", "failed", "timeout", "skipped")
TIMINGS: Final = ("generation_time_s", "generation_time_median_s")
"""Columns that differ between equal benchmarks."""


def row_of(method: str, planner: str, results: Sequence[Result], planned: int) -> Row:
    """A row of ``table.csv``; what is not known is None.

    Args:
        method: its label.
        planner: its label.
        results: of all their runs that have ended.
        planned: runs in the plan; those without a result are ``unfinished``.
    """
    done = [one for one in results if attacked(one)]
    statuses = Counter(one["status"] for one in results)
    first: Mapping[str, Any] = results[0] if results else {}
    row: Row = {
        "method": method,
        "planner": planner,
        "perception": first.get("perception"),
        "parameters": first.get("parameters"),
        "scenes": len({one["scene"] for one in results}),
        "attacked": len(done),
        "hits": sum(map(hit, done)),
    }
    counts: Row = {}
    for column in COLUMNS:
        values = [
            value
            for one in results
            if counted(column, one) and (value := column.value(one)) is not None
        ]
        row |= _cells(column, values)
        counts[f"n_{column.name}"] = len(values)
    row |= _variety(done) | _pooled(done)
    row["runs"] = len(results)
    row |= {status: statuses[status] for status in STATUSES}
    row["nobody_to_attack"] = statuses["ok"] - len(done)
    row["unfinished"] = planned - len(results)
    return row | counts


def _cells(column: Quantity, values: Sequence[float]) -> Row:
    """The mean; of rates with the interval, of the generation time with the median."""
    cells: Row = {column.name: fmean(values) if values else None}
    if column.rate:
        interval = wilson(round(sum(values)), len(values)) if values else None
        cells[f"{column.name}_lo"] = interval.low if interval else None
        cells[f"{column.name}_hi"] = interval.high if interval else None
    if column.name == "generation_time_s":
        cells["generation_time_median_s"] = median(values) if values else None
    return cells


def _variety(done: Sequence[Result]) -> Row:
    """How different the attacks are: over all scenes, and those on one scene."""
    paths: dict[str, list[Floats]] = defaultdict(list)
    for one in done:
        if one["samples"] and one["samples"]["opponent_m"]:
            paths[one["scene"]].append(np.array(one["samples"]["opponent_m"]))
    return {
        "sectors_hit": distinct(map(sector, done)),
        "sectors_effective": effectively_distinct(map(sector, done)),
        "accident_types": distinct(map(accident, done)),
        "diversity_m": diversity_m([path for each in paths.values() for path in each]),
        "diversity_within_scenes_m": diversity_within_m(paths.values()),
    }


def _pooled(done: Sequence[Result]) -> Row:
    """Naturalness of all runs' accelerations at once."""
    samples = [
        Samples(np.array(one["samples"]["attack_mps2"]), np.array(one["samples"]["recorded_mps2"]))
        for one in done
        if one["samples"] and one["samples"]["attack_mps2"]
    ]
    found = pooled(samples)
    names = ("kl", "jsd", "wasserstein")
    return {
        **{f"pooled_{name}": getattr(found, name) if found else None for name in names},
        "pooled_runs": found.runs if found else 0,
    }
