"""What `check` shows: a line a threshold and comparison, and what is wrong."""

from rich.table import Table

from deepmf_sumo.benchmark.gate import Verdict, summary
from deepmf_sumo.cli.screen.console import escape, wide


def show(verdict: Verdict) -> None:
    """The tables of the Markdown summary, and a sentence for each finding."""
    console = wide()
    console.print(escape(summary.counts(list(verdict.results.rows.values()))), soft_wrap=True)
    grid = _grid("group", "threshold", "allowed", "measured", "runs", "")
    for cells in summary.thresholds(verdict):
        _add(grid, cells)
    console.print(grid)
    if verdict.comparisons is not None:
        grid = _grid("group", f"against {verdict.baseline}", "was", "is", "difference", "")
        for cells in summary.comparisons(verdict):
            _add(grid, cells)
        console.print(grid)
    for note in verdict.notes:
        console.print(escape(note), soft_wrap=True)
    found = list(verdict.findings())
    for sentence in found[: summary.LONGEST_LIST]:
        console.print(escape(sentence), style="red", soft_wrap=True)
    if len(found) > summary.LONGEST_LIST:
        console.print(f"and {len(found) - summary.LONGEST_LIST} more", style="red")


def _grid(*headings: str) -> Table:
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        grid.add_column(escape(heading), overflow="fold")
    return grid


def _add(grid: Table, cells: tuple[str, ...]) -> None:
    marked = cells[-1].startswith("**")
    plain = (*cells[:-1], cells[-1].strip("*"))
    grid.add_row(*(escape(cell) for cell in plain), style="red" if marked else "")
