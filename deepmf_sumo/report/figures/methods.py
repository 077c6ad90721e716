"""Figure 6: what every method makes of the same scene, in the same frame."""

import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.attacks import caption_of
from deepmf_sumo.report.figures.episode import (
    KEY_IN,
    draw_episode,
    driven,
    key,
    scale_of,
    window_of,
)
from deepmf_sumo.report.figures.style import PanelGrid, Sheet, Skipped, frame, shape
from deepmf_sumo.results import statistics
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.results.statistics import Difference, Interval
from deepmf_sumo.study.plans.tables import CURVES
from deepmf_sumo.tables import read_csv

COMPARED: Final = 12
"""Scenes whose paths are compared."""


def draw_methods(results: Results) -> Sheet | Skipped:
    """The first planner's scene in which the methods do the most different things."""
    if len(results.methods) < 2:
        return Skipped("there is one method alone")
    shown = _chosen(results)
    if len(shown) < 2:
        return Skipped("no scene was attacked by two methods")
    rows, columns = shape(len(shown))
    grid = PanelGrid(
        width_in=style.DOUBLE_IN if columns > 2 else style.SINGLE_IN, rows=rows, columns=columns,
        title_lines=2, strip_in=KEY_IN,
    )  # fmt: skip
    figure, seconds, window = grid.sheet(), scale_of(shown), window_of(shown)
    road, note = shown[0].road()
    for number, (run, letter) in enumerate(zip(shown, style.letters(len(shown)), strict=True)):
        axes = grid.panel(figure, *divmod(number, columns))
        draw_episode(axes, run, road, window, grid.panel_in, seconds)
        frame(axes, window, f"{letter} {run.method}\n{caption_of(run)}")
    key(figure, grid, seconds)
    return Sheet(
        figure=figure,
        caption=(
            f"All methods on scene {shown[0].scene}, planner {shown[0].planner}: AV (blue) and"
            " opponent (orange, starred at the start), darker with time, a box a second;"
            " where the AV is hit, when, at what relative speed. The scene"
            " is one of those on which most methods ran, half of them hit, if that is so anywhere,"
            f" and most attack the same vehicle ({_same(shown)} of {len(shown)} do); of the first"
            f" {COMPARED} such scenes the one in which the opponents' paths lie farthest apart."
        ),
        runs=tuple(run.run_id for run in shown),
        notes=(note,) if note else (),
    )


def _chosen(results: Results) -> list[Run]:
    """A run a method, in the order of the methods, all of one scene, planner and seed."""
    groups: dict[tuple[str, int], dict[str, Run]] = defaultdict(dict)
    for run in results.done:
        if run.planner == results.planners[0] and run.recorded:
            groups[run.scene, run.seed].setdefault(run.method, run)
    scenes = [[runs[one] for one in results.methods if one in runs] for runs in groups.values()]
    scenes.sort(key=_rank, reverse=True)
    best = [runs for runs in scenes[:COMPARED] if _rank(runs) == _rank(scenes[0])]
    return max(best, key=_variety, default=[])


def _rank(runs: list[Run]) -> tuple[int, bool, int]:
    """Methods that ran, whether half of them hit, and how many attack the same vehicle."""
    attacks = [run for run in runs if run.attacked]
    return len(runs), 2 * sum(run.hit for run in attacks) >= len(attacks), _same(runs)


def _variety(runs: list[Run]) -> float:
    """How far apart the opponents' paths lie: mean over all pairs, in metres.

    Of two paths it is the mean distance of the points of one to the nearest point of the other, of
    the one for which it is less: a longer piece of the same path is not another path.
    """
    paths = [
        driven(run.rollout, run.rollout.opponent_id)[0]
        for run in runs
        if run.rollout.opponent_id is not None
    ]
    apart = []
    for one, other in itertools.combinations(paths, 2):
        distance = np.hypot(*np.moveaxis(one[:, None] - other, -1, 0))
        apart.append(min(distance.min(axis=0).mean(), distance.min(axis=1).mean()))
    return float(np.mean(apart)) if apart else 0.0


def _same(runs: list[Run]) -> int:
    """How many attack the vehicle that most attack."""
    opponents = [run.result["opponent"] for run in runs if run.attacked]
    return max((opponents.count(one) for one in opponents), default=0)


NATURALNESS: Final = {
    "opponent_rms_acceleration": "rms acceleration, m/s²",
    "acceleration_kl": "KL of accelerations, nat",
}
"""Metrics, and what their axes say. Lower is more natural."""
FEWEST: Final = 5
"""Attacked runs of a method and planner without which a rate says nothing."""


class Point(NamedTuple):
    """A method on a planner: 95 % intervals of the rate and of the mean of a metric."""

    method: str
    rate: Interval
    mean: Difference


