"""``deepmf-sumo shrink``: a hit -> the smallest spec that still shows it."""

from pathlib import Path
from typing import Final

import click

from deepmf_sumo.errors import EXIT_CODES

_ENDS: Final = {
    "nothing helps": "nothing more helps",
    "budget": "the budget is spent",
    "interrupted": "interrupted",
}


@click.command("shrink", short_help="Find the smallest spec that still shows a hit.")
@click.argument(
    "folder", metavar="RUN", type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.argument("run_id", metavar="[RUN_ID]", required=False)
@click.option(
    "--out", "file", metavar="FILE.yaml", required=True,
    type=click.Path(dir_okay=False, path_type=Path), help="Write the spec into this file.",
)  # fmt: skip
@click.option(
    "--simulations", metavar="N", type=click.IntRange(min=3), default=60, show_default=True,
    help="Make at most this number of simulations.",
)  # fmt: skip
@click.pass_context
def command(
    ctx: click.Context, folder: Path, run_id: str | None, file: Path, simulations: int
) -> None:
    """Find the smallest reproducer of a hit that still fails in the same way, and write its spec.

    RUN is the folder of a run (RESULTS/runs/RUN_ID), or a result folder with a RUN_ID after it. In
    turn it lets the run begin later, leaves other road users out, drops changes of plan, and makes
    the opponent's motion milder, until nothing more helps. The planner stays; the opponent drives a
    fixed trajectory, so that the spec needs no weights. Each candidate is simulated; the last one
    twice, byte for byte. Ctrl-C ends the search: the smallest spec so far is written.

    `deepmf-sumo run FILE.yaml` shows the hit (exit code 1); with --set planner=NAME it tries
    another planner, which may pass (exit code 0).
    """
    import os
    import sys

    from deepmf_sumo.study import shrink

    sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
    shrink.check(file)
    failure = shrink.read(shrink.run_of(folder, run_id))
    found = shrink.shrink(failure, simulations, lambda said: click.echo(f"  {said}", err=True))
    shrink.write(found, file)
    click.echo(f"{failure.run_id}: '{failure.opponent}' hits the AV (planner {failure.planner})")
    click.echo(shrink.summary(found))
    did = f"{found.simulations} simulations, {_ENDS[found.end]}"
    click.echo(f"{did}; the last one was repeated byte for byte")
    if found.kept:
        click.echo(f"kept as they were: {found.kept}")
    click.echo(f"{file}: deepmf-sumo run {file} [--set planner=NAME for another planner]")
    if found.end == "interrupted":
        ctx.exit(EXIT_CODES["interrupted"])
