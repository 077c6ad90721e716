"""A plan's folder -> ``table.csv`` and the tables beside it.

Rates and differences between two methods on the same scenes have the intervals of
`results.statistics`. A scene counts once, with all its seeds.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

import numpy as np
import pandas as pd

from deepmf_sumo import files, tables
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.judge.metrics.naturalness import AccelerationSamples
from deepmf_sumo.judge.metrics.statistics import (
    distinct,
    diversity_m,
    diversity_within_m,
    effectively_distinct,
    pooled,
)
from deepmf_sumo.results import frames, statistics
from deepmf_sumo.results.matching import match_pairs
from deepmf_sumo.results.quantities import COLUMNS, Quantity
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry.impact import SECTORS
from deepmf_sumo.study.plans import layout
from deepmf_sumo.study.plans.layout import Budgeted, PlanLayout

Row = dict[str, Any]
STATUSES: Final = ("ok", "failed", "timeout", "skipped")
TIMINGS: Final = ("generation_time_s", "generation_time_median_s")
"""Columns that differ between equal benchmarks."""


def runs_of(results: Results) -> pd.DataFrame:
    """The frame of runs, with what tables of plans need beside it.

    ``base_method`` is the method without its budget, ``samples`` those of `result.Result`. Raises
    UsageError where a run has no ``result.json``.
    """
    found = [run.result for run in results.runs]
    own = {name: [one.get(name) for one in found] for name in ("base_method", "samples")}
    return results.frame().assign(
        **{name: pd.Series(values, dtype=object) for name, values in own.items()}
    )


def row_of(method: str, planner: str, runs: pd.DataFrame, planned: int) -> Row:
    """A row of ``table.csv``; what is not known is None.

    Args:
        method: its label.
        planner: its label.
        runs: all of them that have ended, as of `runs_of`.
        planned: runs in the plan; those without a result are ``unfinished``.
    """
    done = runs[runs["attacked"]]
    statuses = Counter(runs["status"])
    first: Mapping[Any, Any] = runs.iloc[0].to_dict() if len(runs) else {}
    row: Row = {
        "method": method,
        "planner": planner,
        "perception": first.get("perception"),
        "parameters": first.get("parameters"),
        "scenes": runs["scene"].nunique(),
        "attacked": len(done),
        "hits": int(done["hit"].sum()),
    }
    of = {column: done if column.over == "attacked" else runs for column in COLUMNS}
    for column, part in of.items():
        row |= _cells(column, part)
    row |= _variety(done) | _pooled(done)
    row["runs"] = len(runs)
    row |= {status: statuses[status] for status in STATUSES}
    row["nobody_to_attack"] = statuses["ok"] - len(done)
    row["unfinished"] = planned - len(runs)
    return row | {f"n_{column.name}": int(part[column.name].count()) for column, part in of.items()}


def _cells(column: Quantity, runs: pd.DataFrame) -> Row:
    """The mean; of rates with the interval, of the generation time with the median."""
    values = list(runs[column.name].dropna())
    cells: Row = {column.name: fmean(values) if values else None}
    if column.rate:
        interval = frames.rate(runs, column.name) if values else None
        cells[f"{column.name}_lo"] = interval.low if interval else None
        cells[f"{column.name}_hi"] = interval.high if interval else None
    if column.name == "generation_time_s":
        cells["generation_time_median_s"] = median(values) if values else None
    return cells


def _variety(done: pd.DataFrame) -> Row:
    """How different the attacks are: over all scenes, and those on one scene."""
    paths: dict[str, list[Floats]] = defaultdict(list)
    for scene, samples in zip(done["scene"], done["samples"], strict=True):
        if samples and samples["opponent_m"]:
            paths[scene].append(np.array(samples["opponent_m"]))
    hits = done[done["hit"]]
    sectors, accidents = (_numbers(hits[name]) for name in ("impact_sector", "accident_type"))
    return {
        "sectors_hit": distinct(sectors),
        "sectors_effective": effectively_distinct(sectors),
        "accident_types": distinct(accidents),
        "diversity_m": diversity_m([path for each in paths.values() for path in each]),
        "diversity_within_scenes_m": diversity_within_m(paths.values()),
    }


def _numbers(column: pd.Series) -> list[int]:
    """Of names that metrics and contacts number."""
    return [round(value) for value in column.dropna()]


def _pooled(done: pd.DataFrame) -> Row:
    """Naturalness of all runs' accelerations together."""
    samples = [
        AccelerationSamples(np.array(one["attack_mps2"]), np.array(one["recorded_mps2"]))
        for one in done["samples"]
        if one and one["attack_mps2"]
    ]
    found = pooled(samples)
    names = ("kl", "jsd", "wasserstein")
    return {
        **{f"pooled_{name}": getattr(found, name) if found else None for name in names},
        "pooled_runs": found.runs if found else 0,
    }


