"""Recorded scenes -> a table with one row each."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files
from deepmf_sumo.scene import Scene
from deepmf_sumo.scene.readers import Refusal
from deepmf_sumo.texts import cell

COLUMNS: Final = (
    *("file", "record", "scene", "dataset", "status", "reason", "steps"),
    *("vehicles", "pedestrians", "cyclists", "lanes", "connections", "signals", "av", "interest"),
)

Row = dict[str, Any]


def row(found: Scene | Refusal) -> Row:
    """What a scene holds, or why it cannot be used, by column."""
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


@contextmanager
def written(path: Path | None) -> Iterator[Callable[[Row], Any]]:
    """A function that writes a row to a CSV file, which appears when all rows are there."""
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
