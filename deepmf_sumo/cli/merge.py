"""``deepmf-sumo merge``: folders of a benchmark's shards -> one folder."""

from pathlib import Path

import click


@click.command(name="merge")
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.argument(
    "shards",
    metavar="SHARD...",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)
@click.option("--figures/--no-figures", default=True, show_default=True)
@click.pass_context
def command(ctx: click.Context, out: Path, shards: tuple[Path, ...], figures: bool) -> None:
    """Join the folders SHARD... of `benchmark --shard` in OUT, as if run in one piece."""
    from deepmf_sumo.benchmark import batch, study
    from deepmf_sumo.cli.main import INTERRUPTED
    from deepmf_sumo.cli.screen import benchmark as screen
    from deepmf_sumo.report import benchmark as report

    results, missing = study.merge(out, shards)
    made = report.finish(out, figures=figures)
    screen.show(out, results, len(results) + len(missing), made)
    ctx.exit(INTERRUPTED if missing else batch.exit_code(results))
