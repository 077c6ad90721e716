"""GPUDrive and Nocturne: one scene in one JSON file, in all four forms that are about.

Links between lanes, boundaries and speed limits are not in these files; the links are inferred.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.datatypes import HISTORY_STEPS, Scene, Source
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import checks, nocturne
from deepmf_sumo.readers.base import Refusal

LARGEST_FILE: Final = 2**26
"""Bytes. The largest scene seen has 10 MB."""
HEAD: Final = 2**16
"""Bytes at the start of a file in which one of its keys is looked for."""

_NAME = "gpudrive"
_KEYS = (b'"objects"', b'"roads"', b'"tl_states"')
_MALFORMED = (TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError)


def accepts(path: Path) -> bool:
    """Whether the file is a JSON object with a key of these scenes near its start."""
    try:
        with files.opened(path) as file:
            start = file.read(HEAD)
    except OSError:
        return False
    return start.lstrip()[:1] == b"{" and any(key in start for key in _KEYS)


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The file's one scene."""
    try:
        yield checks.checked(_recording(path))
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name=path.stem, reason=str(error), dataset=_NAME)


def _recording(path: Path) -> checks.Recording:
    try:
        content = files.content(path, LARGEST_FILE)
        described = json.loads(content)
    except OSError as error:
        raise ReaderError(f"{path} cannot be read ({files.reason(error)}).") from None
    except (ValueError, RecursionError) as error:
        raise ReaderError(f"{path} is no valid JSON ({error}); copy it again.") from None
    source = Source(
        dataset=_NAME, file=str(path), record=0, sha256=hashlib.sha256(content).hexdigest()
    )
    try:
        with np.errstate(all="ignore"):  # what is no number is found by the checks
            return _described(described, source)
    except KeyError as error:
        raise ReaderError(f"{path} is no whole scene: it lacks the key {error}.") from None
    except _MALFORMED as error:
        raise ReaderError(f"{path} is no valid scene: {error}.") from None


def _described(described: Mapping[str, Any], source: Source) -> checks.Recording:
    if "ego_idx" in described:
        raise ValueError("its map was re-sampled (key 'ego_idx'); take the file it was made from")
    repairs: list[str] = []
    tracks = nocturne.tracks(described["objects"], repairs)
    metadata = described.get("metadata") or {}
    road = nocturne.road(described["roads"], repairs)
    return checks.Recording(
        name=checks.identifier(described.get("scenario_id") or Path(source.file).stem),
        source=source,
        now=HISTORY_STEPS - 1,
        timestamps_s=np.zeros(0),
        tracks=tracks,
        road=road,
        signals=nocturne.signals(
            described.get("tl_states") or {}, road.lanes, tracks.valid.shape[1], repairs
        ),
        av_id=_av_id(metadata, tracks),
        interest=tuple(map(checks.identifier, metadata.get("objects_of_interest", ()))),
        to_predict=tuple(
            _by_index(tracks.ids, wanted["track_index"], "tracks_to_predict")
            for wanted in metadata.get("tracks_to_predict", ())
        ),
        repairs=repairs,
    )


def _av_id(metadata: Mapping[str, Any], tracks: checks.RecordingTracks) -> str | None:
    index = metadata.get("sdc_track_index")
    if index is None:
        return nocturne.av_by_size(tracks)
    return _by_index(tracks.ids, index, "sdc_track_index")


def _by_index(ids: list[str], index: Any, what: str) -> str:
    if not 0 <= int(index) < len(ids):
        raise ValueError(f"{what} is {index}, but there are {len(ids)} objects")
    return ids[int(index)]
