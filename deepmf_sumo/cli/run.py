"""``deepmf-sumo run``: specs -> result folder."""

from pathlib import Path

import click

from deepmf_sumo.cli._parameters import Seeds
from deepmf_sumo.cli._sweep import Sweep, end_of_runs, options


@click.command(name="run")
@click.argument(
    "specs", metavar="SPEC...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a spec's key.")
@click.option("--seed", type=click.IntRange(min=0), help="Short for --set seed=N.")
@click.option(
    "--seeds", metavar="SEEDS", type=Seeds(),
    help="Run every spec with each of these seeds, e.g. 1-20 or 1,5,9-12.",
)  # fmt: skip
@click.option("-k", "name_filter", metavar="TEXT", default="", help="Only runs whose id holds it.")
@click.option("--scenes", is_flag=True, help="Also write each run as a scene, scene.npz.")
@click.option("--report", is_flag=True, help="Write report.html: all runs, each with a replay.")
@options(out="results", pictures=True)
@click.pass_context
def command(
    ctx: click.Context,
    specs: tuple[Path, ...],
    sets: tuple[str, ...],
    seed: int | None,
    seeds: tuple[int, ...] | None,
    name_filter: str,
    scenes: bool,
    report: bool,
    sweep: Sweep,
) -> None:
    """Run every SPEC and write a result folder: tables, and a folder a run with its picture."""
    from deepmf_sumo.cli._screen import progress
    from deepmf_sumo.errors import UsageError
    from deepmf_sumo.spec import load
    from deepmf_sumo.sweep import batch

    wanted = sweep.begin(name_filter=name_filter, scenes=scenes)
    over = [*sets, *([f"seed={seed}"] if seed is not None else [])]
    if seeds and any(one.partition("=")[0].strip() == "seed" for one in over):
        raise UsageError("--seeds goes without --seed and without --set seed=N: leave one out.")
    loaded = [load(path, over) for path in specs]
    if seeds:
        loaded = [one.model_copy(update={"seed": each}) for one in loaded for each in seeds]
    with progress() as show:
        results = batch.run(loaded, wanted, show)
    if report:
        from deepmf_sumo.report import page

        click.echo(page.write(sweep.out))
    ctx.exit(end_of_runs(sweep, results))
