"""``deepmf-sumo train``: make a set of weights from recordings."""

import sys
from pathlib import Path

import click


@click.command(name="train")
@click.argument("network", type=click.Choice(["opponent", "marginal", "conditional", "all"]))
@click.option(
    "--data",
    required=True,
    multiple=True,
    type=click.Path(path_type=Path),
    help="Recorded file or folder; may be given several times.",
)
@click.option("--name", default="custom", show_default=True, help="Name of the set of weights.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of the set, instead of its place in the weights home.",
)
@click.option("--preset", type=click.Choice(["light", "paper"]), default="light", show_default=True)
@click.option("--steps", type=click.IntRange(min=1), help="Steps of each network.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
@click.option("--threads", type=click.IntRange(min=1), help="CPU threads; torch's own by default.")
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for computed features (1 GB for 700 scenes), else under the weights home.",
)
@click.option("--licence", default="", help="Note on the data's licence, for the card.")
def command(
    network: str,
    data: tuple[Path, ...],
    name: str,
    out: Path | None,
    preset: str,
    steps: int | None,
    seed: int,
    device: str,
    threads: int | None,
    cache: Path | None,
    licence: str,
) -> None:
    """Train NETWORK, or all three, on recordings of any known format.

    One scene in ten is held out for early stopping and temperatures. A run that was cut off goes
    on with the same command.
    """
    if Path(name).name != name:
        raise click.UsageError(f"--name {name} is no plain name; give a folder with --out.")
    from deepmf_sumo.training import run

    run.train_named(
        network,
        data=data,
        name=name,
        out=out,
        preset=preset,
        steps=steps,
        seed=seed,
        device=device,
        threads=threads,
        cache=cache,
        licence=licence,
        command=" ".join(["deepmf-sumo", *sys.argv[1:]]),
        report=click.echo,
    )
