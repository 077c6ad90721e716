"""Commands under their names of the release before."""

import copy
import json
from pathlib import Path
from typing import Any, Final

import click

from deepmf_sumo.cli import data, run, show
from deepmf_sumo.cli._sweep import options


def _renamed(command: click.Command, name: str, **defaults: Any) -> click.Command:
    renamed = copy.copy(command)
    renamed.name = name
    renamed.context_settings = {**command.context_settings, "default_map": defaults}
    return renamed


@click.command(name="reproduce")
@click.argument("scenes", type=click.Path(exists=True, path_type=Path))
@click.option("--weights", help="Use these weights, a name or a folder, instead of the plan's.")
@click.option("--first", metavar="N", type=click.IntRange(min=1), help="Use the first N scenes.")
@run.plan_options
@options(out="benchmark")
@click.pass_context
def _reproduce(
    ctx: click.Context,
    /,
    scenes: Path,
    weights: str | None,
    first: int | None,
    sets: tuple[str, ...],
    **wanted: Any,
) -> None:
    """Run the paper's plan on the recordings in SCENES, as `deepmf-sumo run paper` does."""
    over = [f"source.recording={json.dumps(str(scenes.resolve()))}"]
    over += [f"source.scenes={{first: {first}}}"] if first else []
    if weights:
        place = str(Path(weights).resolve()) if "/" in weights else weights
        over.append(f"weights={json.dumps(place)}")
    ctx.exit(run.run_plan(Path("paper"), wanted, sets=(*over, *sets)))


COMMANDS: Final = {
    "benchmark": _renamed(run.command, "benchmark", out="benchmark"),
    "convert": _renamed(data.convert, "convert"),
    "record": _renamed(data.record, "record"),
    "reproduce": _reproduce,
    "scenes": _renamed(data.list_scenes, "scenes"),
    "table": _renamed(show.command, "table"),
}
