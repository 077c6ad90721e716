"""``deepmf-sumo data``: list recorded scenes, convert them to networks, record SUMO traffic."""

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.table import Table

from deepmf_sumo.cli._parameters import CommandGroup, format_option
from deepmf_sumo.errors import ConversionError, ReaderError, SimulationError, UsageError

if TYPE_CHECKING:
    from deepmf_sumo.training.convert_all import ConvertedScene

_DATA = click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
KINDS = ("grid", "spider", "random", "junctions", "motorway", "mix")
"""As in `training.generated`, which is not imported for help."""


@click.group(name="data", cls=CommandGroup, short_help="List, convert and record scenes.")
def command() -> None:
    """List recorded scenes, convert them to SUMO networks, and record SUMO traffic as scenes."""


@command.command(name="list", short_help="List the scenes of recorded files.")
@_DATA
@format_option
def list_scenes(data: tuple[Path, ...], form: str) -> None:
    """List the scenes of recorded files and folders, and say which of them can be used.

    DATA: WOMD TFRecords (plain or gzip), folders of Argoverse 2, ScenarioNet pickles, GPUDrive or
    Nocturne JSON, or .npz files of deepmf-sumo; the format is found by content. A scene is `ok`,
    `repaired` (with what was repaired), or `refused` (with the reason). Exit code 3 if no scene can
    be used.
    """
    from deepmf_sumo.cli._screen import emit, wide
    from deepmf_sumo.report import scene_table
    from deepmf_sumo.scene import readers

    console, rows = wide(_WIDTH), []
    counts: Counter[str] = Counter()
    file = None
    for row in map(scene_table.row, readers.scenes(data)):
        if form != "table":
            rows.append(row)
        else:
            _show(console, row, new_file=row["file"] != file)
            file = row["file"]
        counts[row["status"]] += 1
    total = sum(counts.values())
    if form == "table":
        parts = ", ".join(f"{counts[status]} {status}" for status in _STYLES)
        console.print(f"\n{total} scene{'s' * (total != 1)}: {parts}", highlight=False)
    else:
        emit(form, rows, scene_table.COLUMNS)
    if not total:
        raise ReaderError(f"There is no scene in {', '.join(map(str, data))}.")
    if total == counts["refused"]:
        raise ReaderError(f"None of the {total} records can be used; the table says why.")


# Rows are printed as they come, so that none is kept: fixed widths line them up.
_SHOWN = {"record": 6, "scene": 24, "status": 8, "steps": 5, "vehicles": 8, "pedestrians": 11} | {
    "cyclists": 8, "lanes": 5, "connections": 11, "signals": 7, "av": 6, "interest": 13,
}  # fmt: skip
_WIDTH = sum(_SHOWN.values()) + 2 * len(_SHOWN) + 2
_STYLES = {"ok": "green", "repaired": "yellow", "refused": "red"}


def _show(console: Console, row: dict[str, Any], *, new_file: bool) -> None:
    """A line for the scene, below the name of its file."""
    from deepmf_sumo.cli._screen import escape

    if new_file:
        console.print()
        console.print(escape(f"{row['file']}  {row['dataset']}".rstrip()), style="bold")
        console.print(_line({name: name for name in _SHOWN}, style="dim"))
    console.print(_line(row, style=""))
    if row["reason"]:
        reason = escape(f"{'':8}{row['reason']}")
        console.print(reason, style=_STYLES[row["status"]], highlight=False)


def _line(row: dict[str, Any], style: str) -> Table:
    from deepmf_sumo.cli._screen import escape

    table = Table(box=None, show_header=False, padding=(0, 1), style=style)
    for name, width in _SHOWN.items():
        is_text = name in {"scene", "status", "av", "interest"}
        justify: Any = "left" if is_text else "right"
        table.add_column(width=width, justify=justify, no_wrap=True, overflow="ellipsis")
    table.add_row(*(escape(str(row[name])) for name in _SHOWN))
    return table


