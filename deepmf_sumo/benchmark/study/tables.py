"""A benchmark's folder -> ``table.csv`` and the tables beside it."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files, tables
from deepmf_sumo.benchmark import stored
from deepmf_sumo.benchmark.quantities import accident, hit, sector
from deepmf_sumo.benchmark.result import Result, attacked
from deepmf_sumo.benchmark.study import layout, paired
from deepmf_sumo.benchmark.study.layout import Budgeted, Layout
from deepmf_sumo.benchmark.study.rows import Row, row_of
from deepmf_sumo.geometry.impact import SECTORS
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES

Key = tuple[str, str, int | None, float | None]
"""Method, planner, and the budget: simulations, seconds; both None where it is the method's own."""

MAIN: Final = "table.csv"
DIFFERENCES: Final = "differences.csv"
EQUAL_SECONDS: Final = "equal_seconds.csv"
CURVES: Final = "curves.csv"
ACCIDENTS: Final = "accidents.csv"


def write(folder: Path) -> None:
    """Write all tables of a benchmark's folder, from its runs. Raises UsageError."""
    plan = layout.read(folder)
    runs = _grouped(results_of(folder))
    files.write(folder / MAIN, tables.to_csv(main_rows(plan, runs)))
    files.write(folder / DIFFERENCES, tables.to_csv(_differences(plan, runs)))
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
        for row in paired.differences(
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
