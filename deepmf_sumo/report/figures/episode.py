"""One episode in a panel: both paths coloured by time, a box a second, and the contact."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure

from deepmf_sumo.report.drawing import Outline, ViewWindow, draw_boxes, draw_road, met_at, square
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.style import PanelGrid
from deepmf_sumo.report.palette import STAR
from deepmf_sumo.results.reader import Run
from deepmf_sumo.scene import AgentId, Floats, Ints, RoadMap, Rollout

MARGIN_M: Final = 8.0
SMALLEST_M: Final = 36.0
LARGEST_M: Final = 90.0
KEY_IN: Final = 0.44
"""Height of the key."""
SECOND: Final = 10
"""Steps."""


def draw_episode(
    axes: Axes, run: Run, road: RoadMap, window: ViewWindow, inches: float, seconds: float
) -> None:
    """Draw what the window shows of a run; ``seconds`` is the end of the scale of time."""
    rollout = run.rollout
    draw_road(axes, road, window, inches, style.FINE)
    _others(axes, rollout, window)
    scale = Normalize(0.0, seconds)
    agents = [(rollout.av_id, style.AV_TIME), (rollout.opponent_id, style.OPPONENT_TIME)]
    for agent, colours in agents:
        if agent in rollout.tracks.ids:
            _driven(axes, rollout, str(agent), window, colours, scale)
    if rollout.opponent_id in rollout.tracks.ids:
        star(axes, window.place(driven(rollout, str(rollout.opponent_id))[0][:1]))
    if run.contact:
        met = window.place(met_at(rollout.tracks, run.contact))
        axes.plot(*met, marker="x", color="white", ms=6, mew=2.4, zorder=15)
        axes.plot(*met, marker="x", color="black", ms=5, mew=1.2, zorder=16)


def driven(rollout: Rollout, agent: AgentId) -> tuple[Floats, Ints]:
    """Where an agent was from the current step on, (K, 2), and the steps, (K)."""
    row = rollout.tracks.row(agent)
    steps = np.flatnonzero(rollout.tracks.valid[row])
    after = steps[steps >= rollout.now]
    steps = after if len(after) else steps[-1:]
    position: Floats = rollout.tracks.position_m[row, steps]
    return position, steps


def window_of(runs: Sequence[Run]) -> ViewWindow:
    """A square around what AV and opponent drove in all the runs.

    Where that is more than `LARGEST_M` wide, the part around the first run's contact (or around
    the places where the two came closest).
    """
    paths = [
        driven(run.rollout, agent)[0]
        for run in runs
        for agent in (run.rollout.av_id, run.rollout.opponent_id)
        if agent is not None and agent in run.rollout.tracks.ids
    ]
    every = np.concatenate(paths)
    low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    side = float(np.clip((high - low).max(), SMALLEST_M, LARGEST_M))
    if (high - low).max() <= LARGEST_M:
        return square((low + high) / 2, side)
    met = next((run for run in runs if run.contact), runs[0])
    return square(_within(met, side), side)


def _within(run: Run, side_m: float) -> Floats:
    """(2,) centre such that the contact is seen, and as much of the way there as possible."""
    rollout = run.rollout
    path = driven(rollout, rollout.av_id)[0]
    end = run.contact.pose_first[:2] if run.contact else _nearest(rollout)
    back = path[np.abs(path - end).max(axis=1) < side_m / 2 - MARGIN_M]
    reach = np.concatenate([back, end[None]])
    centre: Floats = (reach.min(axis=0) + reach.max(axis=0)) / 2
    return centre


def _nearest(rollout: Rollout) -> Floats:
    """(2,) where the AV was when the opponent was nearest; without one, where it ended."""
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    if rollout.opponent_id in tracks.ids:
        other = tracks.row(str(rollout.opponent_id))
        both = np.flatnonzero(tracks.valid[av] & tracks.valid[other])
        both = both[both >= rollout.now]
        if len(both):
            apart = tracks.position_m[av, both] - tracks.position_m[other, both]
            here: Floats = tracks.position_m[av, both[np.hypot(*apart.T).argmin()]]
            return here
    end: Floats = driven(rollout, rollout.av_id)[0][-1]
    return end


def _others(axes: Axes, rollout: Rollout, window: ViewWindow) -> None:
    """Everyone else where they were at the end."""
    tracks, end = rollout.tracks, rollout.tracks.steps - 1
    main = {rollout.av_id, rollout.opponent_id}
    places = [
        (row, end)
        for row, agent in enumerate(tracks.ids)
        if agent not in main and tracks.valid[row, end]
    ]
    grey = [style.OTHER] * len(places)
    edge = style.OTHER_EDGE
    draw_boxes(axes, tracks, places, grey, window, Outline(edge=edge, zorder=4, edge_pt=0.4))


def _driven(
    axes: Axes,
    rollout: Rollout,
    agent: AgentId,
    window: ViewWindow,
    colours: Colormap,
    scale: Normalize,
) -> None:
    tracks, row = rollout.tracks, rollout.tracks.row(agent)
    path, steps = driven(rollout, agent)
    path, times = window.place(path), (steps - rollout.now) * rollout.dt_s
    pieces = np.stack([path[:-1], path[1:]], axis=1)
    edge = style.AV if agent == rollout.av_id else style.OPPONENT
    axes.add_collection(
        LineCollection(
            list(pieces), colors=colours(scale(times[1:])), linewidths=1.8, capstyle="round",
            zorder=6,
        )
    )  # fmt: skip
    seconds = list(range(0, len(steps) - 1, SECOND))
    faint = [(row, int(steps[number])) for number in seconds]
    fill = colours(scale(times[seconds]))
    faded = Outline(edge=edge, zorder=7, alpha=0.45, edge_pt=0.4)
    draw_boxes(axes, tracks, faint, fill, window, faded)
    last, dark = [(row, int(steps[-1]))], colours(scale(times[-1:]))
    draw_boxes(axes, tracks, last, dark, window, Outline(edge="black", zorder=9, edge_pt=0.7))


def star(axes: Axes, placed_m: Floats, size_pt: float = 7.0) -> None:
    """The opponent's mark, (1, 2) where it is drawn."""
    edge, width = "black", 0.07 * size_pt
    axes.plot(*placed_m.T, marker="*", color=STAR, mec=edge, mew=width, ms=size_pt, zorder=17)


