"""What `ablate` shows: its notes and its table."""

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from deepmf_sumo.benchmark.ablation import Row as VariantRow
from deepmf_sumo.benchmark.ablation import cells, headings
from deepmf_sumo.cli.screen.console import escape, wide


def show(notes: Sequence[str], rows: Sequence[VariantRow], out: Path) -> None:
    """The table as in ``ablation.md``."""
    console = wide(240)
    for note in notes:
        console.print(escape(note), soft_wrap=True)
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for number, heading in enumerate(headings([one.planner for one in rows[0].attacks])):
        grid.add_column(heading, justify="left" if number < 2 else "right")
    for row in rows:
        grid.add_row(*map(escape, cells(row)))
    console.print(grid)
    console.print(escape(f"{out}/ablation.csv, {out}/ablation.md"), soft_wrap=True)
