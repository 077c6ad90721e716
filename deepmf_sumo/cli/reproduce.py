"""``deepmf-sumo reproduce``: the paper's tables and figures on any recordings."""

from pathlib import Path
from typing import Any

import click

from deepmf_sumo.cli._sweep import Sweep, execute, options, plan_options


@click.command(name="reproduce")
@click.argument("scenes", type=click.Path(exists=True, path_type=Path))
@click.option("--weights", help="Name or folder of the networks' weights, else the plan's.")
@click.option("--first", metavar="N", type=click.IntRange(min=1), help="Only the first N scenes.")
@plan_options
@options(out="benchmark", pictures=False)
@click.pass_context
def command(
    ctx: click.Context,
    /,
    scenes: Path,
    weights: str | None,
    first: int | None,
    sets: tuple[str, ...],
    sweep: Sweep,
    **wanted: Any,
) -> None:
    """Run the paper's plan on the recordings in SCENES: Tables I to III, Figures 3 to 6.

    The plan is studies/paper.yaml of the repository; its keys can be overridden with --set.
    """
    import json

    from deepmf_sumo.cli._starter import paper_plan

    over = [f"source.recording={json.dumps(str(scenes.resolve()))}"]
    over += [f"source.scenes={{first: {first}}}"] if first else []
    if weights:
        place = str(Path(weights).resolve()) if "/" in weights else weights
        over.append(f"weights={json.dumps(place)}")
    ctx.exit(execute(paper_plan(), sweep, sets=(*over, *sets), **wanted))
