"""Figure 4: generated attacks in several scenes."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

from deepmf_sumo.benchmark.results import Results, Run
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.episode import KEY_IN, draw_episode, key, scale_of, window_of
from deepmf_sumo.report.figures.grid import Grid, frame, shape
from deepmf_sumo.report.figures.sheet import Sheet, Skipped
from deepmf_sumo.report.table import SECTORS

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
    grid = Grid(
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
    ordered = sorted(hits, key=lambda run: not run.clean)
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
