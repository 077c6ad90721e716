"""Rate against naturalness: how often each method hits, and how its opponents drive for it."""

import math
from collections.abc import Sequence
from statistics import fmean, stdev
from typing import Final, NamedTuple

from matplotlib.axes import Axes

from deepmf_sumo.benchmark.results import Results, Run
from deepmf_sumo.metrics.statistics import Interval, wilson
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.sheet import Sheet, Skipped

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
    mean: float
    half: float


def draw(results: Results) -> Sheet | Skipped:
    """A column a planner, a row a measure of naturalness, a mark a method."""
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
            "Share of the attacked runs in which the opponent hit the AV (Wilson intervals, 95 %)"
            " against how the opponent drove (mean over the attacked runs in which it is defined,"
            " 1.96 standard errors); up and to the left is better for the attacker."
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
        values = [value for run in runs if (value := run.metric(metric)) is not None]
        if min(len(runs), len(values)) >= FEWEST:
            found.append(_point(method, runs, values))
    return found


def _point(method: str, runs: Sequence[Run], values: Sequence[float]) -> Point:
    rate = wilson(sum(run.hit for run in runs), len(runs))
    return Point(method, rate, fmean(values), 1.96 * stdev(values) / math.sqrt(len(values)))


def _panel(axes: Axes, points: Sequence[Point], methods: Sequence[str]) -> None:
    for point in points:
        number = methods.index(point.method)
        rate = point.rate
        axes.errorbar(
            [point.mean],
            [rate.rate],
            xerr=point.half,
            yerr=[[rate.rate - rate.low], [rate.high - rate.rate]],
            elinewidth=0.7,
            **style.method_look(number),
        )
    style.rate_axis(axes)