_DIFFERENCE: Final = (
    "planner", "quantity", "unit", "method", "baseline", "pairs", "method_mean", "baseline_mean",
    "difference", "difference_lo", "difference_hi", "method_only", "baseline_only",
)  # fmt: skip
"""Columns: a plan of one method has no rows."""


def differences(
    methods: Mapping[str, pd.DataFrame], baseline: str, planner: str
) -> list[dict[str, Any]]:
    """A row a quantity and method: method minus baseline, over runs where both have a value.

    Args:
        methods: runs on one planner, by method.
        baseline: one of the methods.
        planner: label for the rows.
    """
    alike = {
        method: runs.assign(run_id=runs["seed"].astype(str) + " " + runs["scene"], spec="")
        for method, runs in methods.items()
    }
    return [
        _difference(column, method, baseline, planner, alike)
        for column in COLUMNS
        if column.paired
        for method in methods
        if method != baseline
    ]


def _difference(
    column: Quantity,
    method: str,
    baseline: str,
    planner: str,
    methods: Mapping[str, pd.DataFrame],
) -> dict[str, Any]:
    """``methods``: runs with equal ids where scene and seed are, whatever their spec."""
    found = match_pairs(
        column.name, methods[method], methods[baseline], statistics.CONFIDENCE, column.largest
    )
    mean, low, high = (found and found.difference) or (None, None, None)
    return {
        "planner": planner,
        "quantity": column.name,
        "unit": column.unit,
        "method": method,
        "baseline": baseline,
        "pairs": found.count if found else 0,
        "method_mean": found and found.new,
        "baseline_mean": found and found.old,
        "difference": mean,
        "difference_lo": low,
        "difference_hi": high,
        "method_only": (found.more if found else 0) if column.rate else None,
        "baseline_only": (found.fewer if found else 0) if column.rate else None,
    }


Key = tuple[str, str, float | None, float | None]
"""Method, planner, and the budget: simulations, seconds; both None where it is the method's own."""
Runs = Mapping[Key, pd.DataFrame]

MAIN: Final = "table.csv"
DIFFERENCES: Final = "differences.csv"
EQUAL_SECONDS: Final = "equal_seconds.csv"
CURVES: Final = "curves.csv"
ACCIDENTS: Final = "accidents.csv"


def write(folder: Path) -> None:
    """Write all tables of a plan's folder, from its runs. Raises UsageError."""
    plan = layout.read_layout(folder)
    runs = _grouped(runs_of(Results.of(folder)))
    files.write(folder / MAIN, tables.to_csv(main_rows(plan, runs)))
    files.write(folder / DIFFERENCES, tables.to_csv(_differences(plan, runs), _DIFFERENCE))
    files.write(folder / ACCIDENTS, tables.to_csv(_accidents(plan, runs)))
    for name, part, rows_of in (
        (EQUAL_SECONDS, plan.equal_seconds, _equal_seconds),
        (CURVES, plan.curves, _curves),
    ):
        if part:
            files.write(folder / name, tables.to_csv(rows_of(plan, part, runs)))
        else:  # that of an earlier plan, where the folder is resumed
            (folder / name).unlink(missing_ok=True)


