"""``deepmf-sumo risk``: result folders -> where on the network the AV is in danger."""

from pathlib import Path
from typing import Any

import click

from deepmf_sumo.cli._parameters import results_argument


@click.command(name="risk", short_help="Map where a network is dangerous.")
@results_argument
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path),
    help="Write the map into this folder.  [default: OUT/risk, of the first OUT]",
)  # fmt: skip
@click.option(
    "--gis", "forms", type=click.Choice(["geojson", "gpkg"]), multiple=True,
    help="Also write places and attacks for QGIS and other programs; may be repeated.",
)  # fmt: skip
@click.option("--open", "show", is_flag=True, help="Show the page in the browser.")
def command(
    folders: tuple[Path, ...], out: Path | None, forms: tuple[Any, ...], show: bool
) -> None:
    """Map the risk of the networks that OUT..., results of attack or run, attacked on.

    For each movement, edge, junction and lane: attacks, hits, findings, least time to
    collision, delta-v. Written as CSV, SUMO edge data, polygons for sumo-gui, and a page; with
    --gis as GeoJSON or GeoPackage. OUT may contain result folders, e.g. one for each seed.
    """
    from deepmf_sumo.cli import _risk_screen
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report import risk as files
    from deepmf_sumo.results import risk

    place = out or folders[0] / "risk"
    title = ", ".join(folder.resolve().name for folder in folders)
    written = files.write(place, risk.read(folders), title, forms)
    _risk_screen.show_risk(written)
    screen.tell_switched_off(folders, err=False)
    if show:
        click.launch(str(written[0].folder / files.PAGE))
