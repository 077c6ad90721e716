"""What `run` shows: a live line while it works, a table at the end."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from deepmf_sumo.benchmark.batch import Progress
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.cli.screen.console import escape, wide
from deepmf_sumo.report import table as tables


@contextmanager
def progress() -> Iterator[Callable[[Progress], None]]:
    """A line that is written over on a terminal; elsewhere a line a run."""
    console = Console(stderr=True, highlight=False)
    begin = time.monotonic()
    with console.status("reading specs ...") as status:

        def report(now: Progress) -> None:
            if now.again and not (now.last or now.lost):
                console.print(escape(_again(now)), soft_wrap=True)
            last = f"; last: {now.last['run_id']}, {_outcome(now.last)}" if now.last else ""
            kept = f" ({now.kept} kept from before)" if now.kept else ""
            lost = f", {now.lost} done again (machine lost)" if now.lost else ""
            left = _left(now, time.monotonic() - begin)
            line = escape(f"{now.done} of {now.of} runs{kept}{lost}{left}{last}")
            status.update(line)
            if now.last and not console.is_terminal:
                console.print(line, soft_wrap=True)

        yield report


def table(results: Sequence[Result], summary: dict[str, Any], out: Path) -> None:
    """The runs, the totals, and where the files are."""
    console = wide()
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for heading in tables.HEADINGS:
        grid.add_column(heading, overflow="fold")
    for result, row in zip(results, tables.rows(results), strict=True):
        bad = result["status"] != "ok" or result["expectations_broken"]
        grid.add_row(*map(escape, row), style="red" if bad else "")
    console.print(grid)
    console.print(escape(tables.totals(summary)), soft_wrap=True)
    pictures = any((out / "runs").glob("*/picture.png"))
    shown = f", {out}/runs/<run>/picture.png" if pictures else ""
    console.print(escape(f"{out}/runs.csv{shown}"), soft_wrap=True)


def _again(now: Progress) -> str:
    """Which runs of an earlier sweep are not kept, and why."""
    which = ", ".join(now.changed)
    return (
        f"{now.again} of the runs that went through before are done again, for their spec, the"
        f" version or files that they read are not what they were{': ' * bool(which)}{which}"
    )


def _left(now: Progress, seconds: float) -> str:
    """Time left, by the mean of the runs so far."""
    made = now.done - now.kept
    if not made or now.done == now.of:
        return ""
    rest = seconds / made * (now.of - now.done)
    return f", {rest:.0f} s left" if rest < 100 else f", {rest / 60:.0f} min left"


def _outcome(result: Result) -> str:
    return str(result["outcome"] if result["status"] == "ok" else result["status"])
