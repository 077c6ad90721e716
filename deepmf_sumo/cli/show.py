"""``deepmf-sumo show``: the results of folders, side by side."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import format_option, results_argument
from deepmf_sumo.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from deepmf_sumo.results.groups import FailureGroup
    from deepmf_sumo.results.reader import Run


@click.command("show", short_help="Show results side by side.")
@results_argument
@click.option("--all", "everything", is_flag=True, help="Show all metrics, not only the main ones.")
@click.option(
    "--failures", is_flag=True, help="Show what went wrong: failures in groups, the worst first."
)
@click.option(
    "--coverage", is_flag=True,
    help="Show what was attacked on networks, how it went, and what never was attacked.",
)  # fmt: skip
@format_option
def command(
    folders: tuple[Path, ...],
    everything: bool,
    failures: bool,
    coverage: bool,
    form: str,
) -> None:
    """Show the result folders OUT... side by side, each spec of a folder separately.

    With --failures: hits of the opponent and errors of the planner in groups. Findings come first,
    grouped by their cause: who erred how, the kind of conflict, and the smallest change of the AV
    that would have avoided the hit. Contrived and unavoidable hits follow them.
    With --coverage: four tables for each network, of environment, manoeuvre, kind of conflict and
    rules of the road: attacks, conflicts, hits, findings, causes, or why nothing was attacked.
    Rates of hits have 95 % intervals. Means are of the runs that have a value; below the table it
    says why others have none.
    """
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import side_by_side

    screen.tell_switched_off(folders, err=form != "table")
    if failures and coverage:
        raise UsageError("--failures goes without --coverage; give one of them.")
    if (failures or coverage) and everything:
        name = "--failures" if failures else "--coverage"
        raise UsageError(f"{name} goes without --all; its data: --format csv or json.")
    if coverage:
        _show_coverage(folders, form)
        return
    if failures:
        _show_failures(folders, form)
        return
    groups = side_by_side.groups(folders)
    _warn([run for group in groups for run in group.runs])
    if form == "table":
        screen.show_results(side_by_side.side_by_side(groups, everything=everything))
        _say_made([run for group in groups for run in group.runs])
    else:
        table = side_by_side.compare(groups)
        rows = table.astype(object).where(table.notna(), None).to_dict("records")
        screen.emit(form, [{str(key): value for key, value in row.items()} for row in rows])


def _show_failures(folders: tuple[Path, ...], form: str) -> None:
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import failures as words
    from deepmf_sumo.results.failures import failures
    from deepmf_sumo.results.findings import count
    from deepmf_sumo.results.groups import grouped
    from deepmf_sumo.results.reader import Results

    results = Results.open(*folders)
    looked = list(failures(results))
    _warn(results.runs)
    for run, _, why in looked:
        if why:
            click.echo(f"deepmf-sumo: {run.run_id} cannot be described: {why}", err=True)
    groups = grouped((one for _, one, _ in looked if one is not None), len(results.runs))
    if form == "table":
        rows = [(_named(group, folders), words.row(group)) for group in groups]
        worth = count(one.worth for group in groups for one in group.failures if one.kind == "hit")
        screen.show_failures(rows, len(results.runs), worth, words.summary(groups))
    else:
        values = [{"sentence": words.sentence(group), **group.values()} for group in groups]
        if form != "json":
            values = [{key: _cell(value) for key, value in one.items()} for one in values]
        screen.emit(form, values)


def _show_coverage(folders: tuple[Path, ...], form: str) -> None:
    from deepmf_sumo.cli import _risk_screen
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import evidence
    from deepmf_sumo.results import risk

    found = [(one, risk.coverage(one)) for one in risk.read(folders)]
    if form == "table":
        _risk_screen.show_coverage(found)
    else:
        rows = [{"network": net.name} | evidence.values(one) for net, all_ in found for one in all_]
        screen.emit(form, rows)


def _cell(value: Any) -> Any:
    """A cell is one text: names, or names with their values, one after the other."""
    if isinstance(value, dict):
        return " ".join(f"{name} {one}" for name, one in value.items() if one is not None)
    return " ".join(value) if isinstance(value, list) else value


def _warn(runs: "Sequence[Run]") -> None:
    from deepmf_sumo.results.reader import judged_before, without_ladder

    for said in filter(None, (judged_before(runs), without_ladder(runs))):
        click.echo(f"deepmf-sumo: {said}.", err=True)


def _say_made(runs: "Sequence[Run]") -> None:
    """That people were made, where some were."""
    from deepmf_sumo.report.table import made_note

    if told := made_note(run.result for run in runs if run.has_result):
        click.echo(told)


def _named(group: "FailureGroup", folders: tuple[Path, ...]) -> str:
    """Its sentence with the run that is its example; of several folders with that run's folder."""
    from deepmf_sumo.report import failures as words

    said = words.sentence(group)
    run = group.example.run
    return f"{said} ({run.run_id if len(folders) == 1 else run.folder})"
