"""Gap, time to collision and speeds of AV and opponent over an episode."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepmf_sumo.benchmark.results import Results
from deepmf_sumo.datatypes import Rollout
from deepmf_sumo.metrics import NotMeasurable, conflict
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.attacks import attacks, caption_of, various
from deepmf_sumo.report.figures.sheet import Sheet, Skipped

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


def draw(results: Results) -> Sheet | Skipped:
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
