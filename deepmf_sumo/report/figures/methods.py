"""Figure 6: what every method makes of the same scene, in the same frame."""

import itertools
from collections import defaultdict
from typing import Final

import numpy as np

from deepmf_sumo.benchmark.results import Results, Run
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
from deepmf_sumo.report.figures.grid import Grid, frame, shape
from deepmf_sumo.report.figures.sheet import Sheet, Skipped

COMPARED: Final = 12
"""Scenes whose paths are compared."""


def draw(results: Results) -> Sheet | Skipped:
    """The first planner's scene in which the methods do the most different things."""
    if len(results.methods) < 2:
        return Skipped("there is one method alone")
    shown = _chosen(results)
    if len(shown) < 2:
        return Skipped("no scene was attacked by two methods")
    rows, columns = shape(len(shown))
    grid = Grid(
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
    the one for which it is less: a path that goes on farther on the same way is no other path.
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
