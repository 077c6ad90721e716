"""A plan's folder -> ``table.csv`` and the tables beside it.

Rates and differences between two methods on the same scenes have the intervals of
`results.statistics`. A scene counts once, with all its seeds.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

import numpy as np

from deepmf_sumo import files, tables
from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES
from deepmf_sumo.judge.metrics.naturalness import Samples
from deepmf_sumo.judge.metrics.statistics import (
    distinct,
    diversity_m,
    diversity_within_m,
    effectively_distinct,
    pooled,
)
from deepmf_sumo.results import statistics, stored
from deepmf_sumo.results.quantities import (
    COLUMNS,
    Quantity,
    accident,
    counted,
    hit,
    sector,
    unit,
)
from deepmf_sumo.results.result import Result, attacked
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry.impact import SECTORS
from deepmf_sumo.study.plans import layout
from deepmf_sumo.study.plans.layout import Budgeted, Layout

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
            (unit(one), value)
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


def _cells(column: Quantity, of_units: Sequence[tuple[tuple[str, str], float]]) -> Row:
    """The mean; of rates with the interval, of the generation time with the median."""
    values = [value for _, value in of_units]
    cells: Row = {column.name: fmean(values) if values else None}
    if column.rate:
        interval = statistics.rate(statistics.by_unit(of_units)) if values else None
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
    """Naturalness of all runs' accelerations together."""
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


_DIFFERENCE: Final = (
    "planner", "quantity", "unit", "method", "baseline", "pairs", "method_mean", "baseline_mean",
    "difference", "difference_lo", "difference_hi", "method_only", "baseline_only",
)  # fmt: skip
"""Columns: a plan of one method has no rows."""


def differences(
    methods: Mapping[str, Sequence[Result]], baseline: str, planner: str
) -> list[dict[str, Any]]:
    """A row a quantity and method: method minus baseline, over runs where both have a value.

    Args:
        methods: runs on one planner, by method.
        baseline: one of the methods.
        planner: label for the rows.
    """
    return [
        _difference(column, method, baseline, planner, methods)
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
    methods: Mapping[str, Sequence[Result]],
) -> dict[str, Any]:
    ours, theirs = _values(column, methods[method]), _values(column, methods[baseline])
    both = [key for key in ours if key in theirs]
    by_scene: dict[str, list[float]] = defaultdict(list)
    for scene, seed in both:
        by_scene[scene].append(ours[scene, seed] - theirs[scene, seed])
    mean, low, high = (None, None, None)
    if both:
        of_scenes = by_scene.values()
        mean, low, high = statistics.paired(of_scenes, statistics.CONFIDENCE, column.largest)
    row = {
        "planner": planner,
        "quantity": column.name,
        "unit": column.unit,
        "method": method,
        "baseline": baseline,
        "pairs": len(both),
        "method_mean": fmean(ours[key] for key in both) if both else None,
        "baseline_mean": fmean(theirs[key] for key in both) if both else None,
        "difference": mean,
        "difference_lo": low,
        "difference_hi": high,
    }
    row["method_only"] = row["baseline_only"] = None
    if column.rate:
        row["method_only"] = sum(ours[key] > theirs[key] for key in both)
        row["baseline_only"] = sum(ours[key] < theirs[key] for key in both)
    return row


def _values(column: Quantity, results: Sequence[Result]) -> dict[tuple[str, int], float]:
    return {
        (one["scene"], one["seed"]): value
        for one in results
        if counted(column, one) and (value := column.value(one)) is not None
    }


Key = tuple[str, str, int | None, float | None]
"""Method, planner, and the budget: simulations, seconds; both None where it is the method's own."""

MAIN: Final = "table.csv"
DIFFERENCES: Final = "differences.csv"
EQUAL_SECONDS: Final = "equal_seconds.csv"
CURVES: Final = "curves.csv"
ACCIDENTS: Final = "accidents.csv"


def write(folder: Path) -> None:
    """Write all tables of a plan's folder, from its runs. Raises UsageError."""
    plan = layout.read_layout(folder)
    runs = _grouped(results_of(folder))
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


