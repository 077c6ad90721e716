"""What commands show on the terminal: tables, progress, and the sentences below them.

Imports inside functions: help and short commands load nothing that they do not show.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import rich.progress
from rich import markup
from rich.console import Console
from rich.table import Table

from deepmf_sumo import tables
from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.live.attacker import Attached
    from deepmf_sumo.report.side_by_side import ShownLine, SideBySide
    from deepmf_sumo.report.tables.layouts import TextRow as MethodRow
    from deepmf_sumo.results.findings import Count
    from deepmf_sumo.results.gate.verdict import GateVerdict
    from deepmf_sumo.results.result import Result
    from deepmf_sumo.study.sweep.batch import Progress


def escape(text: str) -> str:
    """Text of others, e.g. an id, as rich prints it: no markup, nothing that acts on a terminal."""
    return markup.escape(shown(text))


def wide(width: int = 160) -> Console:
    """The terminal as wide as it is; pipes and logs, which have no width of their own, so wide."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = width
    return console


def plain_grid(texts: Iterable[str], numbers: Iterable[str] = ()) -> Table:
    """A table: columns of text to the left, of numbers to the right."""
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for heading in texts:
        grid.add_column(escape(heading), overflow="fold")
    for heading in numbers:
        grid.add_column(escape(heading), overflow="fold", justify="right")
    return grid


