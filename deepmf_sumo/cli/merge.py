"""``deepmf-sumo merge``: folders of shards -> one folder."""

from pathlib import Path

import click

from deepmf_sumo.errors import exit_code


@click.command(name="merge", short_help="Join the shards of a sweep.")
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.argument(
    "shards", metavar="SHARD...", nargs=-1, required=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Delete the results that OUT has.")
@click.pass_context
def command(ctx: click.Context, out: Path, shards: tuple[Path, ...], overwrite: bool) -> None:
    """Merge the shards of one sweep, of run or attack with --shard, into the folder OUT."""
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.cli._sweep import map_risk
    from deepmf_sumo.report import benchmark
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results.folder import summary
    from deepmf_sumo.study import plans
    from deepmf_sumo.study.sweep import batch
    from deepmf_sumo.study.sweep import shards as parts

    if parts.of_benchmark(shards[0]):
        results, missing = plans.merge(out, shards, overwrite=overwrite)
        made = benchmark.finish(out, figures=True)
        screen.show_study(out, results, len(results) + len(missing), made)
    else:
        results, missing = parts.merge(out, shards, overwrite=overwrite)
        screen.table(results, summary(results), out)
        if any((shard / "risk").is_dir() for shard in shards):
            map_risk(out)
        if missing:
            click.echo(
                f"{counted(len(missing), 'run is', 'runs are')} in no shard: the command without"
                f" --shard, with --out {out} --resume, does them"
            )
    ctx.exit(exit_code("interrupted") if missing else batch.exit_code(results))
