"""Rate against budget: what more simulations, or more seconds, are worth to a search."""

import csv
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from deepmf_sumo.benchmark.results import Results
from deepmf_sumo.benchmark.study.tables import CURVES
from deepmf_sumo.metrics.statistics import Interval
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.sheet import Sheet, Skipped

BUDGETS: Final = {
    "simulations": "simulations a scene",
    "seconds": "seconds a scene",
}

MOST_TICKS: Final = 6


class Point(NamedTuple):
    """A method on a planner with a budget; ``own`` where it is the method's own."""

    method: str
    planner: str
    budget: float
    rate: Interval
    own: bool


def draw(results: Results) -> Sheet | Skipped:
    """A column a planner, a row a kind of budget, a line a method."""
    file = results.folders[0] / CURVES
    if not file.is_file():
        return Skipped(f"there is no {CURVES}: the plan has no `curves`")
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    points = {kind: _points(rows, kind) for kind in BUDGETS}
    kinds = [kind for kind in BUDGETS if len({one.budget for one in points[kind]}) > 1]
    if not kinds:
        return Skipped(f"{CURVES} knows rates at less than two budgets")
    shown = {point for kind in kinds for point in points[kind]}
    planners = list(dict.fromkeys(row["planner"] for row in rows))
    planners = [one for one in planners if any(point.planner == one for point in shown)]
    known = {point.method for point in shown}
    methods = {number: one for number, one in enumerate(results.methods) if one in known}
    figure, panels = style.charts(len(kinds), len(planners), len(methods))
    for row, kind in enumerate(kinds):
        for column, planner in enumerate(planners):
            here = [point for point in points[kind] if point.planner == planner]
            if here:
                _panel(panels[row, column], here, methods)
            else:
                panels[row, column].axis("off")
            panels[row, column].set_xlabel(BUDGETS[kind])
            if row == 0:
                panels[row, column].set_title(f"planner {planner}", parse_math=False)
        panels[row, 0].set_ylabel("collision rate")
        panels[row, 0].set_xticks(_ticks(points[kind]))  # of all panels of the row
    style.method_legend(figure, methods, len(planners))
    return Sheet(
        figure=figure,
        caption=(
            "Share of the attacked runs in which the opponent hit the AV (Wilson intervals, 95 %)"
            " against the budget of the search; in a ring: the method's own budget."
        ),
    )


def _points(rows: Sequence[dict[str, str]], kind: str) -> list[Point]:
    """Rows whose budget is of a kind; without hits and misses there is no rate."""
    found = []
    for row in rows:
        own = row["budget"] == "own"
        budget = row[f"budget_{kind}"] or (
            row.get("simulations", "") if own and kind == "simulations" else ""
        )  # a method's own budget may be a setting of it: then what it spent
        if budget and row["collision_rate"]:
            rate = Interval(*(float(row[f"collision_rate{part}"]) for part in ("", "_lo", "_hi")))
            found.append(Point(row["method"], row["planner"], float(budget), rate, own))
    return sorted(found, key=lambda point: point.budget)


def _panel(axes: Axes, points: Sequence[Point], methods: dict[int, str]) -> None:
    for number, method in methods.items():
        line = [point for point in points if point.method == method]
        if not line:
            continue
        budgets, rates = [one.budget for one in line], [one.rate for one in line]
        look = style.method_look(number)
        axes.errorbar(
            budgets,
            [rate.rate for rate in rates],
            yerr=[
                [rate.rate - rate.low for rate in rates],
                [rate.high - rate.rate for rate in rates],
            ],
            elinewidth=0.5,
            lw=1.0,
            **look,
        )
        own = [one for one in line if one.own]
        axes.plot(
            [one.budget for one in own], [one.rate.rate for one in own],
            ls="", marker="o", mfc="none", mec="black", mew=0.6, ms=8,
        )  # fmt: skip
    style.rate_axis(axes)
    axes.set_xscale("log")
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")


def _ticks(points: Sequence[Point]) -> list[float]:
    """The budgets, without those whose numbers would touch the last one's."""
    budgets = sorted({point.budget for point in points})
    least = math.log(budgets[-1] / budgets[0]) / MOST_TICKS
    kept = budgets[:1]
    for budget in budgets[1:]:
        if math.log(budget / kept[-1]) >= least:
            kept.append(budget)
    return kept
