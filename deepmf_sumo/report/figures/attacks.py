"""Figure 4: generated attacks in several scenes."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepmf_sumo.judge.metrics import NotMeasurable, conflict
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.episode import KEY_IN, draw_episode, key, scale_of, window_of
from deepmf_sumo.report.figures.style import PanelGrid, Sheet, Skipped, frame, shape
from deepmf_sumo.report.table import SECTORS
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import Rollout

MOST: Final = 8
FEW: Final = 4
"""Methods that a caption names."""


def draw(results: Results) -> Sheet | Skipped:
    """Hits in scenes that differ in where the AV is hit."""
    hits = [run for run in attacks(results.done) if run.hit and run.recorded]
    chosen = various(hits)[:MOST]
    if not chosen:
        return Skipped("no run hit the AV")
    rows, columns = shape(len(chosen))
    grid = PanelGrid(
        width_in=style.DOUBLE_IN if columns > 2 else style.SINGLE_IN, rows=rows, columns=columns,
        title_lines=1, strip_in=KEY_IN,
    )  # fmt: skip
    figure, notes = grid.sheet(), []
    seconds = scale_of(chosen)
    for number, (run, letter) in enumerate(zip(chosen, style.letters(len(chosen)), strict=True)):
        axes = grid.panel(figure, *divmod(number, columns))
        road, note = run.road()
        notes += [note] if note else []
        window = window_of([run])
        draw_episode(axes, run, road, window, grid.panel_in, seconds)
        frame(axes, window, f"{letter} {caption_of(run)}")
    key(figure, grid, seconds)
    return Sheet(
        figure=figure,
        caption=(
            "Attacks that hit: AV (blue) and opponent (orange, starred at the start), darker with"
            " time, a box a second; the others (grey) where they were at the contact (cross)."
            " Above: where the AV is hit, when, at what relative speed. Of"
            f" {len({run.scene for run in hits})} scenes with a hit by {names(hits)}, chosen so"
            " that the sides on which the AV is hit differ."
        ),
        runs=tuple(run.run_id for run in chosen),
        notes=tuple(notes),
    )


def attacks(runs: Sequence[Run]) -> list[Run]:
    """The runs of the paper's method: DeepMF's S1, else all of DeepMF, else all that attack.

    Attacks that were asked for a side are left out where there are others. Of methods that attack
    the same scenes the first alone is taken.
    """
    ours = of_deepmf(runs)
    found = [run for run in ours if run.version == "S1"] or ours
    found = [run for run in found if run.asked_sector is None] or found
    first: dict[str, str] = {}
    for run in found:
        first.setdefault(run.scene, run.method)
    methods = set(first.values())
    return [run for run in found if run.method in methods]


def of_deepmf(runs: Sequence[Run]) -> list[Run]:
    """All runs of DeepMF; without any, all that attack."""
    ours = [run for run in runs if run.adversary == "deepmf"]
    return ours or [run for run in runs if run.adversary != "none"]


def various(hits: Sequence[Run]) -> list[Run]:
    """One run a scene, by turns of the side on which the AV is hit; whole hits come first."""
    ordered = sorted(hits, key=lambda run: not run.finding)
    scenes = {run.scene: run for run in reversed(ordered)}
    by_sector: dict[int | None, list[Run]] = defaultdict(list)
    for run in ordered:
        if scenes[run.scene] is run:
            by_sector[run.sector].append(run)
    turns = [
        (turn, sector or 0, run)
        for sector, queue in by_sector.items()
        for turn, run in enumerate(queue)
    ]
    return [run for _, _, run in sorted(turns, key=lambda one: one[:2])]


def caption_of(run: Run) -> str:
    """When and where the AV was hit."""
    contact = run.contact
    if contact is None:
        return "no contact of the AV"
    time_s = (contact.step - run.rollout.now) * run.rollout.dt_s
    where = SECTORS[contact.sector] if run.hit else "hit another"
    return f"{where}, {time_s:.1f} s, {contact.relative_mps:.1f} m/s"


def names(runs: Sequence[Run]) -> str:
    """Methods (where they are few) and planners of runs."""
    methods = list(dict.fromkeys(run.method for run in runs))
    planners = ", ".join(dict.fromkeys(run.planner for run in runs))
    named = ", ".join(methods) if len(methods) <= FEW else f"{len(methods)} methods"
    return f"{named} (planner {planners})"


LONGEST_S: Final = 10.0
"""Times to collision above this are not drawn."""


def write_timelines(rollout: Rollout, stem: Path, title: str = "") -> list[Path]:
    """Write ``stem.png`` and ``stem.svg``. Raises ValueError where there was no opponent."""
    with style.printed():
        return style.save(timelines(rollout, title), stem)


def timelines(rollout: Rollout, title: str = "") -> Figure:
    """Three charts over the time since the simulation took over, contacts marked.

    Where AV and opponent are on no collision course, time to collision has no line. Raises
    ValueError where there was no opponent.
    """
    try:
        found = conflict.over_time(rollout)
    except NotMeasurable as reason:
        raise ValueError(f"no timelines of AV and opponent: {reason}") from None
    times, tracks = found.time_s, rollout.tracks
    av, other = tracks.row(rollout.av_id), tracks.row(str(rollout.opponent_id))
    figure = style.sheet(style.SINGLE_IN, 2.9)
    figure.set_layout_engine("constrained")
    charts = figure.subplots(3, 1, sharex=True)
    charts[0].plot(times, found.gap_m, color="black", lw=1.2)
    charts[0].set_ylabel("gap, m")
    ttc = np.where(found.ttc_s <= LONGEST_S, found.ttc_s, np.nan)
    charts[1].plot(times, ttc, color="black", lw=1.2, marker=".", ms=2)
    charts[1].set(ylabel="TTC, s", ylim=(-0.4, LONGEST_S))
    looks = {"AV": (av, style.AV, "-"), "opponent": (other, style.OPPONENT, "--")}
    for name, (row, colour, dash) in looks.items():
        charts[2].plot(
            times, tracks.speed_mps[row, found.step], color=colour, ls=dash, lw=1.3, label=name
        )
    charts[2].set(ylabel="speed, m/s", xlabel="time, s", ylim=(0, None))
    charts[2].legend(frameon=False, ncols=2, loc="best", handlelength=2.2)
    charts[0].set(xlim=(0, max(float(times[-1]), rollout.dt_s) * 1.02), ylim=(0, None))
    if title:
        charts[0].set_title(title, parse_math=False)
    _contacts(rollout, charts)
    return figure


def _contacts(rollout: Rollout, charts: Sequence[Axes]) -> None:
    """A line a contact: full for AV and opponent, dotted for others."""
    for contact in rollout.contacts:
        dash = "-" if contact.kind == "av_opponent" else ":"
        for axes in charts:
            time_s = (contact.step - rollout.now) * rollout.dt_s
            axes.axvline(time_s, color="#7f7f7f", ls=dash, lw=0.8, zorder=0)


def draw_timelines(results: Results) -> Sheet | Skipped:
    """The run that is panel (a) of the attacks."""
    hits = [run for run in attacks(results.done) if run.hit and run.recorded]
    if not hits:
        return Skipped("no run hit the AV")
    run = various(hits)[0]
    return Sheet(
        figure=timelines(run.rollout, f"AV hit: {caption_of(run)}"),
        caption=(
            "Gap between the boxes, time to collision at constant velocities (no line: no collision"
            f" course, or more than {LONGEST_S:g} s) and speeds, of panel (a) of figure 4."
        ),
        runs=(run.run_id,),
    )
