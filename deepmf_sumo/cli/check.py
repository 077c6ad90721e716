"""``deepmf-sumo check``: a result folder against thresholds and a baseline."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import RESULTS, format_option

if TYPE_CHECKING:
    from deepmf_sumo.results.gate import SameAttacks
    from deepmf_sumo.results.gate.verdict import GateVerdict

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(name="check", short_help="Judge results by thresholds and a baseline.")
@click.argument("out", type=RESULTS)
@click.option(
    "--thresholds", "-t", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Judge by this YAML file.  [default with --baseline: no run may fail]",
)  # fmt: skip
@click.option(
    "--baseline", type=click.Path(exists=True, path_type=Path),
    help="Compare with these earlier results: a file of --write-baseline, or a result folder.",
)  # fmt: skip
@click.option(
    "--same-attacks", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    help="Repeat the hits of OUT and of the baseline's folder with both planners, the opponent on "
    "the path that it drove. Store the runs in FOLDER, and reuse those that it has.",
)  # fmt: skip
@click.option(
    "--jobs", "-j", type=click.IntRange(1, 4096), default=1, show_default=True,
    help="Execute this number of repeated runs at a time.",
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
    same_attacks: Path | None,
    jobs: int,
    form: str,
    junit: Path | None,
    summary: Path | None,
    write_baseline: Path | None,
) -> None:
    """Judge the result folder OUT, for continuous integration.

    \b
    Exit codes: 0 all holds; 1 a threshold or an expectation is broken, or something is worse than
    the baseline; 2 a file is wrong; 3 no verdict: runs failed or are missing, the attack is not
    the baseline's, or the runs are too few to tell whether something is worse.
    """
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.results import gate
    from deepmf_sumo.results.gate import verdict as written
    from deepmf_sumo.study.same_attacks import repeated

    if not (thresholds or baseline or write_baseline):
        raise click.UsageError("Missing --thresholds or --baseline: nothing to judge by.")
    wanted = gate.load(thresholds)

    def repeat(new: Path, old: Path) -> "SameAttacks":
        assert same_attacks is not None
        with screen.progress() as report:
            level = wanted.baseline.confidence
            return repeated(new, old, same_attacks, level, jobs, report)

    repeats = repeat if same_attacks else None
    verdict = gate.check(out, wanted, baseline, write_baseline, repeats)
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


def _rows(verdict: "GateVerdict") -> list[dict[str, Any]]:
    """One row for each threshold, comparison with the baseline, and broken expectation.

    All that the exit code is of is in a row.
    """
    from deepmf_sumo.results.frames import rows_of
    from deepmf_sumo.results.gate.thresholds import ALL
    from deepmf_sumo.results.gate.verdict import said

    found: list[dict[str, Any]] = []
    for one in verdict.judgements:
        low, high = one.interval or (None, None)
        found.append(
            {"kind": "threshold", "group": one.group, "quantity": one.limit, "allowed": one.bound}
            | {"was": None, "value": one.value, "low": low, "high": high, "unit": one.unit}
            | {"runs": one.runs, "state": one.state}
        )
    for each in verdict.compared:
        mean, low, high = each.found.difference or (None, None, None)
        found.append(
            {"kind": "baseline", "group": each.group, "quantity": each.quantity, "allowed": None}
            | {"was": each.found.old, "value": each.found.new, "difference": mean}
            | {"low": low, "high": high, "unit": each.unit, "runs": each.found.count}
            | {"state": said(each)}
        )
    if verdict.apart:
        found.append(
            {"kind": "baseline", "group": ALL, "quantity": "attack", "state": "no verdict"}
        )
    if same := verdict.same_attacks:
        found.append(
            {"kind": "same attacks", "group": ALL, "quantity": "own_hits", "allowed": None}
            | {"was": len(same.baseline_own), "value": len(same.own), "unit": "1"}
            | {"runs": same.hits + same.baseline_hits, "state": same.state}
        )
    for run in rows_of(verdict.results.runs):
        found += [
            {"kind": "expectation", "group": run.run_id, "quantity": broken, "state": "broken"}
            for broken in run.expectations_broken
        ]
    names = dict.fromkeys(name for row in found for name in row)
    return [{name: row.get(name) for name in names} for row in found]