def filled(headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    """A plain table with rows."""
    grid = plain_grid(headings)
    for row in rows:
        grid.add_row(*map(escape, row))
    return grid


def emit(form: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> None:
    """Print rows as ``json``, ``csv`` or ``md``, for other programs and documents."""
    if form == "json":
        click.echo(json.dumps(rows, indent=1))
        return
    if form == "csv":
        lines = tables.to_csv(rows, columns).splitlines()
    else:
        heads = list(columns or (rows[0] if rows else ()))
        cells = ([tables.cell(row[head]) for head in heads] for row in rows)
        lines = tables.to_markdown(heads, cells)
    for line in lines:
        click.echo(shown(line))


@contextmanager
def progress() -> Iterator[Callable[[Progress], None]]:
    """A bar with the time left on a terminal; elsewhere a line for each run."""
    console = Console(stderr=True, highlight=False)
    begin = time.monotonic()
    bar = rich.progress.Progress(
        rich.progress.TextColumn("{task.description}"),
        rich.progress.BarColumn(),
        rich.progress.MofNCompleteColumn(),
        rich.progress.TimeRemainingColumn(),
        rich.progress.TextColumn("{task.fields[last]}"),
        console=console,
        transient=True,
    )
    shown = bar.add_task("runs", last="")

    def report(now: Progress) -> None:
        if now.again and not (now.last or now.lost):
            console.print(escape(_again(now)), soft_wrap=True)
        for line in _others(now) if not (now.last or now.lost) else ():
            console.print(escape(line), soft_wrap=True)
        for line in now.unwritten:
            console.print(escape(line), soft_wrap=True)
        last = f"{now.last['run_id']}, {_outcome(now.last)}" if now.last else ""
        kept = f" ({now.kept} kept from before)" if now.kept else ""
        lost = f", {now.lost} done again (machine lost)" if now.lost else ""
        if console.is_terminal:
            if not now.last:  # the first report: what is kept from before took no time
                bar.start()
                bar.reset(shown, total=now.of, completed=now.done)
            bar.update(
                shown, completed=now.done, last=escape(last), description=f"runs{kept}{lost}"
            )
        elif now.last:
            left = _left(now, time.monotonic() - begin)
            line = escape(f"{now.done} of {now.of} runs{kept}{lost}{left}; last: {last}")
            console.print(line, soft_wrap=True)

    try:
        yield report
    finally:
        if console.is_terminal:
            bar.stop()


def table(results: Sequence[Result], summary: dict[str, Any], out: Path) -> None:
    """The runs, the totals, and where the files are."""
    from deepmf_sumo.report import table as tables

    console = wide()
    if told := summary["profile"]:
        console.print(escape(told), soft_wrap=True)
    grid = plain_grid(tables.HEADINGS)
    for result, row in zip(results, tables.rows(results), strict=True):
        bad = result["status"] != "ok" or result["expectations_broken"]
        grid.add_row(*map(escape, row), style="red" if bad else "")
    console.print(grid)
    console.print(escape(tables.totals(summary)), soft_wrap=True)
    for told in filter(None, (tables.made_note(results), tables.nobody_note(results))):
        console.print(escape(told), soft_wrap=True)
    for line in tables.meanings(summary):
        console.print(escape(f"  {line}"), soft_wrap=True)
    pictures = any((out / "runs").glob("*/picture.png"))
    shown = f", {out}/runs/<run>/picture.png" if pictures else ""
    console.print(escape(f"{out}/runs.csv{shown}"), soft_wrap=True)


def _again(now: Progress) -> str:
    """Which runs of an earlier sweep are not kept, and why."""
    which = ", ".join(now.changed)
    return (
        f"{now.again} runs that succeeded before are done again: their spec, the version or the"
        f" files that they read have changed{': ' * bool(which)}{which}"
    )


def _others(now: Progress) -> Iterator[str]:
    """What the folder has beside the runs of this command."""
    from deepmf_sumo.report.table import counted

    if now.others:
        yield f"{counted(now.others, 'run')} of earlier commands in the folder: kept in its tables"
    if now.unbegun:
        yield (
            f"{counted(now.unbegun, 'run')} of other specs in the folder: never begun; name these"
            " specs with --resume"
        )
    if now.stale:
        named = ", ".join(now.stale[:3]) + ", ..." * (len(now.stale) > 3)
        yield (
            f"{counted(len(now.stale), 'run')} of earlier commands in the folder: in no table any"
            f" more, since the version or files that they read have changed ({named}); name their"
            " specs with --resume to do them again"
        )


_BEFORE_GUESSING: Final = 5
"""Runs; the first ones wait for their workers to start."""


def _left(now: Progress, seconds: float) -> str:
    """Time left, by the mean of the runs so far."""
    made = now.done - now.kept
    if made < _BEFORE_GUESSING or now.done == now.of:
        return ""
    rest = seconds / made * (now.of - now.done)
    return f", {rest:.0f} s left" if rest < 100 else f", {rest / 60:.0f} min left"


def _outcome(result: Result) -> str:
    return str(result["outcome"] if result["status"] == "ok" else result["status"])


_GAP: Final = 2
_WIDEST_NAME: Final = 30
"""Longer names of folders are folded."""


def show_results(found: SideBySide) -> None:
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


def tell_switched_off(folders: Iterable[Path], *, err: bool) -> None:
    """A line for each time in which a live session could not attack."""
    from deepmf_sumo.results import sessions

    for line in sessions.notes(folders):
        click.echo(shown(line), err=err)


def show_failures(
    rows: Sequence[tuple[str, tuple[str, ...]]], of: int, worth: Count, causes: str
) -> None:
    """The sentence and the cells of each group of failures; ``of``: number of runs.

    ``worth``: of the hits among them. ``causes``: how many distinct ones; empty for none.
    """
    from deepmf_sumo.report.failures import HEADINGS
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results.findings import counted as counted_hits
    from deepmf_sumo.results.findings import legend

    if not rows:
        click.echo(f"no failures in {counted(of, 'run')}")
        return
    console = wide()
    if causes:
        console.print(f"{causes}\n")
    console.print(filled(HEADINGS, [cells for _, cells in rows]))
    console.print()
    for number, (sentence, _) in enumerate(rows, start=1):
        console.print(f"{number}. {escape(sentence)}", soft_wrap=True)
    console.print()
    for line in (f"hits: {counted_hits(worth)}", *(f"  {one}" for one in legend(worth))):
        console.print(escape(line), soft_wrap=True)


def tell_causes(out: Path) -> None:
    """How many distinct causes the findings of a result folder have, and the first of them."""
    from deepmf_sumo.report import failures as words
    from deepmf_sumo.results.failures import failures
    from deepmf_sumo.results.groups import grouped
    from deepmf_sumo.results.reader import Results

    results = Results.open(out)
    found = [one for _, one, _ in failures(results) if one is not None and one.change]
    groups = grouped(found, len(results.runs))
    if not groups:
        return
    console = wide()
    console.print(f"{words.summary(groups)}:")
    for number, group in enumerate(groups[:_MOST_CAUSES], start=1):
        line = f"{number}. {words.sentence(group)} ({len(group.failures)} of {group.of})"
        console.print(escape(line), soft_wrap=True)
    if len(groups) > _MOST_CAUSES:
        console.print(f"the others: deepmf-sumo show {escape(str(out))} --failures", soft_wrap=True)


_MOST_CAUSES: Final = 5


def _fitting(console: Console, found: SideBySide, other: Sequence[ShownLine]) -> int:
    """How many columns the terminal is wide enough for; at least one."""
    lines = [*other, *found.key, *found.more]
    labels = max(len(line.label) for line in lines)
    widest = max(
        *(min(len(name), _WIDEST_NAME) for name in found.names),
        *(len(cell) for line in lines for cell in line.cells),
    )
    return max(1, (console.width - labels) // (widest + _GAP))


def _columns(console: Console, found: SideBySide, other: Sequence[ShownLine], part: slice) -> None:
    """One line for each quantity."""
    grid = plain_grid([""], found.names[part] if len(found.names) > 1 else [""])
    for lines in (other, found.key, found.more):
        for line in lines:
            grid.add_row(escape(line.label), *map(escape, line.cells[part]))
        if lines:
            grid.add_section()
    grid.show_header = len(found.names) > 1
    console.print(grid)


def _rows(console: Console, found: SideBySide, other: Sequence[ShownLine]) -> None:
    """One line for each result, with the most important quantities."""
    grid = plain_grid(
        ["results", *(line.label for line in other)], [one.short for one in found.short]
    )
    for number, name in enumerate(found.names):
        cells = (line.cells[number] for line in (*other, *found.short))
        grid.add_row(escape(name), *map(escape, cells))
    console.print(grid)
    console.print("--all shows all quantities")


def show_verdict(verdict: GateVerdict) -> None:
    """The tables of the Markdown summary, and a sentence for each finding."""
    from deepmf_sumo.results.gate.verdict import (
        LONGEST_LIST,
        comparisons,
        counts,
        own_hits,
        thresholds,
    )

    console = wide()
    console.print(escape(counts(verdict)), soft_wrap=True)
    grid = plain_grid(("group", "threshold", "allowed", "measured", "runs", ""))
    for line in thresholds(verdict):
        _add(grid, line)
    console.print(grid)
    if verdict.comparisons is not None:
        grid = plain_grid(("group", f"against {verdict.baseline}", "was", "is", "difference", ""))
        for line in comparisons(verdict):
            _add(grid, line)
        console.print(grid)
    if verdict.same_attacks and verdict.same_attacks.state != "worse":  # that is a finding
        same = f"{own_hits(verdict.same_attacks)}: {verdict.same_attacks.state}"
        console.print(escape(same), soft_wrap=True)
    for note in verdict.notes:
        console.print(escape(note), soft_wrap=True)
    found = list(verdict.findings())
    for sentence in found[:LONGEST_LIST]:
        console.print(escape(sentence), style="red", soft_wrap=True)
    if len(found) > LONGEST_LIST:
        console.print(f"and {len(found) - LONGEST_LIST} more", style="red")


def _add(grid: Table, cells: tuple[str, ...]) -> None:
    marked = cells[-1].startswith("**")
    plain = (*cells[:-1], cells[-1].strip("*"))
    grid.add_row(*(escape(cell) for cell in plain), style="red" if marked else "")


_ENDS: Final = {
    "until": "left at {time:.1f} s, as asked",
    "attacks": "left at {time:.1f} s, after {attacks}, as asked",
    "av_gone": "{av} left the traffic at {time:.1f} s",
    "simulation_over": "the simulation ended at {time:.1f} s",
    "script_left": "the script left at {time:.1f} s",
    "stopped": "left at {time:.1f} s, stopped",
}
_LIVE_HEADINGS: Final = (
    "",
    "AV",
    "opponent",
    "from s",
    "to s",
    "ended",
    "least gap m",
    "contact m/s",
)


def tell_attack(row: dict[str, Any]) -> None:
    """An attack is over."""
    Console(stderr=True, highlight=False).print(
        escape(
            f"{row['begin_s']:.1f} to {row['end_s']:.1f} s: {row['opponent']} on {row['av']}, "
            f"{row['ended']}, "
            f"least gap {_gap(row, 1)} m"
        ),
        soft_wrap=True,
    )


def tell_switch(change: dict[str, Any]) -> None:
    """New attacks were turned on or off."""
    what = f"new attacks on '{change['av']}' are {change['new_attacks']} ({change['door']})"
    click.echo(shown(f"{change['time_s']:.1f} s: {what}"), err=True)


def tell_jump(jump: dict[str, Any]) -> None:
    """SUMO's time jumped."""
    what = f"the script has loaded a state: from {jump['from_s']:.1f} to {jump['to_s']:.1f} s"
    click.echo(f"{what}; an attack under way is not counted", err=True)


def show_session(done: Attached, avs: Sequence[str], out: Path) -> None:
    """The attacks, why it is over, and where the files are."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results import sessions

    console = wide(120)
    if done.rows:
        grid = Table(box=None, pad_edge=False, header_style="bold")
        for number, heading in enumerate(_LIVE_HEADINGS):
            grid.add_column(heading, justify="left" if number in {1, 2, 5} else "right")
        for row in done.rows:
            grid.add_row(*map(escape, _live_cells(row)), style="red" if row["contact"] else "")
        console.print(grid)
    count = len(done.rows)
    attacks = counted(count, "attack")
    hits = sum(row["contact"] is not None for row in done.rows)
    named = f"vehicle{'s' * (len(avs) > 1)} {', '.join(repr(av) for av in avs)}"
    why = _ENDS[done.end].format(time=done.time_s, attacks=attacks, av=named)
    why_none = f" ({done.last_failure})" if not count and done.last_failure else ""
    if done.undriven:
        why += ", before the attack under way was over, which is not counted"
    file = f"{out}/{'attacks.jsonl' if count else 'session.json'}"
    console.print(
        escape(
            f"profile {done.profile}; {attacks}, {counted(hits, 'contact')}{why_none}; {why};"
            f" {file}"
        ),
        soft_wrap=True,
    )
    for line in sessions.sentences(done.switches):
        console.print(escape(line), soft_wrap=True)
    if not done.watched:
        console.print(
            "whether the script was there to the end cannot be seen from here: attacks after it"
            " left, if any, are counted as attacks on it",
            soft_wrap=True,
        )
    if hits and done.collisions == "teleport":
        console.print(
            "SUMO takes a vehicle away after a collision (collision.action teleport), perhaps the "
            "AV; start it with --collision.action warn to see what happens then",
            soft_wrap=True,
        )


def _gap(row: dict[str, Any], digits: int) -> str:
    gap_m = row["min_gap_m"]
    return "-" if gap_m is None else f"{gap_m:.{digits}f}"


def _live_cells(row: dict[str, Any]) -> list[str]:
    contact = row["contact"]
    return [
        str(row["number"]),
        row["av"],
        row["opponent"],
        f"{row['begin_s']:.1f}",
        f"{row['end_s']:.1f}",
        row["ended"],
        _gap(row, 2),
        "-" if contact is None else f"{contact['relative_mps']:.1f}",
    ]


_FAILURES: Final = 10
"""That are shown with their reason."""


def show_study(out: Path, results: Sequence[Result], expected: int, made: Sequence[Path]) -> None:
    """One line for each method and planner, the runs that failed, and the files."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.report.tables.layouts import read_content
    from deepmf_sumo.results.quantities import COLUMNS
    from deepmf_sumo.results.result import profile
    from deepmf_sumo.spec.profiles import headline

    console = wide()
    if told := headline(map(profile, results)):
        console.print(escape(told), soft_wrap=True)
    more = {one.name: one.short for one in COLUMNS if one.short}
    grid = plain_grid(("planner", "method"), ("hits", "rate, 95 %", *more.values()))
    for row in read_content(out).main:
        if row["runs"] != "0":
            grid.add_row(*map(escape, _study_cells(row, more)))
    console.print(grid)
    statuses = Counter(one["status"] for one in results)
    told = ", ".join(f"{count} {status}" for status, count in statuses.items())
    left = expected - len(results)
    unfinished = f"; {left} not begun: --resume does them" if left else ""
    console.print(escape(f"{counted(len(results), 'run')}: {told}{unfinished}"), soft_wrap=True)
    wrong = [one for one in results if one["status"] != "ok"]
    for one in wrong[:_FAILURES]:
        console.print(escape(f"  {one['run_id']}: {one['error']}"), style="red", soft_wrap=True)
    if len(wrong) > _FAILURES:
        console.print(f"  and {len(wrong) - _FAILURES} more, see runs.csv", style="red")
    files = ", ".join(str(path.relative_to(out)) for path in made if path.suffix != ".svg")
    console.print(escape(f"{out}: runs.csv, table.csv, differences.csv, {files}"), soft_wrap=True)


def _study_cells(row: MethodRow, more: Iterable[str]) -> list[str]:
    rate = "-"
    if row["collision_rate"]:
        share, low, high = (
            f"{100 * float(row[f'collision_rate{end}']):.0f}" for end in ("", "_lo", "_hi")
        )
        rate = f"{share} % ({low}-{high})"
    hits = f"{row['hits']}/{row['attacked']}"
    numbers = [f"{float(row[name]):.2f}" if row[name] else "-" for name in more]
    return [row["planner"], row["method"], hits, rate, *numbers]
