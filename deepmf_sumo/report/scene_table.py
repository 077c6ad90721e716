"""Recorded scenes -> a table with one row each."""

from collections import Counter
from typing import Any, Final

from deepmf_sumo.scene import Scene
from deepmf_sumo.scene.readers import Refusal

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
