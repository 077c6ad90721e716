"""``deepmf-sumo train``: recordings -> a set of weights."""

import sys
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource


@click.command(name="train", short_help="Train the predictors on recordings.")
@click.argument(
    "network",
    type=click.Choice(
        ["opponent", "marginal", "conditional", "people", "strive", "diffscene", "all", "onnx"]
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
    help="Read the configuration from this YAML file.",
)
@click.option("--name", default="custom", show_default=True, help="Name the set of weights.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write the set into this folder instead of the weights home.",
)
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set a key of the configuration, e.g. steps=500 or opponent.batch=16; may be repeated.",
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
def command(network: str, name: str, **settings: Any) -> None:
    """Train NETWORK, or all three of DeepMF, on recordings of any known format.

    people is a small network of pedestrians and cyclists, which a set may lack.
    strive and diffscene are the motion priors of the baselines of these names; nothing else needs
    them. The scenes at one place in ten are held out for early stopping and temperatures. Sources
    count by their samples, or by the weights given to them. The same command resumes an interrupted
    training, and keeps a network that is complete. Steps, rates, sizes (preset) and all other keys
    of a configuration are set by --set. It trains on the CPU unless DEEPMF_SUMO_DEVICE is cuda or
    auto.

    onnx trains nothing: it writes the graphs of the set --name, or of the folder --out, which
    installations without torch read.
    """
    if Path(name).name != name:
        raise click.UsageError(f"--name {name} is not a plain name; give a folder with --out.")
    if network == "onnx":
        _write_graphs(settings["out"] or name)
        return
    from deepmf_sumo.training import command as training

    request = training.TrainingRequest(
        network=network,
        name=name,
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