def draw_tradeoff(results: Results) -> Sheet | Skipped:
    """One column per planner, one row per measure of naturalness, one marker per method."""
    points = {
        (name, planner): _points(results, planner, name)
        for name in NATURALNESS
        for planner in results.planners
    }
    names = [name for name in NATURALNESS if any(points[name, one] for one in results.planners)]
    planners = [one for one in results.planners if any(points[name, one] for name in names)]
    known = {point.method for row in points.values() for point in row}
    methods = {number: one for number, one in enumerate(results.methods) if one in known}
    if len(methods) < 2:
        return Skipped(
            f"it takes two methods with at least {FEWEST} attacked runs and a known naturalness"
            f" each, and there are {len(methods)}"
        )
    figure, panels = style.charts(len(names), len(planners), len(methods))
    for row, name in enumerate(names):
        for column, planner in enumerate(planners):
            _panel(panels[row, column], points[name, planner], results.methods)
            panels[row, column].set_xlabel(NATURALNESS[name])
            if row == 0:
                panels[row, column].set_title(f"planner {planner}", parse_math=False)
        panels[row, 0].set_ylabel("collision rate")
    style.method_legend(figure, methods, len(planners))
    few = [one for one in results.methods if one not in known]
    return Sheet(
        figure=figure,
        caption=(
            "Share of the attacked runs in which the opponent hit the AV (95 % intervals)"
            " against how the opponent drove (mean over the attacked runs in which it is defined,"
            " 95 % interval); up and to the left is better for the attacker."
            + (f" Without enough attacked runs: {', '.join(few)}." if few else "")
        ),
        runs=(),
    )


def _points(results: Results, planner: str, metric: str) -> list[Point]:
    found = []
    for method in results.methods:
        runs = [
            run
            for run in results.done
            if run.method == method and run.planner == planner and run.attacked
        ]
        values = [(run.scene, value) for run in runs if (value := run.metric(metric)) is not None]
        if min(len(runs), len(values)) >= FEWEST:
            found.append(_point(method, runs, values))
    return found


def _point(method: str, runs: Sequence[Run], values: Sequence[tuple[str, float]]) -> Point:
    hits = statistics.by_unit((run.scene, float(run.hit)) for run in runs)
    return Point(method, statistics.rate(hits), statistics.mean(statistics.by_unit(values)))


def _panel(axes: Axes, points: Sequence[Point], methods: Sequence[str]) -> None:
    for point in points:
        number = methods.index(point.method)
        rate, (mean, low, high) = point.rate, point.mean
        # equal values have no interval
        ends = [[mean - (mean if low is None else low)], [(mean if high is None else high) - mean]]
        axes.errorbar(
            [mean],
            [rate.rate],
            xerr=ends,
            yerr=[[rate.rate - rate.low], [rate.high - rate.rate]],
            elinewidth=0.7,
            **style.method_look(number),
        )
    style.rate_axis(axes)


BUDGETS: Final = {
    "simulations": "simulations a scene",
    "seconds": "seconds a scene",
}

MOST_TICKS: Final = 6


class BudgetPoint(NamedTuple):
    """A method on a planner with a budget; ``own`` where it is the method's own."""

    method: str
    planner: str
    budget: float
    rate: Interval
    own: bool


def draw_budget(results: Results) -> Sheet | Skipped:
    """One column per planner, one row per kind of budget, one line per method."""
    file = results.folders[0] / CURVES
    if not file.is_file():
        return Skipped(f"there is no {CURVES}: the plan has no `curves`")
    rows = read_csv(file)
    points = {kind: _budget_points(rows, kind) for kind in BUDGETS}
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
                _budget_panel(panels[row, column], here, methods)
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
            "Share of the attacked runs in which the opponent hit the AV (95 % intervals)"
            " against the budget of the search; in a ring: the method's own budget."
        ),
    )


def _budget_points(rows: Sequence[dict[str, str]], kind: str) -> list[BudgetPoint]:
    """Rows whose budget is of a kind; without hits and misses there is no rate."""
    found = []
    for row in rows:
        own = row["budget"] == "own"
        budget = row[f"budget_{kind}"] or (
            row.get("simulations", "") if own and kind == "simulations" else ""
        )  # a method's own budget may be a setting of it: then what it spent
        if budget and row["collision_rate"]:
            rate = Interval(*(float(row[f"collision_rate{part}"]) for part in ("", "_lo", "_hi")))
            found.append(BudgetPoint(row["method"], row["planner"], float(budget), rate, own))
    return sorted(found, key=lambda point: point.budget)


def _budget_panel(axes: Axes, points: Sequence[BudgetPoint], methods: dict[int, str]) -> None:
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


def _ticks(points: Sequence[BudgetPoint]) -> list[float]:
    """The budgets, without those whose numbers would touch the last one's."""
    budgets = sorted({point.budget for point in points})
    least = math.log(budgets[-1] / budgets[0]) / MOST_TICKS
    kept = budgets[:1]
    for budget in budgets[1:]:
        if math.log(budget / kept[-1]) >= least:
            kept.append(budget)
    return kept
