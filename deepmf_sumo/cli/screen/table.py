"""What `table` shows: a line a quantity, or where there are many results a line a result."""

from collections.abc import Iterable, Sequence
from typing import Final

from rich.console import Console
from rich.table import Table

from deepmf_sumo.cli.screen.console import escape, wide
from deepmf_sumo.report.side_by_side import Line, SideBySide

_GAP: Final = 2
_WIDEST_NAME: Final = 30
"""Longer names of folders are folded."""


def show(found: SideBySide) -> None:
    """The table, and why some quantities have no value in some runs."""
    console = wide()
    if not found.names:
        console.print("no runs")
        return
    same = [line for line in found.about if len(found.names) == 1 or len(set(line.cells)) == 1]
    told = ", ".join(f"{line.label} {line.cells[0]}" for line in same)
    if told:
        head = f"{found.names[0]}: " if len(found.names) == 1 else ""
        console.print(escape(f"{head}{told}"), soft_wrap=True)
    other = [line for line in found.about if line not in same]
    fits = _fitting(console, found, other)
    if fits < len(found.names) and not found.more:
        _rows(console, found, other)
    else:
        for first in range(0, len(found.names), fits):
            _columns(console, found, other, slice(first, first + fits))
    if found.missing:
        console.print("Attacked runs that have no value, and are left out of the mean:")
        for sentence in found.missing:
            console.print(escape(f"  {sentence}"), soft_wrap=True)


def _fitting(console: Console, found: SideBySide, other: Sequence[Line]) -> int:
    """How many columns the terminal is wide enough for; at least one."""
    lines = [*other, *found.key, *found.more]
    labels = max(len(line.label) for line in lines)
    widest = max(
        *(min(len(name), _WIDEST_NAME) for name in found.names),
        *(len(cell) for line in lines for cell in line.cells),
    )
    return max(1, (console.width - labels) // (widest + _GAP))


def _columns(console: Console, found: SideBySide, other: Sequence[Line], part: slice) -> None:
    """A line a quantity."""
    grid = _grid([""], found.names[part] if len(found.names) > 1 else [""])
    for lines in (other, found.key, found.more):
        for line in lines:
            grid.add_row(escape(line.label), *map(escape, line.cells[part]))
        if lines:
            grid.add_section()
    grid.show_header = len(found.names) > 1
    console.print(grid)


def _rows(console: Console, found: SideBySide, other: Sequence[Line]) -> None:
    """A line a result, with the most important quantities."""
    grid = _grid(["results", *(line.label for line in other)], [one.short for one in found.short])
    for number, name in enumerate(found.names):
        cells = (line.cells[number] for line in (*other, *found.short))
        grid.add_row(escape(name), *map(escape, cells))
    console.print(grid)
    console.print("--all shows all quantities")


def _grid(texts: Iterable[str], numbers: Iterable[str]) -> Table:
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for heading in texts:
        grid.add_column(escape(heading), overflow="fold")
    for heading in numbers:
        grid.add_column(escape(heading), overflow="fold", justify="right")
    return grid
