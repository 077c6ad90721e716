"""Figure 5: the eight sides from which the AV is hit, around a dial that counts them."""

from collections import Counter
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Wedge

from deepmf_sumo.report.drawing import ViewWindow, met_at, square
from deepmf_sumo.report.figures import style
from deepmf_sumo.report.figures.attacks import names, of_deepmf
from deepmf_sumo.report.figures.episode import KEY_IN, draw_episode, key, scale_of
from deepmf_sumo.report.figures.style import PanelGrid, Sheet, Skipped, frame
from deepmf_sumo.report.table import SECTORS
from deepmf_sumo.results.reader import Results, Run

SIDE_M: Final = 30.0
PLACES: Final = ((0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2))
"""Row and column of each sector's panel: the AV drives up the page."""


def draw(results: Results) -> Sheet | Skipped:
    """One hit for each sector, seen from the AV at the contact."""
    runs = of_deepmf((*results.steered, *results.done))
    hits = [run for run in runs if run.hit and run.recorded]
    if not hits:
        return Skipped("no run hit the AV")
    free = [run for run in hits if run.asked_sector is None]
    there = {run.sector for run in hits}
    chosen = {sector: _best(hits, sector) for sector in range(len(SECTORS)) if sector in there}
    grid = PanelGrid(width_in=style.SINGLE_IN, rows=3, columns=3, title_lines=2, strip_in=KEY_IN)
    figure, notes = grid.sheet(), []
    seconds = scale_of(list(chosen.values()))
    for sector, (row, column) in enumerate(PLACES):
        axes = grid.panel(figure, row, column)
        if sector not in chosen:
            _absent(axes, sector, len(hits))
            continue
        run = chosen[sector]
        road, note = run.road()
        notes += [note] if note else []
        window = _from_av(run)
        draw_episode(axes, run, road, window, grid.panel_in, seconds)
        asked = "asked for" if run.asked_sector == sector else ""
        below = ", ".join(filter(None, [run.accident, asked]))
        frame(axes, window, f"{SECTORS[sector]}\n{below}".rstrip())
    _dial(grid.panel(figure, 1, 1), Counter(run.sector for run in free))
    key(figure, grid, seconds)
    return Sheet(
        figure=figure,
        caption=(
            "Where the AV is hit, the AV driving up the page at the contact: one hit a sector of"
            " 45 degrees, with the kind of accident, and whether the attack was asked for it; in"
            f" the middle how many of the {len(free)} hits that were asked for no sector each had."
            f" By {names(hits)}."
            + "".join(f" No hit on the {SECTORS[one]}." for one in range(8) if one not in chosen)
        ),
        runs=tuple(run.run_id for run in chosen.values()),
        notes=tuple(notes),
    )


def _best(hits: list[Run], sector: int) -> Run:
    """The one that asked for the sector, did nothing wrong, and was the fastest, in this order."""
    there = [run for run in hits if run.sector == sector]

    def rank(run: Run) -> tuple[int, bool, float]:
        wish = {sector: 0, None: 1}.get(run.asked_sector, 2)
        return wish, not run.finding, -(run.metric("collision_speed") or 0.0)

    return min(there, key=rank)


def _from_av(run: Run) -> ViewWindow:
    """A square around the contact, turned so that the AV drives up."""
    contact = run.contact
    assert contact is not None
    middle = met_at(run.rollout.tracks, contact)
    return square(middle, SIDE_M, turn_rad=float(np.pi / 2 - contact.pose_first[2]))


def _absent(axes: Axes, sector: int, hits: int) -> None:
    axes.set(xticks=[], yticks=[])
    axes.set_title(SECTORS[sector], pad=2.0, fontsize=style.SMALLEST_PT)
    axes.text(0.5, 0.5, f"none of\n{hits} hits", ha="center", va="center", color="#555555")
    axes.set_aspect("equal")
    axes.axis("off")


def _dial(axes: Axes, counts: Counter[int | None]) -> None:
    """The sectors around the AV, darker the more often they were hit."""
    most = max(counts.values(), default=1)
    for sector in range(len(SECTORS)):
        middle = 90.0 + 45.0 * sector
        shade = style.AV_TIME(counts[sector] / most) if counts[sector] else "white"
        axes.add_patch(
            Wedge(
                (0, 0), 1.0, middle - 22.5, middle + 22.5, width=0.62, fc=shade, ec="black", lw=0.4
            )
        )
        angle = np.radians(middle)
        dark = counts[sector] > 0.3 * most
        axes.text(
            0.69 * np.cos(angle), 0.69 * np.sin(angle), str(counts[sector]), ha="center",
            va="center", color="white" if dark else "black",
        )  # fmt: skip
    axes.fill([-0.11, 0.11, 0.11, 0, -0.11], [-0.27, -0.27, 0.17, 0.27, 0.17], color=style.AV)
    axes.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), xticks=[], yticks=[], aspect="equal")
    axes.set_title("hits, unasked", pad=2.0, fontsize=style.SMALLEST_PT)
    axes.axis("off")
