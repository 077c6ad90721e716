"""``deepmf-sumo run``: specs -> result folder."""

from pathlib import Path

import click

from deepmf_sumo.cli.sweep import Sweep, end_of_runs, options


@click.command(name="run")
@click.argument(
    "specs", metavar="SPEC...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a spec's key.")
@click.option("--seed", type=click.IntRange(min=0), help="Short for --set seed=N.")
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
    name_filter: str,
    scenes: bool,
    report: bool,
    sweep: Sweep,
) -> None:
    """Run every SPEC and write a result folder: tables, and a folder a run with its picture."""
    from deepmf_sumo.benchmark import batch
    from deepmf_sumo.cli.screen.runs import progress
    from deepmf_sumo.spec import load

    wanted = sweep.begin(name_filter=name_filter, scenes=scenes)
    over = [*sets, *([f"seed={seed}"] if seed is not None else [])]
    loaded = [load(path, over) for path in specs]
    with progress() as show:
        results = batch.run(loaded, wanted, show)
    if report:
        from deepmf_sumo.report import page

        click.echo(page.write(sweep.out))
    ctx.exit(end_of_runs(sweep, results))
