"""ScenarioNet and MetaDrive: one scene in one pickle, read without running what it names."""

import hashlib
import pickle
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.datatypes import HISTORY_STEPS, AgentKind, Floats, Scene, Source
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import checks, description
from deepmf_sumo.readers.base import Refusal
from deepmf_sumo.readers.pickles import load_plain

KINDS: Final[dict[str, AgentKind]] = {
    "VEHICLE": "vehicle",
    "PEDESTRIAN": "pedestrian",
    "CYCLIST": "cyclist",
}
LARGEST_FILE: Final = 2**25
"""Bytes. The largest scene seen has 2 MB."""

_NAME = "scenarionet"
_PROTOCOLS = (2, 3, 4, 5)
_MALFORMED = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)


def accepts(path: Path) -> bool:
    """Whether the file is a pickle (one of protocol 0 or 1 is known by its name alone)."""
    try:
        with files.opened(path) as file:
            start = file.read(2)
    except OSError:
        return False
    pickled = len(start) == 2 and start[0] == 0x80 and start[1] in _PROTOCOLS
    return pickled or path.suffix in {".pkl", ".pickle"}


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The file's one scene."""
    try:
        yield checks.checked(_recording(path))
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name=path.stem, reason=str(error), dataset=_NAME)


def _recording(path: Path) -> checks.Recording:
    try:
        content = files.content(path, LARGEST_FILE)
        described = load_plain(content)
    except OSError as error:
        raise ReaderError(f"{path} cannot be read ({files.reason(error)}).") from None
    except pickle.UnpicklingError as error:
        raise ReaderError(f"{path} cannot be unpickled: {error}.") from None
    if not isinstance(described, dict) or not {"tracks", "map_features"} <= described.keys():
        raise ReaderError(
            f"{path} is a pickle, but no scene: it has no 'tracks' and 'map_features'. "
            "The summary and mapping files of a ScenarioNet folder are not needed."
        )
    source = Source(
        dataset=_NAME, file=str(path), record=0, sha256=hashlib.sha256(content).hexdigest()
    )
    try:
        with np.errstate(invalid="ignore"):  # what is no number is found by the checks
            return _described(described, source)
    except KeyError as error:
        raise ReaderError(f"{path} is no whole scene: it lacks the key {error}.") from None
    except _MALFORMED as error:
        raise ReaderError(f"{path} is no valid scene: {error}.") from None


def _described(described: Mapping[str, Any], source: Source) -> checks.Recording:
    metadata = described["metadata"]
    if metadata.get("metadrive_processed"):
        raise ReaderError(f"{source.file} was recorded in MetaDrive; take the file made of WOMD.")
    ids = [checks.identifier(key) for key in described["tracks"]]
    repairs: list[str] = []
    tracks = _tracks(ids, list(described["tracks"].values()))
    steps = tracks.valid.shape[1]
    return checks.Recording(
        name=checks.identifier(
            metadata.get("scenario_id", described.get("id", Path(source.file).stem))
        ),
        source=source,
        now=max(int(metadata.get("current_time_index", 0)), HISTORY_STEPS - 1),
        timestamps_s=np.asarray(metadata.get("ts", ()), float).reshape(-1),
        tracks=tracks,
        road=description.road(described["map_features"], repairs),
        signals=description.signals(
            described.get("dynamic_map_states", {}),
            steps,
            # Files of MetaDrive 0.3 write the same for an unknown and for a missing state.
            unknown_is_missing=str(described.get("version", "")).startswith("MetaDrive v0.3"),
            repairs=repairs,
        ),
        av_id=_av_id(metadata, ids),
        interest=tuple(map(checks.identifier, metadata.get("objects_of_interest", ()))),
        to_predict=tuple(map(checks.identifier, metadata.get("tracks_to_predict", ()))),
        repairs=repairs,
    )


def _av_id(metadata: Mapping[str, Any], ids: list[str]) -> str:
    if "sdc_id" in metadata:
        return checks.identifier(metadata["sdc_id"])
    index = int(metadata["sdc_track_index"])
    if not 0 <= index < len(ids):
        raise ValueError(f"sdc_track_index is {index}, but there are {len(ids)} tracks")
    return ids[index]


def _tracks(ids: list[str], tracks: list[Mapping[str, Any]]) -> checks.RecordingTracks:
    if not tracks:
        raise ValueError("it has no tracks")
    states = [track["state"] for track in tracks]
    position = np.array([_rows(state["position"]) for state in states])
    if position.shape[2] == 2:
        position = np.concatenate([position, np.zeros((*position.shape[:2], 1))], axis=2)
    steps = position.shape[1]
    return checks.RecordingTracks(
        ids=ids,
        kinds=[KINDS.get(str(track["type"]), "other") for track in tracks],
        size_m=np.array([_size(state, steps) for state in states]),
        position_m=position,
        heading_rad=np.array([_column(state["heading"], steps) for state in states]),
        velocity_mps=np.array([_rows(state["velocity"])[:, :2] for state in states]),
        valid=np.array([_column(state["valid"], steps) for state in states]) > 0,
    )


def _size(state: Mapping[str, Any], steps: int) -> Floats:
    """(T, 3); the earliest files have one key for all three."""
    if "size" in state:
        return _rows(state["size"])
    parts = (state["length"], state["width"], state["height"])
    return np.column_stack([_column(part, steps) for part in parts])


def _rows(values: Any) -> Floats:
    rows: Floats = np.asarray(values, float)
    if rows.ndim != 2:
        raise ValueError(f"an array over time has shape {rows.shape}, not (T, 2) or (T, 3)")
    return rows


def _column(values: Any, steps: int) -> Floats:
    """(T) from (T), (T, 1), or one number for all steps."""
    column = np.asarray(values, float).reshape(-1)
    if len(column) not in {1, steps}:
        raise ValueError(f"an array over time has {len(column)} values, not {steps}")
    return np.broadcast_to(column, (steps,))
