"""The risk map at the end of attacks."""

import shutil
from pathlib import Path

import click


def map_risk(out: Path) -> None:
    """Write ``out/risk`` anew and say where; what stands in the way of a map is a line.

    The runs are there either way, so it is no error.
    """
    from deepmf_sumo.benchmark import risk
    from deepmf_sumo.errors import DeepmfError
    from deepmf_sumo.report import risk as files

    shutil.rmtree(out / "risk", ignore_errors=True)
    try:
        written = files.write(out / "risk", risk.read([out]), out.resolve().name)
    except DeepmfError as error:
        click.echo(f"deepmf-sumo: no risk map: {error}", err=True)
        return
    for one in written:
        click.echo(f"{one.folder}/{files.PAGE}")