def key(figure: Figure, grid: PanelGrid, seconds: float) -> None:
    """Two scales of time and the marks, at the foot of the sheet; takes `KEY_IN`."""
    unit = grid.width_in / 24
    colours = {"AV, s": style.AV_TIME, "opponent, s": style.OPPONENT_TIME}
    for left, (name, colour) in zip((unit, 9 * unit), colours.items(), strict=True):
        axes = grid.axes(figure, left, 0.17, 6 * unit, 0.06)
        ramp = np.linspace(0, 1, 128)[None]
        axes.imshow(ramp, cmap=colour, aspect="auto", extent=(0, seconds, 0, 1))
        axes.set(yticks=[], xticks=np.arange(0, seconds + 0.01, 2))
        axes.tick_params(length=1.5, pad=1)
        axes.set_title(name, fontsize=style.SMALLEST_PT, pad=2, loc="left")
    figure.legend(
        [style.star_mark(), style.contact_mark()],
        ["opponent", "contact"],
        loc="lower left",
        bbox_to_anchor=(16.6 / 24, 0.02 / grid.height_in),
        frameon=False,
        handletextpad=0.2,
        borderpad=0.1,
        labelspacing=0.2,
    )


def scale_of(runs: Sequence[Run]) -> float:
    """Seconds that the scale of time covers: the longest run's, up to the next even number."""
    longest = max(run.rollout.tracks.steps - 1 - run.rollout.now for run in runs)
    dt_s = runs[0].rollout.dt_s
    return 2.0 * max(1.0, float(np.ceil(round(longest * dt_s / 2.0, 6))))
