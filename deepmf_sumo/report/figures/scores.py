"""Figure 3: how suitable each surrounding vehicle is as an opponent."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from deepmf_sumo.report.drawing import SCORES, Outline, ViewWindow, draw_boxes, draw_road, square
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.attacks import attacks
from deepmf_sumo.report.figures.episode import star
from deepmf_sumo.report.figures.style import PanelGrid, Sheet, Skipped, frame
from deepmf_sumo.results.artifacts import read_scores
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import OpponentScores, Rollout

MOST: Final = 4
COLUMNS: Final = 2
SIDE_M: Final = 70.0
MARGIN_M: Final = 6.0
STRIP_IN: Final = 0.44
FEWEST: Final = 4
"""Scored vehicles that are seen, at least."""

Scored = tuple[Run, dict[str, float], ViewWindow]


def draw(results: Results) -> Sheet | Skipped:
    """Scenes in which the scores differ most."""
    every = _scored(results)
    if not every:
        return Skipped(
            f"no run chose its opponent among at least {FEWEST} scored vehicles within"
            f" {SIDE_M / 2:g} m"
        )
    chosen = sorted(every, key=lambda one: -float(np.std(_seen(one))))[:MOST]
    rows, columns = -(-len(chosen) // COLUMNS), min(COLUMNS, len(chosen))
    grid = PanelGrid(width_in=style.SINGLE_IN, rows=rows, columns=columns, strip_in=STRIP_IN)
    figure, notes = grid.sheet(), []
    for number, ((run, chances, window), letter) in enumerate(
        zip(chosen, style.letters(len(chosen)), strict=True)
    ):
        axes = grid.panel(figure, *divmod(number, columns))
        road, note = run.road()
        notes += [note] if note else []
        draw_road(axes, road, window, grid.panel_in, style.FINE)
        _vehicles(axes, run.rollout, chances, window)
        best = chances.get(run.rollout.opponent_id or "", float("nan"))
        frame(axes, window, f"{letter} opponent's score {best:.2f}")
    _key(figure, grid)
    return Sheet(
        figure=figure,
        caption=(
            "Scores of the surrounding vehicles, from light (0) to dark (1); the AV is blue, the"
            " opponent starred; white: not scored (parked, out of range, no vehicle). Of"
            f" {len(every)} scenes with at least {FEWEST} scored vehicles in view, those whose"
            " scores differ most."
        ),
        runs=tuple(run.run_id for run, _, _ in chosen),
        notes=tuple(notes),
    )


def _scored(results: Results) -> list[Scored]:
    """One run a scene, with the chances of those that are scored."""
    runs = {run.scene: run for run in reversed(attacks(results.done)) if run.recorded}
    found = []
    for run in reversed(runs.values()):
        scores = read_scores(run.folder)
        if scores is None or run.rollout.opponent_id not in scores.ids:
            continue
        one = (run, _chances(run, scores), _window(run.rollout))
        if len(_seen(one)) >= FEWEST:
            found.append(one)
    return found


def _chances(run: Run, scores: OpponentScores) -> dict[str, float]:
    """By the head that chose the opponent."""
    partner = run.result["settings"]["adversary"].get("opponent") == "partner"
    logits = scores.partner_logits if partner else scores.logits
    return dict(zip(scores.ids, (1.0 / (1.0 + np.exp(-logits))).tolist(), strict=True))


def _window(rollout: Rollout) -> ViewWindow:
    """Between AV and opponent, so that both are seen."""
    tracks, now = rollout.tracks, rollout.now
    av = tracks.position_m[tracks.row(rollout.av_id), now]
    other = tracks.position_m[tracks.row(str(rollout.opponent_id)), now]
    apart = float(np.abs(other - av).max()) + 2 * MARGIN_M
    return square((av + other) / 2, max(SIDE_M, apart))


def _seen(one: Scored) -> list[float]:
    """Chances of those whose centre is in view."""
    run, chances, window = one
    tracks, now = run.rollout.tracks, run.rollout.now
    return [
        chance
        for agent, chance in chances.items()
        if np.abs(tracks.position_m[tracks.row(agent), now] - window.centre_m).max()
        < window.side_m / 2
    ]


def _vehicles(axes: Axes, rollout: Rollout, chances: dict[str, float], window: ViewWindow) -> None:
    """Everyone where they were when the opponent was chosen."""
    tracks, now = rollout.tracks, rollout.now
    rows = np.flatnonzero(tracks.valid[:, now])
    colours = {
        row: SCORES(chances[tracks.ids[row]]) if tracks.ids[row] in chances else "white"
        for row in rows
        if tracks.ids[row] != rollout.av_id
    }
    places = [(int(row), now) for row in colours]
    edge = style.OTHER_EDGE
    thin = Outline(edge=edge, zorder=5, edge_pt=0.5)
    draw_boxes(axes, tracks, places, list(colours.values()), window, thin)
    av = [(tracks.row(rollout.av_id), now)]
    draw_boxes(axes, tracks, av, [style.AV], window, Outline(edge="black", zorder=6, edge_pt=0.5))
    opponent = tracks.row(str(rollout.opponent_id))
    star(axes, window.place(tracks.position_m[opponent, now][None]), size_pt=5.0)


def _key(figure: Figure, grid: PanelGrid) -> None:
    axes = grid.axes(figure, 0.15, 0.17, 0.4 * grid.width_in, 0.06)
    ramp = np.linspace(0, 1, 128)[None]
    axes.imshow(ramp, cmap=SCORES, aspect="auto", extent=(0, 1, 0, 1))
    axes.set(yticks=[], xticks=[0, 0.5, 1])
    axes.tick_params(length=1.5, pad=1)
    axes.set_title("opponent score", fontsize=style.SMALLEST_PT, pad=2, loc="left")
    figure.legend(
        [
            Patch(fc=style.AV, ec="black", lw=0.5),
            style.star_mark(),
            Patch(fc="white", ec=style.OTHER_EDGE),
        ],
        ["AV", "opponent", "not scored"],
        loc="lower right",
        ncols=2,
        frameon=False,
        handlelength=1.2,
        handletextpad=0.4,
        columnspacing=1.0,
        borderpad=0.1,
        labelspacing=0.2,
    )
