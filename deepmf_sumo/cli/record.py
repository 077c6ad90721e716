"""``deepmf-sumo record``: traffic of a SUMO configuration as scenes to train on."""

from pathlib import Path

import click
from rich.console import Console

from deepmf_sumo.errors import OutputError, SimulationError


@click.command(name="record")
@click.argument("config", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--scenes", default=100, show_default=True, type=click.IntRange(min=1))
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0))
@click.option("--start", "start_s", default=60.0, show_default=True, help="Seconds to wait first.")
@click.option("--every", "every_s", default=9.0, show_default=True, help="Seconds between scenes.")
@click.option("--diverse/--as-it-is", default=True, help="Mix drivers, or keep the demand's types.")
def command(
    config: Path,
    out: Path,
    scenes: int,
    seed: int,
    start_s: float,
    every_s: float,
    diverse: bool,
) -> None:
    """Record SUMO traffic as scenes of 9.1 s, one .npz file each.

    CONFIG: a .sumocfg with a network and traffic. Writes fewer scenes than asked for where the
    traffic ends before; ends with 3 if there are none.
    """
    for flag, value, least in (("--start", start_s, 0.0), ("--every", every_s, 0.1)):
        if not least <= value < float("inf"):
            raise click.UsageError(f"{flag} is {value:g}; it must be seconds, at least {least:g}.")
    from deepmf_sumo.readers import npz
    from deepmf_sumo.simulation.recording import Recording, record

    # as long as it takes: moments without a possible AV give no scene
    longest = start_s + (10 + 3 * scenes) * max(every_s, 9.0)
    recording = Recording(
        config=config,
        seed=seed,
        start_s=start_s,
        stop_s=longest,
        every_s=every_s,
        diverse=diverse,
    )
    written = 0
    try:
        out.mkdir(parents=True, exist_ok=True)
        for scene in record(recording):
            npz.write(scene, out / f"{scene.name}.npz")
            written += 1
            if written == scenes:
                break
    except OSError as error:
        raise OutputError(f"'{out}' cannot be written: {error.strerror}.") from None
    if not written:
        raise SimulationError(
            f"'{config}' gave no scene: no vehicle drives on for 9 s with others."
        )
    Console().print(f"{written} scenes of {config} in {out}", highlight=False)