def results_of(folder: Path) -> list[Result]:
    """All results that ``runs.csv`` lists, in its order. Raises UsageError where there are none."""
    folders = (
        stored.run_folder(folder, row["run_id"], stored.RUNS) for row in stored.rows_of(folder)
    )
    return [stored.result_of(one / "result.json") for one in folders]


def main_rows(plan: Layout, runs: Mapping[Key, Sequence[Result]]) -> list[Row]:
    """A row a method and planner, in the plan's order."""
    return [
        row_of(method, planner, runs.get((method, planner, None, None), ()), planned)
        for planner in plan.planners
        for method in plan.methods
        if (planned := plan.planned(method, planner))
    ]


def _grouped(results: Iterable[Result]) -> dict[Key, list[Result]]:
    groups: dict[Key, list[Result]] = {}
    for one in results:
        own = one["part"] != "budgets"
        budget = (None, None) if own else (one["budget"]["simulations"], one["budget"]["seconds"])
        groups.setdefault((one["base_method"], one["planner_label"], *budget), []).append(one)
    return groups


def _differences(plan: Layout, runs: Mapping[Key, Sequence[Result]]) -> list[Row]:
    return [
        row
        for planner in plan.planners
        if plan.planned(plan.baseline, planner)
        for row in differences(
            {
                method: runs.get((method, planner, None, None), ())
                for method in plan.methods
                if plan.planned(method, planner)
            },
            plan.baseline,
            planner,
        )
    ]


def _accidents(plan: Layout, runs: Mapping[Key, Sequence[Result]]) -> list[Row]:
    """Hits by impact sector on the AV, and by the name of the accident."""
    rows = []
    for planner in plan.planners:
        for method in dict.fromkeys([*plan.methods, *plan.plan["methods"]]):
            if not plan.planned(method, planner):
                continue
            found = runs.get((method, planner, None, None), ())
            hits = [one for one in found if attacked(one) and hit(one)]
            for kind, names, of in (
                ("sector", SECTORS, sector),
                ("type", ACCIDENT_TYPES, accident),
            ):
                counts = Counter(of(one) for one in hits)
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


def _equal_seconds(plan: Layout, part: Budgeted, runs: Mapping[Key, Sequence[Result]]) -> list[Row]:
    """All methods: those of the part with its seconds, the others with their own budget."""
    return [
        _point(plan, part, method, planner, budget, runs)
        for planner in part.planners
        for method in plan.methods
        if plan.planned(method, planner) or method in part.budgets
        for budget in part.budgets.get(method, [{}])
    ]


def _curves(plan: Layout, part: Budgeted, runs: Mapping[Key, Sequence[Result]]) -> list[Row]:
    """The methods of the part, with their own budget and then with each of its budgets."""
    return [
        _point(plan, part, method, planner, budget, runs)
        for planner in part.planners
        for method in part.budgets
        for budget in [*([{}] if plan.planned(method, planner) else []), *part.budgets[method]]
    ]


def _point(
    plan: Layout,
    part: Budgeted,
    method: str,
    planner: str,
    budget: Mapping[str, Any],
    runs: Mapping[Key, Sequence[Result]],
) -> Row:
    """A row on the part's scenes; an empty budget is the method's own."""
    own = plan.plan["methods"][method]["budget"]
    asked = {"simulations": None, "seconds": None, **budget}
    key: Key = (method, planner, asked["simulations"], asked["seconds"])
    planned = len(part.scenes) * len(plan.plan["seeds"])
    if not budget or asked == own:
        key = (method, planner, None, None)
        planned = plan.planned(method, planner, len(part.scenes))
    found = [one for one in runs.get(key, ()) if one["scene"] in part.scenes]
    shown = budget or own
    head = {
        "budget": "given" if budget else "own",
        "budget_simulations": shown["simulations"],
        "budget_seconds": shown["seconds"],
    }
    return head | row_of(method, planner, found, planned)
