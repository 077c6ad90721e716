"""``deepmf-sumo scenes``: what recorded files hold, a row a scene."""

import csv
import io
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from rich.console import Console
from rich.table import Table

from deepmf_sumo import files
from deepmf_sumo.cli._screen import escape, wide
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.texts import cell

if TYPE_CHECKING:  # numpy and the readers are loaded when the command runs
    from deepmf_sumo.datatypes import Scene
    from deepmf_sumo.readers import Refusal

COLUMNS: Final = (
    *("file", "record", "scene", "dataset", "status", "reason", "steps"),
    *("vehicles", "pedestrians", "cyclists", "lanes", "connections", "signals", "av", "interest"),
)
# Shown under their file, with fixed widths: rows are printed as they come, so that nothing is kept.
_SHOWN: Final = {
    "record": 6,
    "scene": 24,
    "status": 8,
    "steps": 5,
    "vehicles": 8,
    "pedestrians": 11,
    "cyclists": 8,
    "lanes": 5,
    "connections": 11,
    "signals": 7,
    "av": 6,
    "interest": 13,
}
_WIDTH: Final = sum(_SHOWN.values()) + 2 * len(_SHOWN) + 2
_STYLES: Final = {"ok": "green", "repaired": "yellow", "refused": "red"}

Row = dict[str, Any]


@click.command(name="scenes")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--csv",
    "csv_file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the rows, all columns, to this file as well.",
)
def command(data: tuple[Path, ...], csv_file: Path | None) -> None:
    """List the scenes of recorded files and folders, and say which of them can be used.

    DATA: WOMD TFRecords (plain or gzip), ScenarioNet pickles, GPUDrive or Nocturne JSON, or our own
    .npz files; the format is found by content. A scene is `ok`, `repaired` (with what was mended),
    or `refused` (with the reason). Ends with 3 if no scene can be used.
    """
    from deepmf_sumo import readers

    console = wide(_WIDTH)
    counts: Counter[str] = Counter()
    with _written(csv_file) as write:
        file = None
        for found in readers.scenes(data):
            row = _row(found)
            if row["file"] != file:
                file = row["file"]
                _show_file(console, row)
            _show(console, row)
            write(row)
            counts[row["status"]] += 1
    total = sum(counts.values())
    parts = ", ".join(f"{counts[status]} {status}" for status in _STYLES)
    console.print(f"\n{total} scenes: {parts}", highlight=False)
    if not total:
        raise ReaderError(f"There is no scene in {', '.join(map(str, data))}.")
    if total == counts["refused"]:
        raise ReaderError(f"None of the {total} records can be used; the table says why.")


def _row(found: "Scene | Refusal") -> Row:
    from deepmf_sumo.readers import Refusal

    if isinstance(found, Refusal):
        return dict.fromkeys(COLUMNS, "") | {
            "file": found.file,
            "record": found.record,
            "scene": found.name,
            "dataset": found.dataset,
            "status": "refused",
            "reason": found.reason,
        }
    kinds = Counter(found.tracks.kinds)
    return {
        "file": found.source.file,
        "record": found.source.record,
        "scene": found.name,
        "dataset": found.source.dataset,
        "status": "repaired" if found.repairs else "ok",
        "reason": " ".join(found.repairs),
        "steps": found.tracks.steps,
        "vehicles": kinds["vehicle"],
        "pedestrians": kinds["pedestrian"],
        "cyclists": kinds["cyclist"],
        "lanes": len(found.road.lanes),
        "connections": sum(len(lane.next) for lane in found.road.lanes.values()),
        "signals": len(found.signals.lane_ids),
        "av": found.av_id,
        "interest": " ".join(found.interest),
    }


def _show_file(console: Console, row: Row) -> None:
    """The file's name, and the names of the columns."""
    console.print()
    console.print(escape(f"{row['file']}  {row['dataset']}".rstrip()), style="bold")
    console.print(_line({name: name for name in _SHOWN}, style="dim"))


def _show(console: Console, row: Row) -> None:
    console.print(_line(row, style=""))
    if row["reason"]:
        console.print(
            escape(f"{'':8}{row['reason']}"), style=_STYLES[row["status"]], highlight=False
        )


def _line(row: Row, style: str) -> Table:
    """A table of one row; the widths line the rows up."""
    table = Table(box=None, show_header=False, padding=(0, 1), style=style)
    for name, width in _SHOWN.items():
        is_text = name in {"scene", "status", "av", "interest"}
        justify: Any = "left" if is_text else "right"
        table.add_column(width=width, justify=justify, no_wrap=True, overflow="ellipsis")
    table.add_row(*(escape(str(row[name])) for name in _SHOWN))
    return table


@contextmanager
def _written(path: Path | None) -> Iterator[Any]:
    """A function that writes a row; the file appears whole when all rows are there."""
    if path is None:
        yield lambda _: None
        return
    with files.writing(path), files.whole(path) as file:
        text = io.TextIOWrapper(file, "utf-8", newline="")
        writer = csv.DictWriter(text, COLUMNS)
        writer.writeheader()
        yield lambda row: writer.writerow(
            {key: cell(one) if isinstance(one, str) else one for key, one in row.items()}
        )
        text.detach()  # flushed; the file is closed when it is whole
