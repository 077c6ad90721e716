"""``deepmf-sumo screen``: what is wrong with a network by the book, before it is run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from deepmf_sumo.cli._parameters import RESULTS, format_option
from deepmf_sumo.errors import EXIT_CODES, OutputError
from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.roadcheck.screening import Guideline, Screened, Severity

FILE: Final = "screen.csv"
_TOP: Final = 30
_STYLES: Final = {"error": "red", "warning": ""}


@click.command("screen", short_help="Check a network against a design guideline (no simulation).")
@click.argument("file", metavar="NET", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--guideline", type=click.Choice(["rilsa", "ite"]), default="rilsa", show_default=True,
    help="Judge by this guideline: Germany's RiLSA, or ITE's formula.",
)  # fmt: skip
@click.option(
    "--out", metavar="FOLDER", type=click.Path(file_okay=False, path_type=Path),
    help="Write screen.csv into this folder.",
)  # fmt: skip
@click.option(
    "--beside", "results", metavar="OUT", type=RESULTS,
    help="Show the attacks of this result folder at the same junctions.",
)  # fmt: skip
@click.option(
    "--fail-on", type=click.Choice(["error", "warning"]),
    help="End with exit code 1 where there are findings of at least this severity.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace the table that the folder has.")
@format_option
@click.pass_context
def command(
    ctx: click.Context,
    file: Path,
    guideline: str,
    out: Path | None,
    results: Path | None,
    fail_on: "Severity | None",
    overwrite: bool,
    form: str,
) -> None:
    """Check NET, a .net.xml or .sumocfg, against a guideline; nothing is simulated.

    Yellow and intergreen times, conflicting greens, left turns through gaps, junctions without
    a rule of priority, missing links, merges, steps of the limit, tight turns: one sentence for
    each rule and junction, the worst first, and what could not be judged.

    \b
    Exit codes: 0 NET was screened; 1 with --fail-on: there are findings of at
    least that severity; 2 the command or NET is wrong.
    """
    from deepmf_sumo.cli import _screen as terminal
    from deepmf_sumo.roadcheck import screening

    _refuse(out, overwrite)
    book = screening.GUIDELINES[guideline]
    found = screening.screen(file, book)
    risk = screening.beside(results, found) if results else None
    rows = screening.columns(found.findings, risk)
    named = (*screening.COLUMNS, *(screening.BESIDE if risk is not None else ()))
    if out is not None:
        _write(out, rows, named)
    if form == "table":
        _show(file.name, book, found, rows, beside=risk is not None)
        if out is not None:
            click.echo(shown(f"{out}/{FILE}"))
    else:
        terminal.emit(form, rows, named)
        for line in _not_judged(found):
            click.echo(f"deepmf-sumo: {shown(line)}", err=True)
    if fail_on and screening.at_least(found.findings, fail_on):
        ctx.exit(EXIT_CODES["broken"])


def _refuse(out: Path | None, overwrite: bool) -> None:
    if out is not None and (out / FILE).exists() and not overwrite:
        raise OutputError(
            f"{out / FILE} is there already: give --overwrite to replace it, or another --out."
        )


def _write(out: Path, rows: Sequence[Mapping[str, Any]], named: Sequence[str]) -> None:
    from deepmf_sumo import files, tables

    with files.writing(out):
        out.mkdir(parents=True, exist_ok=True)
        files.write(out / FILE, tables.to_csv(rows, named))


def _show(
    name: str,
    book: "Guideline",
    found: "Screened",
    rows: Sequence[Mapping[str, Any]],
    *,
    beside: bool,
) -> None:
    """Counts, the worst findings, and what was not judged."""
    from deepmf_sumo.cli import _screen as terminal
    from deepmf_sumo.report.table import counted

    console = terminal.wide()
    kinds = ", ".join(
        counted(sum(row["severity"] == kind for row in rows), kind) for kind in _STYLES
    )
    looked = f"{counted(found.movements, 'movement')}, {counted(found.programs, 'signal program')}"
    console.print(terminal.escape(f"{name}, by {book.title}: {kinds} ({looked})"), soft_wrap=True)
    if rows:
        numbers = ("attacks", "hits", "risk of a hit") if beside else ()
        grid = terminal.plain_grid(("severity", "rule", "finding"), numbers)
        for row in rows[:_TOP]:
            cells = (row["severity"], row["rule"], row["finding"], *_risk(row, beside=beside))
            grid.add_row(*map(terminal.escape, cells), style=_STYLES[row["severity"]])
        console.print(grid)
    if len(rows) > _TOP:
        console.print(f"and {len(rows) - _TOP} more with --out or --format")
    for line in _not_judged(found):
        console.print(terminal.escape(line), soft_wrap=True)


def _risk(row: Mapping[str, Any], *, beside: bool) -> tuple[str, ...]:
    if not beside:
        return ()
    risk = row["risk_hit"]
    return str(row["attacks"]), str(row["hits"]), "-" if risk is None else f"{100 * risk:.0f} %"


def _not_judged(found: "Screened") -> list[str]:
    return [f"not judged: {count} x {why}" for why, count in found.not_judged.items()]
