"""The end of a sweep: what is shown, and the exit code."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from deepmf_sumo.cli.sweep.options import Sweep

if TYPE_CHECKING:
    from deepmf_sumo.benchmark.result import Result


def end_of_runs(sweep: Sweep, results: "Sequence[Result]") -> int:
    """Show the table of the runs; returns the exit code."""
    from deepmf_sumo.benchmark import stored
    from deepmf_sumo.benchmark.store import summary
    from deepmf_sumo.cli.screen.runs import table
    from deepmf_sumo.report.table import counted

    missing = len(stored.keys_of(sweep.out)) - len(results)
    if results:
        table(results, summary(results), sweep.out)
    if missing:
        click.echo(f"{counted(missing, 'run')} not begun: --resume goes on")
    return end(sweep, results, missing)


def end(sweep: Sweep, results: "Sequence[Result]", missing: int) -> int:
    """The exit code: 130 where runs are missing, 2 where a spec was wrong, else the verdict's.

    Without thresholds the verdict is that of the runs themselves, see `batch.exit_code`.
    """
    from deepmf_sumo.benchmark import batch, locks
    from deepmf_sumo.benchmark.memory import watched
    from deepmf_sumo.cli.main import INTERRUPTED
    from deepmf_sumo.cli.sweep import judging
    from deepmf_sumo.errors import UsageError

    if not watched():
        click.echo("deepmf-sumo: this system does not show memory: no --memory limit", err=True)
    if not locks.known(sweep.out):
        unlocked = "its file system has no locks: let no two sweeps write into it at a time"
        click.echo(f"deepmf-sumo: {sweep.out}: {unlocked}", err=True)
    code = batch.exit_code(results)
    if sweep.thresholds:
        verdict = judging.judge(sweep)
        code = code if code == UsageError.exit_code else verdict
    return INTERRUPTED if missing else code
