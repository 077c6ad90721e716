"""What `benchmark`, `reproduce` and `merge` show: the rates, and where the files are."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.table import Table

from deepmf_sumo.benchmark.quantities import COLUMNS
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.cli.screen.console import escape, wide
from deepmf_sumo.report.table import counted
from deepmf_sumo.report.tables.content import Row as MethodRow
from deepmf_sumo.report.tables.content import read

_SHOWN: Final = {one.name: one.short for one in COLUMNS if one.short}

_FAILURES: Final = 10
"""That are shown with their reason."""


def show(out: Path, results: Sequence[Result], expected: int, made: Sequence[Path]) -> None:
    """A line a method and planner, what did not go through, and the files."""
    console = wide()
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for number, heading in enumerate(("planner", "method", "hits", "rate, 95 %", *_SHOWN.values())):
        grid.add_column(heading, justify="left" if number < 2 else "right")
    for row in read(out).main:
        if row["runs"] != "0":
            grid.add_row(*map(escape, _cells(row)))
    console.print(grid)
    statuses = Counter(one["status"] for one in results)
    told = ", ".join(f"{count} {status}" for status, count in statuses.items())
    left = expected - len(results)
    unfinished = f"; {left} not begun: --resume makes them" if left else ""
    console.print(escape(f"{counted(len(results), 'run')}: {told}{unfinished}"), soft_wrap=True)
    wrong = [one for one in results if one["status"] != "ok"]
    for one in wrong[:_FAILURES]:
        console.print(escape(f"  {one['run_id']}: {one['error']}"), style="red", soft_wrap=True)
    if len(wrong) > _FAILURES:
        console.print(f"  and {len(wrong) - _FAILURES} more, see runs.csv", style="red")
    files = ", ".join(str(path.relative_to(out)) for path in made if path.suffix != ".svg")
    console.print(escape(f"{out}: runs.csv, table.csv, differences.csv, {files}"), soft_wrap=True)


def _cells(row: MethodRow) -> list[str]:
    rate = "-"
    if row["collision_rate"]:
        share, low, high = (
            f"{100 * float(row[f'collision_rate{end}']):.0f}" for end in ("", "_lo", "_hi")
        )
        rate = f"{share} % ({low}-{high})"
    hits = f"{row['hits']}/{row['attacked']}"
    numbers = [f"{float(row[name]):.2f}" if row[name] else "-" for name in _SHOWN]
    return [row["planner"], row["method"], hits, rate, *numbers]
