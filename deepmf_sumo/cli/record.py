"""``deepmf-sumo record``: SUMO traffic as scenes to train on."""

from pathlib import Path

import click
from rich.console import Console

from deepmf_sumo.errors import SimulationError, UsageError

KINDS = ("grid", "spider", "random", "junctions", "motorway", "mix")
"""As in `network.generated`, which is not imported for help."""


@click.command(name="record")
@click.argument("configs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--generate", "kind", type=click.Choice(KINDS), help="Make networks up, of a kind.")
@click.option(
    "--networks",
    default=10,
    show_default=True,
    type=click.IntRange(min=1),
    help="How many to make up.",
)
@click.option(
    "--scenes",
    default=100,
    show_default=True,
    type=click.IntRange(min=1),
    help="Scenes of each network, at most.",
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0))
@click.option("--start", "start_s", default=60.0, show_default=True, help="Seconds to wait first.")
@click.option("--every", "every_s", default=9.0, show_default=True, help="Seconds between moments.")
@click.option(
    "--avs",
    default=1,
    show_default=True,
    type=click.IntRange(min=1),
    help="Scenes of one moment, at most, each around an AV of its own.",
)
@click.option("--diverse/--as-it-is", default=True, help="Mix drivers, or keep the demand's types.")
@click.option(
    "--jobs", default=1, show_default=True, type=click.IntRange(min=1), help="Worker processes."
)
def command(
    configs: tuple[Path, ...],
    out: Path,
    kind: str | None,
    networks: int,
    scenes: int,
    seed: int,
    start_s: float,
    every_s: float,
    avs: int,
    diverse: bool,
    jobs: int,
) -> None:
    """Record SUMO traffic as scenes of 9.1 s, one .npz file each, a folder a network.

    CONFIGS: .sumocfg files with a network and traffic. With --generate, networks with traffic are
    made up, from the seed. The files are the same whatever --jobs; the same command again goes on
    where it was cut off. A network that gives fewer scenes than asked for, or none, is named; ends
    with 3 if a CONFIG or all networks gave none.
    """
    for flag, value, least in (("--start", start_s, 0.0), ("--every", every_s, 0.1)):
        if not least <= value < float("inf"):
            raise click.UsageError(f"{flag} is {value:g}; it must be seconds, at least {least:g}.")
    if not configs and not kind:
        raise UsageError("There is nothing to record: give a .sumocfg, or --generate KIND.")
    from deepmf_sumo.recording.many import Recorded, Wanted, record_all

    wanted = Wanted(
        configs=configs,
        kind=kind or "mix",
        networks=networks if kind else 0,
        seed=seed,
        scenes=scenes,
        avs=avs,
        start_s=start_s,
        every_s=every_s,
        diverse=diverse,
    )
    console = Console(highlight=False)
    done: list[Recorded] = []
    for network in record_all(wanted, out, jobs):
        done.append(network)
        line = f"{network.name}: {network.scenes} scenes"
        line += f" ({network.reason})" if network.reason else ""
        console.print(line, markup=False, soft_wrap=True)
    total, empty = sum(one.scenes for one in done), [one for one in done if not one.scenes]
    line = f"{total} scenes of {len(done) - len(empty)} networks in {out}"
    line += f"; {len(empty)} skipped: {', '.join(one.name for one in empty)}" if empty else ""
    console.print(line, markup=False, soft_wrap=True)
    lost = [one for one in empty if one.given or not total]
    if lost:
        raise SimulationError(f"{lost[0].name} gave no scene: {lost[0].reason}.")
