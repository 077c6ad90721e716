"""``deepmf-sumo evaluate``: measure a set of weights on recordings."""

import json
from pathlib import Path

import click

from deepmf_sumo.cli._parameters import format_option


@click.command(name="evaluate", short_help="Measure the predictors on recordings.")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--weights", "name", default="open", show_default=True,
    help="Measure these weights, a name or a folder.",
)  # fmt: skip
@format_option
@click.option("--card", is_flag=True, help="Also write the figures to the cards of the weights.")
def command(data: tuple[Path, ...], name: str, form: str, card: bool) -> None:
    """Measure the three predictors on the recordings DATA, which should not be training data.

    Records that cannot be used are named and left out. The figures of baselines without a network
    are shown too.
    """
    from deepmf_sumo.cli import _evaluation, _screen
    from deepmf_sumo.deepmf.networks import weights
    from deepmf_sumo.training import evaluation

    weights.runtime_and_device()  # raises where the environment asks for what is not there
    found = evaluation.run(
        data, name=name, file=None, card=card, threads=None,
        report=lambda line: click.echo(line, err=True),
    )  # fmt: skip
    if form == "table":
        _evaluation.show(found)
    elif form == "json":
        click.echo(json.dumps(found.record(), indent=1))
    else:
        _screen.emit(form, found.record()["figures"])
