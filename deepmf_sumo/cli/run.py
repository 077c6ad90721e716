"""``deepmf-sumo run``: specs -> result folder."""

from pathlib import Path

import click


@click.command(name="run")
@click.argument(
    "specs", metavar="SPEC...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Override a spec's key.")
@click.option("--seed", type=click.IntRange(min=0), help="Short for --set seed=N.")
@click.option("-k", "name_filter", metavar="TEXT", default="", help="Only runs whose id holds it.")
@click.option("--jobs", "-j", type=click.IntRange(1, 256), default=1, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
@click.option(
    "--timeout", metavar="S", type=click.FloatRange(min=0, min_open=True), default=600.0,
    show_default=True, help="Seconds that one run may take.",
)  # fmt: skip
@click.option("--gui", is_flag=True, help="Show each run in sumo-gui, one at a time.")
@click.option("--junit", is_flag=True, help="Write junit.xml.")
@click.option("--no-pictures", is_flag=True, help="Draw no picture.png.")
@click.option("--scenes", is_flag=True, help="Also write each run as a scene, scene.npz.")
@click.option("--report", is_flag=True, help="Write report.html: all runs, each with a replay.")
@click.option("--resume", is_flag=True, help="Keep equal runs that are in the folder already.")
@click.pass_context
def command(
    ctx: click.Context,
    specs: tuple[Path, ...],
    sets: tuple[str, ...],
    seed: int | None,
    name_filter: str,
    jobs: int,
    out: Path,
    timeout: float,
    gui: bool,
    junit: bool,
    no_pictures: bool,
    scenes: bool,
    report: bool,
    resume: bool,
) -> None:
    """Run every SPEC and write a result folder: tables, and a folder a run with its picture."""
    import os
    import sys

    from deepmf_sumo.benchmark import batch
    from deepmf_sumo.benchmark.store import summary
    from deepmf_sumo.cli.screen.runs import progress, table
    from deepmf_sumo.report.picture import draw
    from deepmf_sumo.spec import load

    sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
    over = [*sets, *([f"seed={seed}"] if seed is not None else [])]
    options = batch.Options(
        out=out,
        name_filter=name_filter,
        jobs=1 if gui else jobs,
        timeout_s=None if gui else timeout,
        draw=None if no_pictures else draw,
        gui=gui,
        junit=junit,
        scenes=scenes,
        resume=resume,
    )
    loaded = [load(path, over) for path in specs]
    with progress() as show:
        results = batch.run(loaded, options, show)
    table(results, summary(results), out)
    if report:
        from deepmf_sumo.report import page

        click.echo(page.write(out))
    ctx.exit(batch.exit_code(results))
