"""``deepmf-sumo export``: result folders -> files of other programs."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from deepmf_sumo.cli._parameters import results_argument
from deepmf_sumo.errors import UsageError, exit_code
from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.report.risk.gis import Form
    from deepmf_sumo.results.exports import Export, Only


_MAPS: "Final[dict[str, tuple[Form, ...]]]" = {
    "geojson": ("geojson",),
    "geopackage": ("gpkg",),
    "gpkg": ("gpkg",),
    "csv": (),
}
"""Formats of places and attacks of all runs, which `risk` writes, by its ``--gis``."""
_LISTED: Final = 5
"""Ids of runs in a line."""


@click.command("export", short_help="Write runs in the format of another program.")
@results_argument
@click.option("--to", "name", metavar="FORMAT", required=True, help="Write this format.")
@click.option(
    "--only", type=click.Choice(["hits", "findings"]),
    help="Write only hits, or only findings: errors of the AV and avoidable hits.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path),
    help="Write below this folder.  [default: beside each run's tracks]",
)  # fmt: skip
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set a setting of the format, e.g. without_av=true (openscenario); may be repeated.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace what was written before.")
@click.pass_context
def command(
    ctx: click.Context,
    folders: tuple[Path, ...],
    name: str,
    only: "Only | None",
    out: Path | None,
    sets: tuple[str, ...],
    overwrite: bool,
) -> None:
    """Write the runs of OUT... in a format that another program reads.

    OUT is a result folder, or the folder of one run (RESULTS/runs/RUN_ID). A run's file is named
    like its format and lies beside the run's tracks, or in DIR/runs/RUN_ID with --out DIR. Runs
    without a result or without tracks are left out, and it says which. geopackage, geojson and csv
    are one map of all runs: what risk writes, into OUT/risk.

    Exit code 3: a run could not be written; the others are.
    """
    from deepmf_sumo.results import exports

    if name in _MAPS:
        if only or sets:
            raise UsageError(f"--to {name} is one map of all runs; it takes --out alone.")
        _write_map(folders, out, _MAPS[name])
        return
    form = exports.Format.named(name, _values(sets))
    runs = exports.chosen(folders)
    found = list(exports.export(runs, form, out=out, only=only, overwrite=overwrite))
    _show(name, found)
    ctx.exit(exit_code("failed" if any(one.outcome == "failed" for one in found) else "fine"))


def _write_map(folders: tuple[Path, ...], out: Path | None, forms: "tuple[Form, ...]") -> None:
    """Write what `risk` writes, and name the files of the format."""
    from deepmf_sumo.report.risk import folder as files
    from deepmf_sumo.results import risk

    title = ", ".join(one.resolve().name for one in folders)
    for one in files.write(out or folders[0] / "risk", risk.read(folders), title, forms):
        names = one.more if forms else files.TABLES
        click.echo(", ".join(str(one.folder / name) for name in names))


def _values(sets: tuple[str, ...]) -> dict[str, str]:
    values = {}
    for one in sets:
        key, equals, text = one.partition("=")
        if not (equals and key.strip()):
            raise UsageError(f"--set {one}: must be key=value, e.g. version=3.0.")
        values[key.strip()] = text.strip()
    return values


def _show(name: str, found: "Sequence[Export]") -> None:
    """What was written, and a line for each reason why a run was not."""
    from deepmf_sumo.report.table import counted

    written = [one for one in found if one.outcome == "written"]
    click.echo(f"{name}: {len(written)} of {counted(len(found), 'run')} written")
    if written:
        more = f" and {len(written) - 1} more" * (len(written) > 1)
        click.echo(shown(f"{written[0].path}{more}"))
    for outcome, word in (("written", "note"), ("left out", "left out"), ("failed", "failed")):
        for reason, ids in _by_reason(found, outcome).items():
            some = ", ".join(ids[:_LISTED]) + (", ..." if len(ids) > _LISTED else "")
            line = f"{word}: {counted(len(ids), 'run')}: {reason}: {some}"
            click.echo(shown(line), err=outcome == "failed")


def _by_reason(found: "Sequence[Export]", outcome: str) -> dict[str, list[str]]:
    ids = defaultdict(list)
    for one in found:
        if one.outcome == outcome and one.reason:
            ids[one.reason].append(one.run_id)
    return ids
