"""``deepmf-sumo check``: a result folder against thresholds and a baseline."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import format_option

if TYPE_CHECKING:
    from deepmf_sumo.gate.verdict import Verdict

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(name="check", short_help="Judge results by thresholds and a baseline.")
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--thresholds", "-t", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Judge by this YAML file.  [default: no run may fail; what the baseline is compared by]",
)  # fmt: skip
@click.option(
    "--baseline", type=click.Path(exists=True, path_type=Path),
    help="Compare with these earlier results: a file of --write-baseline, or a result folder.",
)  # fmt: skip
@format_option
@click.option("--junit", type=_FILE, help="Write JUnit XML to this file.")
@click.option("--summary", type=_FILE, help="Add a Markdown summary to this file.")
@click.option(
    "--write-baseline", type=_FILE, help="Write this file for later jobs to compare with."
)
@click.pass_context
def command(
    ctx: click.Context,
    out: Path,
    thresholds: Path | None,
    baseline: Path | None,
    form: str,
    junit: Path | None,
    summary: Path | None,
    write_baseline: Path | None,
) -> None:
    """Judge the result folder OUT, for continuous integration.

    \b
    Exit codes: 0 all holds; 1 a threshold or an expectation is broken, or something is worse than
    the baseline; 2 a file is wrong; 3 no verdict: runs failed or are missing, or the runs are too
    few to tell whether a threshold holds or something is worse than the baseline.
    """
    from deepmf_sumo import gate
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.gate import verdict as written

    if not (thresholds or baseline or write_baseline):
        raise click.UsageError("Missing --thresholds or --baseline: nothing to judge by.")
    verdict = gate.check(out, gate.load(thresholds), baseline, write_baseline)
    if form == "table":
        screen.show_verdict(verdict)
    elif form == "md":
        click.echo(written.text(verdict), nl=False)
    else:
        screen.emit(form, _rows(verdict))
    if junit:
        written.write_junit(junit, verdict)
    if summary:
        written.write_summary(summary, verdict)
    ctx.exit(verdict.exit_code)


def _rows(verdict: "Verdict") -> list[dict[str, Any]]:
    """One row for each threshold and each comparison with the baseline."""
    found: list[dict[str, Any]] = []
    for one in verdict.judgements:
        low, high = one.interval or (None, None)
        found.append(
            {"kind": "threshold", "group": one.group, "quantity": one.limit, "allowed": one.bound}
            | {"was": None, "value": one.value, "low": low, "high": high, "unit": one.unit}
            | {"runs": one.runs, "state": one.state}
        )
    for each in verdict.comparisons or ():
        mean, low, high = each.found.difference or (None, None, None)
        found.append(
            {"kind": "baseline", "group": each.group, "quantity": each.quantity, "allowed": None}
            | {"was": each.found.old, "value": each.found.new, "difference": mean}
            | {"low": low, "high": high, "unit": each.unit, "runs": each.found.count}
            | {"state": each.state}
        )
    names = dict.fromkeys(name for row in found for name in row)
    return [{name: row.get(name) for name in names} for row in found]
