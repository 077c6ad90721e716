"""``deepmf-sumo evaluate``: measure a set of weights on recordings."""

from pathlib import Path

import click


@click.command(name="evaluate")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--weights", "name", default="open", show_default=True, help="Name or folder.")
@click.option(
    "--json", "file", type=click.Path(dir_okay=False, path_type=Path), help="Write figures here."
)
@click.option(
    "--candidates",
    type=click.IntRange(6, 96),
    default=32,
    show_default=True,
    help="N1: measure this number of modes besides 6, 16 and 32.",
)
@click.option("--card", is_flag=True, help="Also put the figures on the cards of the weights.")
@click.option("--threads", type=click.IntRange(min=1), help="CPU threads; torch's own by default.")
def command(
    data: tuple[Path, ...],
    name: str,
    file: Path | None,
    candidates: int,
    card: bool,
    threads: int | None,
) -> None:
    """Measure the three predictors on the recordings DATA, which should not be training data.

    Records that cannot be used are named and left out. Baselines without a network are shown
    beside the figures.
    """
    from deepmf_sumo.cli import _evaluation
    from deepmf_sumo.training import evaluation

    found = evaluation.run(
        data,
        name=name,
        file=file,
        card=card,
        threads=threads,
        report=lambda line: click.echo(line, err=True),
        candidates=candidates,
    )
    _evaluation.show(found)
