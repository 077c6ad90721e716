"""``deepmf-sumo convert``: recorded scenes as SUMO networks."""

import os
from pathlib import Path

import click
from rich.console import Console


@click.command(name="convert")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--jobs",
    default=os.cpu_count() or 1,
    type=click.IntRange(min=1),
    help="Worker processes; one a core by default.",
)
def command(data: tuple[Path, ...], out: Path, jobs: int) -> None:
    """Convert the road of each scene in DATA (files or folders) into a SUMO network.

    OUT gets a folder a scene: net.net.xml for sumo-gui and netedit, scene.sumocfg to open it with
    the crosswalks, the plain XML it was made of, and mapping.json (which SUMO lane is which of the
    scene's). OUT/convert.csv lists what was kept, what was lost and how far the lanes are off.
    Ends with 3 if a scene could not be converted.
    """
    from deepmf_sumo import readers
    from deepmf_sumo.errors import ConversionError
    from deepmf_sumo.network.batch import TABLE, convert_all

    console = Console(highlight=False)
    rows = []
    for row in convert_all(readers.scenes(data), out, jobs):
        rows.append(row)
        if row.status == "failed":
            line = f"{row.scene or '(no name)'}: {row.reason}"
            console.print(line, markup=False, soft_wrap=True)
    good = [row for row in rows if row.status == "ok"]
    worst = max((row.error_max_m or 0.0 for row in good), default=0.0)
    console.print(
        f"{len(good)} of {len(rows)} scenes converted into {out}, "
        f"lanes at most {worst:.3f} m off; see {out / TABLE}.",
        markup=False,
        soft_wrap=True,
    )
    if len(good) < len(rows) or not rows:
        raise ConversionError(
            f"{len(rows) - len(good)} of {len(rows)} scenes could not be converted; "
            f"the reasons are in {out / TABLE}."
            if rows
            else f"There is no scene in {', '.join(map(str, data))}."
        )
