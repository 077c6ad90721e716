"""``deepmf-sumo train``: recordings -> a set of weights."""

import sys
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from deepmf_sumo.cli._parameters import FiniteRange

_STEPS = click.IntRange(min=1)
_ABOVE_0 = FiniteRange(min=0, min_open=True)
_RATE = FiniteRange(min=0, min_open=True, max=1)


@click.command(name="train", short_help="Train the predictors on recordings.")
@click.argument(
    "network",
    type=click.Choice(
        ["opponent", "marginal", "conditional", "strive", "diffscene", "all", "onnx"]
    ),
)
@click.option(
    "--data",
    multiple=True,
    metavar="PATH[=WEIGHT]",
    help="Train on this recorded file or folder, with this share; may be repeated.",
)
@click.option(
    "--config",
    "file",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Read these settings from a YAML file, also for single networks; options override it.",
)
@click.option("--name", default="custom", show_default=True, help="Name the set of weights.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write the set into this folder instead of the weights home.",
)
@click.option("--from", "begin_from", metavar="NAME", help="Start from this set of weights.")
@click.option(
    "--preset",
    help="Choose the sizes: vector, dense, light, unpaired or paper (docs: Train).  [default:"
    " vector for marginal and conditional, light for the others]",
)
@click.option(
    "--members",
    type=click.IntRange(min=1, max=8),
    help="Train this number of marginal networks, each with its seed.  [default: 1]",
)
@click.option("--steps", type=_STEPS, help="Train each network for this number of steps.")
@click.option("--batch", type=_STEPS, help="Use this number of samples per step.")
@click.option("--rate", type=_RATE, help="Set the highest learning rate.")
@click.option("--weight-decay", type=FiniteRange(min=0, max=1), help="Set the weight decay.")
@click.option("--clip", type=_ABOVE_0, help="Limit the norm of the gradient.")
@click.option(
    "--ema",
    type=FiniteRange(min=0, max=1, max_open=True),
    help="Average the weights with this decay; 0 for no average.",
)
@click.option(
    "--precision", type=click.Choice(["auto", "bf16", "fp32"]), help="Compute with this precision."
)
@click.option("--evaluate-every", type=_STEPS, help="Evaluate on held-out scenes every N steps.")
@click.option(
    "--patience",
    type=click.IntRange(min=0),
    help="Stop after this number of evaluations without gain; 0: never.",
)
@click.option(
    "--seed", type=click.IntRange(min=0, max=2**31 - 1), help="Seed everything.  [default: 0]"
)
@click.option(
    "--device", type=click.Choice(["cpu", "cuda", "auto"]), default="cpu", show_default=True,
    help="Train on this device; auto: on a GPU where there is one.",
)  # fmt: skip
@click.option(
    "--threads", type=click.IntRange(min=1),
    help="Use this number of CPU threads.  [default: torch's own]",
)  # fmt: skip
@click.option(
    "--jobs",
    "-j",
    default=1,
    show_default=True,
    type=click.IntRange(min=1),
    help="Compute features in this number of processes.",
)
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    help="Keep computed features (1 GB for 700 scenes) here.  [default: under the weights home]",
)
@click.option("--again", is_flag=True, help="Repeat a training that is complete.")
@click.option("--licence", help="Note the data's licence on the card.")
def command(network: str, name: str, **settings: Any) -> None:
    """Train NETWORK, or all three of DeepMF, on recordings of any known format.

    strive and diffscene are the motion priors of the baselines of these names; nothing else needs
    them. The scenes at one place in ten are held out for early stopping and temperatures. Sources
    count by their samples, or by the weights given to them. The same command resumes an interrupted
    training, and keeps a network that is complete.

    onnx trains nothing: it writes the graphs of the set --name, or of the folder --out, which
    installations without torch read.
    """
    if Path(name).name != name:
        raise click.UsageError(f"--name {name} is not a plain name; give a folder with --out.")
    if network == "onnx":
        _write_graphs(settings["out"] or name)
        return
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


def _write_graphs(name: str | Path) -> None:
    context = click.get_current_context()
    own = {"network", "name", "out"}
    for one in context.command.params:
        given = context.get_parameter_source(one.name or "") is not ParameterSource.DEFAULT
        if given and one.name not in own:
            raise click.UsageError(f"{one.opts[0]} is for training; onnx takes --name and --out.")
    from deepmf_sumo.deepmf.networks.weights import need

    for package in ("torch", "onnx", "onnxscript", "onnxruntime"):
        need(package, "Writing graphs")
    from deepmf_sumo.training import onnx_graphs

    onnx_graphs.write(name, click.echo)
