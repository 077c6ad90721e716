"""``deepmf-sumo evaluate``: measure a set of weights on recordings."""

import json
from pathlib import Path
from typing import Any

import click

from deepmf_sumo.cli._parameters import format_option
from deepmf_sumo.cli._sweep import device_option, predict_on


@click.command(name="evaluate", short_help="Measure the predictors on recordings.")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--weights", "name", default="open", show_default=True,
    help="Measure these weights, a name or a folder.",
)  # fmt: skip
@format_option
@click.option(
    "--json", "file", type=click.Path(dir_okay=False, path_type=Path), hidden=True,
    help="Write the figures to this file.",
)  # fmt: skip
@click.option(
    "--candidates",
    type=click.IntRange(6, 96),
    default=32,
    show_default=True,
    help="Measure this number of modes (N1) besides 6, 16 and 32.",
)
@click.option("--card", is_flag=True, help="Also write the figures to the cards of the weights.")
@click.option(
    "--threads", type=click.IntRange(min=1),
    help="Use this number of CPU threads.  [default: torch's own]",
)  # fmt: skip
@device_option
def command(data: tuple[Path, ...], form: str, device: str | None, **settings: Any) -> None:
    """Measure the three predictors on the recordings DATA, which should not be training data.

    Records that cannot be used are named and left out. The figures of baselines without a network
    are shown as well.
    """
    from deepmf_sumo.cli import _evaluation, _screen
    from deepmf_sumo.training import evaluation

    predict_on(device)
    found = evaluation.run(data, report=lambda line: click.echo(line, err=True), **settings)
    if form == "table":
        _evaluation.show(found)
    elif form == "json":
        click.echo(json.dumps(found.record(), indent=1))
    else:
        _screen.emit(form, found.record()["figures"])
