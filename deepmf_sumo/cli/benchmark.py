"""``deepmf-sumo benchmark``: methods x planners x scenes x seeds, and their tables."""

from pathlib import Path
from typing import Any

import click

from deepmf_sumo.cli._sweep import Sweep, execute, options, plan_options


@click.command(name="benchmark")
@click.argument("file", metavar="PLAN", type=click.Path(path_type=Path))
@plan_options
@options(out="benchmark", pictures=False)
@click.pass_context
def command(ctx: click.Context, /, file: Path, sweep: Sweep, **wanted: Any) -> None:
    """Run PLAN and write runs.csv, the tables (CSV, Markdown, LaTeX) and the figures.

    Stopped at any moment, it goes on with --resume and gives the same. --shard 2/8 runs an eighth,
    `deepmf-sumo merge` joins them.
    """
    ctx.exit(execute(file, sweep, **wanted))