def main_rows(plan: PlanLayout, runs: Runs) -> list[Row]:
    """A row a method and planner, in the plan's order."""
    return [
        row_of(method, planner, runs[method, planner, None, None], planned)
        for planner in plan.planners
        for method in plan.methods
        if (planned := plan.planned(method, planner))
    ]


def _grouped(runs: pd.DataFrame) -> Runs:
    """By method, planner and budget; none without any runs."""
    groups: dict[Key, list[int]] = {}
    columns = ("base_method", "planner_label", "part", "budget_simulations", "budget_seconds")
    for place, (method, planner, part, *budget) in enumerate(
        zip(*(runs[name] for name in columns), strict=True)
    ):
        given = (None if pd.isna(one) else one for one in budget)
        key = (method, planner, *((None, None) if part != "budgets" else given))
        groups.setdefault(key, []).append(place)
    found = {key: runs.iloc[places] for key, places in groups.items()}
    return defaultdict(lambda: runs.iloc[:0], found)


def _differences(plan: PlanLayout, runs: Runs) -> list[Row]:
    return [
        row
        for planner in plan.planners
        if plan.planned(plan.baseline, planner)
        for row in differences(
            {
                method: runs[method, planner, None, None]
                for method in plan.methods
                if plan.planned(method, planner)
            },
            plan.baseline,
            planner,
        )
    ]


def _accidents(plan: PlanLayout, runs: Runs) -> list[Row]:
    """Hits by impact sector on the AV, and by the name of the accident."""
    rows = []
    for planner in plan.planners:
        for method in dict.fromkeys([*plan.methods, *plan.plan["methods"]]):
            if not plan.planned(method, planner):
                continue
            found = runs[method, planner, None, None]
            hits = found[found["attacked"] & found["hit"]]
            for kind, names, column in (
                ("sector", SECTORS, "impact_sector"),
                ("type", ACCIDENT_TYPES, "accident_type"),
            ):
                counts = Counter(_numbers(hits[column]))
                rows += [
                    {
                        "method": method,
                        "planner": planner,
                        "kind": kind,
                        "number": number,
                        "name": name,
                        "hits": counts[number],
                        "of_hits": len(hits),
                    }
                    for number, name in enumerate(names)
                ]
    return rows


def _equal_seconds(plan: PlanLayout, part: Budgeted, runs: Runs) -> list[Row]:
    """All methods: those of the part with its seconds, the others with their own budget."""
    return [
        _point(plan, part, method, planner, budget, runs)
        for planner in part.planners
        for method in plan.methods
        if plan.planned(method, planner) or method in part.budgets
        for budget in part.budgets.get(method, [{}])
    ]


def _curves(plan: PlanLayout, part: Budgeted, runs: Runs) -> list[Row]:
    """The methods of the part, with their own budget and then with each of its budgets."""
    return [
        _point(plan, part, method, planner, budget, runs)
        for planner in part.planners
        for method in part.budgets
        for budget in [*([{}] if plan.planned(method, planner) else []), *part.budgets[method]]
    ]


def _point(
    plan: PlanLayout,
    part: Budgeted,
    method: str,
    planner: str,
    budget: Mapping[str, Any],
    runs: Runs,
) -> Row:
    """A row on the part's scenes; an empty budget is the method's own."""
    own = plan.plan["methods"][method]["budget"]
    asked = {"simulations": None, "seconds": None, **budget}
    key: Key = (method, planner, asked["simulations"], asked["seconds"])
    planned = len(part.scenes) * len(plan.plan["seeds"])
    if not budget or asked == own:
        key = (method, planner, None, None)
        planned = plan.planned(method, planner, len(part.scenes))
    found = runs[key]
    found = found[found["scene"].isin(part.scenes)]
    shown = budget or own
    head = {
        "budget": "given" if budget else "own",
        "budget_simulations": shown["simulations"],
        "budget_seconds": shown["seconds"],
    }
    return head | row_of(method, planner, found, planned)