@command.command(name="convert", short_help="Convert recorded scenes to SUMO networks.")
@_DATA
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path),
    help="Write the networks into this folder.",
)  # fmt: skip
@click.option(
    "--jobs", "-j", default=os.cpu_count() or 1, type=click.IntRange(min=1),
    help="Use this number of worker processes.  [default: all cores]",
)  # fmt: skip
def convert(data: tuple[Path, ...], out: Path, jobs: int) -> None:
    """Convert the road of each scene in DATA (files or folders) into a SUMO network.

    OUT gets a folder for each scene: net.net.xml for sumo-gui and netedit, scene.sumocfg to open it
    with the crosswalks, the plain XML that it was made of, and mapping.json (which SUMO lane is
    which of the scene's). OUT/convert.csv lists what was kept, what was lost and how far the lanes
    are off. Exit code 3 if a scene could not be converted.
    """
    from deepmf_sumo.scene import readers
    from deepmf_sumo.training.convert_all import TABLE, convert_all

    rows: list[ConvertedScene] = []
    for row in convert_all(readers.scenes(data), out, jobs):
        rows.append(row)
        if row.status == "failed":
            _say(f"{row.scene or '(no name)'}: {row.reason}")
    good = [row for row in rows if row.status == "ok"]
    worst = max((row.error_max_m or 0.0 for row in good), default=0.0)
    _say(
        f"{len(good)} of {len(rows)} scenes converted into {out}, "
        f"lanes at most {worst:.3f} m off; see {out / TABLE}."
    )
    if not rows:
        raise ConversionError(f"There is no scene in {', '.join(map(str, data))}.")
    if len(good) < len(rows):
        raise ConversionError(
            f"{len(rows) - len(good)} of {len(rows)} scenes could not be converted; "
            f"the reasons are in {out / TABLE}."
        )


def _say(line: str) -> None:
    Console(highlight=False).print(line, markup=False, soft_wrap=True)


_COUNT = click.IntRange(min=1)


@command.command(name="record", short_help="Record SUMO traffic as scenes to train on.")
@click.argument("configs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(file_okay=False, path_type=Path),
    help="Write the scenes into this folder.",
)  # fmt: skip
@click.option(
    "--generate", "kind", type=click.Choice(KINDS), help="Generate networks of this kind."
)
@click.option(
    "--networks", default=10, show_default=True, type=_COUNT,
    help="Generate this number of networks.",
)  # fmt: skip
@click.option(
    "--scenes", default=100, show_default=True, type=_COUNT,
    help="Record at most this number of scenes in each network.",
)  # fmt: skip
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(0, 2**32 - 1),
    help="Seed the networks, the traffic and the choice of scenes.",
)  # fmt: skip
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set start_s, every_s, avs or diverse, e.g. avs=2 scenes at a time; may be repeated.",
)  # fmt: skip
@click.option(
    "--jobs", "-j", default=1, show_default=True, type=_COUNT,
    help="Use this number of worker processes.",
)  # fmt: skip
def record(
    configs: tuple[Path, ...],
    out: Path,
    kind: str | None,
    networks: int,
    sets: tuple[str, ...],
    jobs: int,
    **wanted: Any,
) -> None:
    """Record SUMO traffic as scenes of 9.1 s: one .npz file each, a folder for each network.

    CONFIGS: .sumocfg files with a network and traffic. With --generate, networks with traffic are
    generated from the seed. The files are the same whatever --jobs; the same command again resumes
    where it was interrupted. A network that gives fewer scenes than asked for, or none, is named.
    Exit code 3 if a CONFIG or all networks gave none.
    """
    if not configs and not kind:
        raise UsageError("There is nothing to record: give a .sumocfg, or --generate KIND.")
    from deepmf_sumo.cli._keys import RecordKeys, taken
    from deepmf_sumo.training.recording.many import Recorded, Wanted, record_all

    keys, _ = taken(sets, RecordKeys)
    asked = Wanted(
        configs=configs, kind=kind or "mix", networks=networks if kind else 0, **dict(keys),
        **wanted,
    )  # fmt: skip
    done: list[Recorded] = []
    for network in record_all(asked, out, jobs):
        done.append(network)
        reason = f" ({network.reason})" if network.reason else ""
        _say(f"{network.name}: {network.scenes} scenes{reason}")
    total, empty = sum(one.scenes for one in done), [one for one in done if not one.scenes]
    skipped = f"; {len(empty)} skipped: {', '.join(one.name for one in empty)}" if empty else ""
    _say(f"{total} scenes of {len(done) - len(empty)} networks in {out}{skipped}")
    lost = [one for one in empty if one.given or not total]
    if lost:
        raise SimulationError(f"{lost[0].name} gave no scene: {lost[0].reason}.")
