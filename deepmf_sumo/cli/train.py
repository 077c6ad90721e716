"""``deepmf-sumo train``: make a set of weights from recordings."""

import sys
from pathlib import Path
from typing import Any

import click

from deepmf_sumo.cli._parameters import FiniteRange

_STEPS = click.IntRange(min=1)
_ABOVE_0 = FiniteRange(min=0, min_open=True)
_RATE = FiniteRange(min=0, min_open=True, max=1)


@click.command(name="train")
@click.argument(
    "network", type=click.Choice(["opponent", "marginal", "conditional", "strive", "all"])
)
@click.option(
    "--data",
    multiple=True,
    metavar="PATH[=WEIGHT]",
    help="Recorded file or folder, and its share in training; may be given several times.",
)
@click.option(
    "--config",
    "file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="YAML file with these settings, also for single networks; flags take precedence.",
)
@click.option("--name", default="custom", show_default=True, help="Name of the set of weights.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of the set, instead of its place in the weights home.",
)
@click.option("--from", "begin_from", metavar="NAME", help="Set of weights to start from.")
@click.option(
    "--preset",
    help="Sizes of the networks: light, paper or vector (light without images).  [default: vector"
    " for marginal and conditional, light for the others]",
)
@click.option(
    "--members",
    type=click.IntRange(min=1, max=8),
    help="Networks of the marginal predictor, each with a seed of its own.  [default: 1]",
)
@click.option("--steps", type=_STEPS, help="Steps of each network.")
@click.option("--batch", type=_STEPS, help="Samples a step.")
@click.option("--rate", type=_RATE, help="Highest learning rate.")
@click.option("--weight-decay", type=FiniteRange(min=0, max=1))
@click.option("--clip", type=_ABOVE_0, help="Largest norm of the gradient.")
@click.option(
    "--ema",
    type=FiniteRange(min=0, max=1, max_open=True),
    help="Decay of the average of the weights; 0 for none.",
)
@click.option("--precision", type=click.Choice(["auto", "bf16", "fp32"]))
@click.option("--evaluate-every", type=_STEPS, help="Steps between evaluations on held-out scenes.")
@click.option(
    "--patience",
    type=click.IntRange(min=0),
    help="Evaluations without gain after which to stop; 0: never.",
)
@click.option("--seed", type=click.IntRange(min=0, max=2**31 - 1), help="0 by default.")
@click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
@click.option("--threads", type=click.IntRange(min=1), help="CPU threads; torch's own by default.")
@click.option(
    "--jobs",
    default=1,
    show_default=True,
    type=click.IntRange(min=1),
    help="Processes that compute features.",
)
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for computed features (1 GB for 700 scenes), else under the weights home.",
)
@click.option("--again", is_flag=True, help="Repeat a training that is complete.")
@click.option("--licence", help="Note on the data's licence, for the card.")
def command(network: str, name: str, **settings: Any) -> None:
    """Train NETWORK, or all three of DeepMF, on recordings of any known format.

    strive is the motion prior of the baseline of that name; nothing else needs it.
    The scenes at one place in ten are held out for early stopping and temperatures. Sources count
    by their samples, or by the weights given to them. The same command resumes an interrupted
    training, and keeps a network that is complete.
    """
    if Path(name).name != name:
        raise click.UsageError(f"--name {name} is not a plain name; give a folder with --out.")
    from deepmf_sumo.training import command as training
    from deepmf_sumo.training.config import Optimisation

    optimisation = {key: settings.pop(key) for key in Optimisation.model_fields if key in settings}
    request = training.Request(
        network=network,
        name=name,
        optimisation=optimisation,
        command=" ".join(["deepmf-sumo", *sys.argv[1:]]),
        **settings,
    )
    training.train_requested(request, click.echo)
