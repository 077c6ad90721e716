"""The package's own format: one scene in one .npz file, lossless and without pickled objects.

Motion, signals and timestamps are arrays of their own. The points of all road features are in one
array each (``road_points_m`` (P, 2), ``road_z_m`` (P)), feature after feature, in the order of the
description: lanes, lines, edges, polygons, stop signs; and what is beside the road, where a map has
it: buildings, footways, water. The description is JSON and contains all
other fields of the dataclasses under their names; a feature has its number of points besides.
"""

import dataclasses
import functools
import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    Boundary,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    Source,
    StopSign,
    Tracks,
    dtype_of,
)
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.scene import EDGE_TYPES, LINE_TYPES

FORMAT_VERSION: Final = 1
LARGEST_FILE: Final = 2**27
"""Unpacked size of a file, bytes. The largest known scene has 8 MB."""

Arrays = dict[str, np.ndarray]

_DAMAGES: Final = (
    *(OSError, EOFError, ValueError, KeyError, RuntimeError, struct.error),
    *(zlib.error, zipfile.BadZipFile),
)
"""Exceptions of damaged archives and arrays; NotImplementedError is a RuntimeError."""


def write(scene: Scene, path: Path) -> None:
    """Write a scene to a file that appears complete or not at all. Raises OSError."""
    arrays = _to_arrays(scene)
    with files.whole(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def roots(folder: Path) -> list[Path] | None:
    """The scenes that the runs of a result folder wrote."""
    if (folder / "runs.csv").is_file() and (folder / "runs").is_dir():
        return list(folder.glob("runs/*/scene.npz"))
    return None


def recordings(root: Path) -> Iterator[RecordRef]:
    """The scene of a zip archive with a description, or of a file that is named as a native one."""
    if not _is_scene(root):
        return
    try:
        scene = _scene(root)
    except ReaderError:
        yield RecordRef(file=root, name=root.stem, record=0)
        return
    yield RecordRef(file=root, name=scene.name, record=0, content=scene)


def load(ref: RecordRef) -> Scene:
    """The scene as it was written; its source is the original recording."""
    return ref.content or _scene(ref.file)


def _is_scene(path: Path) -> bool:
    try:
        with files.opened(path) as file:
            if file.read(4) != b"PK\x03\x04":
                return path.suffix == ".npz"
            with zipfile.ZipFile(file) as archive:
                return {"format_version.npy", "description.npy"} <= set(archive.namelist())
    except Exception:  # noqa: BLE001 - a damaged archive can raise anything
        return path.suffix == ".npz"


def _scene(path: Path) -> Scene:
    try:
        arrays = _arrays(path)
    except _DAMAGES as error:
        why = files.reason(error) if isinstance(error, OSError) else str(error)
        raise ReaderError(
            f"{path} is damaged ({why}); write it again from the recording."
        ) from None
    version = arrays["format_version"]
    if version.tolist() != FORMAT_VERSION:
        raise ReaderError(
            f"{path} has format version {str(version)[:40]}; this program reads "
            f"{FORMAT_VERSION}. Write it again from the recording."
        )
    try:
        return _from_arrays(arrays)
    except ReaderError as error:
        raise ReaderError(f"{path} is not a scene: {error}.") from None


# The archive


def _arrays(path: Path) -> Arrays:
    """All arrays. Raises ReaderError if they are too large, and any of `_DAMAGES`."""
    with files.opened(path) as file, zipfile.ZipFile(file) as archive:
        size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST_FILE:
            raise ReaderError(
                f"{path} unpacks to {size} bytes, more than the {LARGEST_FILE} allowed."
            )
        return {name: _array(archive, f"{name}.npy") for name in _NAMES}


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array; its size is checked before numpy allocates it."""
    if archive.getinfo(name).compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        raise ValueError(f"{name} is not packed with deflate")
    content = io.BytesIO(archive.read(name))
    try:
        version = np.lib.format.read_magic(content)
        shape, _, dtype = np.lib.format.read_array_header_1_0(content)
    except Exception as error:  # noqa: BLE001 - numpy reads the header as Python text
        raise ValueError(f"the header of {name} cannot be read: {error}") from None
    if version != (1, 0):
        raise ValueError(f"{name} is of npy version {version}")
    needed = math.prod(shape) * dtype.itemsize
    there = len(content.getbuffer()) - content.tell()
    if dtype.hasobject or min(shape, default=0) < 0 or needed != there:
        raise ValueError(f"{name} says {dtype} of shape {shape}, but has {there} bytes")
    content.seek(0)
    return np.lib.format.read_array(content, allow_pickle=False)


# Fields of the dataclasses: arrays, points of road features, and those of the description


def _hints(kind: type) -> dict[str, Any]:
    """The types of a dataclass's fields, in order."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _letters(kind: type) -> dict[str, str]:
    """The fields that are arrays, with numpy's letter for the kind of their numbers."""
    dtypes = {name: dtype_of(hint) for name, hint in _hints(kind).items()}
    return {name: np.dtype(one).kind for name, one in dtypes.items() if one is not None}


@functools.cache
def _described_fields(kind: type) -> dict[str, Any]:
    """The fields that the description contains, and their types."""
    apart = {"z_m", *_letters(kind), *_PARTS}
    return {name: hint for name, hint in _hints(kind).items() if name not in apart}


_PARTS: Final = {"tracks", "road", "signals"}
_OPTIONAL: Final[dict[str, Any]] = {"gives_way_to": ()}
"""Fields that are written only if they have a value, since recordings do not have them."""
_FEATURES: Final[dict[str, type]] = {
    "lanes": Lane,
    "lines": Polyline,
    "edges": Polyline,
    "polygons": Polygon,
    "stop_signs": StopSign,
    **(_BESIDE := dict.fromkeys(("buildings", "footways", "water"), Polygon)),
}
"""Those of `_BESIDE` are left out where the map has none: files of earlier versions have none."""
_POINTS: Final = {kind: next(iter(_letters(kind))) for kind in _FEATURES.values()}
"""The field with the points of a feature; their heights are ``z_m``."""
_LETTERS: Final = {
    "timestamps_s": "f",
    "road_points_m": "f",
    "road_z_m": "f",
    **{f"tracks_{name}": letter for name, letter in _letters(Tracks).items()},
    **{f"signals_{name}": letter for name, letter in _letters(Signals).items()},
}
_NAMES: Final = ("format_version", "description", *_LETTERS)
_CALLED: Final = {"b": "booleans", "u": "bytes", "f": "real numbers"}


# Scene -> arrays


def _to_arrays(scene: Scene) -> Arrays:
    """The scene as arrays; `_from_arrays` returns an equal scene."""
    points, heights = [np.zeros((0, 2))], [np.zeros(0)]
    road: dict[str, list[dict[str, Any]]] = {key: [] for key in _FEATURES}
    for key, kind in _FEATURES.items():
        features = getattr(scene.road, key)
        if features is None or (not features and key in {"buildings", "water"}):
            del road[key]
            continue
        for feature in features.values() if key == "lanes" else features:
            points.append(getattr(feature, _POINTS[kind]).reshape(-1, 2))
            heights.append(np.atleast_1d(feature.z_m))
            road[key].append(_plain(feature) | {"points": len(points[-1])})
    description = _plain(scene) | _plain(scene.tracks)
    description |= {"signal_lane_ids": scene.signals.lane_ids, "road": road}
    text = json.dumps(description, default=dataclasses.asdict)
    return {
        "format_version": np.array(FORMAT_VERSION),
        "description": np.frombuffer(text.encode(), "uint8"),
        "timestamps_s": scene.timestamps_s,
        "road_points_m": np.concatenate(points),
        "road_z_m": np.concatenate(heights),
        **{f"tracks_{name}": getattr(scene.tracks, name) for name in _letters(Tracks)},
        **{f"signals_{name}": getattr(scene.signals, name) for name in _letters(Signals)},
    }


def _plain(value: Any) -> dict[str, Any]:
    kind: type = type(value)
    fields = {name: getattr(value, name) for name in _described_fields(kind)}
    return {name: field for name, field in fields.items() if field or name not in _OPTIONAL}


# Arrays -> scene


class _Description(BaseModel):
    """The described fields of a dataclass, checked key by key."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)
    of: ClassVar[type]

    def built(self, **others: Any) -> Any:
        """The dataclass, with ``others`` for the fields that are not in the description."""
        fields = _described_fields(self.of)
        return self.of(**{name: _built(value) for name, value in self if name in fields}, **others)


def _built(value: Any) -> Any:
    if isinstance(value, _Description):
        return value.built()
    return tuple(map(_built, value)) if isinstance(value, tuple) else value


def _model(kind: type, /, **more: Any) -> type[_Description]:
    """A model of the described fields of a dataclass, and of ``more`` keys."""
    fields: dict[str, Any] = {
        name: (_LIMITED.get((name, hint), _LIMITED.get(hint, hint)), _OPTIONAL.get(name, ...))
        for name, hint in _described_fields(kind).items()
    }
    fields |= {name: (hint, ...) for name, hint in more.items()}
    model = create_model(kind.__name__, __base__=_Description, **fields)
    model.of = kind
    return model


_Count = Annotated[int, Field(ge=0, lt=2**31)]
_Amount = Annotated[float, Field(ge=0, lt=1e6)]
_LIMITED: Final[dict[Any, Any]] = {
    int: Annotated[int, Field(ge=-1, lt=2**31)],  # WOMD's neighbours can end before they start
    float: _Amount,
    float | None: _Amount | None,
    ("record", int): _Count,
    ("now", int): _Count,
    ("kind", int): Annotated[int, Field(ge=0, lt=LINE_TYPES)],
}
"""Limits of numbers, by the field's name and type or by its type alone; and nested models."""
_LIMITED[Source] = _model(Source)
_LIMITED |= {tuple[kind, ...]: tuple[_model(kind), ...] for kind in (Neighbour, Boundary)}  # type: ignore[valid-type, misc]
_ONE: Final = Annotated[int, Field(ge=1, le=1)]
_EDGE: Final = {"kind": Annotated[int, Field(ge=0, lt=EDGE_TYPES)]}
_ROAD: Final[dict[str, Any]] = {
    key: (
        list[  # type: ignore[misc]
            _model(
                kind,
                points=_ONE if kind is StopSign else _Count,
                **(_EDGE if key == "edges" else {}),
            )
        ],
        None if key in _BESIDE else ...,
    )
    for key, kind in _FEATURES.items()
}
_SCENE: Final = _model(
    Scene,
    **_described_fields(Tracks),
    signal_lane_ids=tuple[str, ...],
    road=create_model("Road", __base__=_Description, **_ROAD),
)


def _from_arrays(arrays: Arrays) -> Scene:
    """The scene of the arrays `_NAMES`. Raises ReaderError, naming the field that is wrong."""
    described = _parsed(arrays["description"].tobytes())
    _check_arrays(arrays, described)
    tracks = {name: arrays[f"tracks_{name}"] for name in _letters(Tracks)}
    signals = {name: arrays[f"signals_{name}"] for name in _letters(Signals)}
    return described.built(
        timestamps_s=arrays["timestamps_s"],
        tracks=Tracks(ids=described.ids, kinds=described.kinds, **tracks),
        road=_road(described.road, arrays["road_points_m"], arrays["road_z_m"]),
        signals=Signals(lane_ids=described.signal_lane_ids, **signals),
    )


def _parsed(text: bytes) -> Any:
    try:
        return _SCENE.model_validate_json(text)
    except ValidationError as error:
        first: Any = error.errors(include_url=False, include_context=False)[0]
    key = ".".join(str(part) for part in first["loc"])
    where = f"key '{key[:100]}' of its description" if key else "its description"
    raise ReaderError(f"{where}: {first['msg'][:200]}")


def _check_arrays(arrays: Arrays, described: Any) -> None:
    """Raises ReaderError for an array whose type or shape contradicts the description."""
    agents, signals = len(described.ids), len(described.signal_lane_ids)
    if len(described.kinds) != agents:
        raise ReaderError(f"'kinds' has {len(described.kinds)} items, but there are {agents} ids")
    if described.av_id not in described.ids:
        raise ReaderError(f"'av_id' is '{described.av_id}', but there is no such agent")
    steps = arrays["timestamps_s"].size
    points = sum(
        feature.points for key in _FEATURES for feature in getattr(described.road, key) or ()
    )
    shapes = {
        "timestamps_s": (steps,),
        "road_points_m": (points, 2),
        "road_z_m": (points,),
        "tracks_size_m": (agents, 3),
        "tracks_position_m": (agents, steps, 2),
        "tracks_z_m": (agents, steps),
        "tracks_heading_rad": (agents, steps),
        "tracks_velocity_mps": (agents, steps, 2),
        "tracks_valid": (agents, steps),
        "signals_state": (signals, steps),
        "signals_seen": (signals, steps),
        "signals_stop_m": (signals, 2),
        "signals_stop_z_m": (signals,),
    }
    for name, letter in _LETTERS.items():
        array, shape = arrays[name], shapes[name]
        if array.dtype.kind != letter:
            raise ReaderError(f"array '{name}' contains {array.dtype}, not {_CALLED[letter]}")
        if array.shape != shape:
            raise ReaderError(f"array '{name}' has shape {array.shape}, not {shape}")


def _road(described: Any, xy: np.ndarray, z: np.ndarray) -> RoadMap:
    start = 0
    road: dict[str, list[Any]] = {key: [] for key in _FEATURES}
    for key, kind in _FEATURES.items():
        for one in getattr(described, key) or ():
            stop = start + one.points
            at: Any = (xy[start:stop], z[start:stop])
            if kind is StopSign:
                at = (xy[start], z.item(start))
            road[key].append(one.built(**{_POINTS[kind]: at[0], "z_m": at[1]}))
            start = stop
    lanes = {lane.id: lane for lane in road.pop("lanes")}
    if len(lanes) < len(described.lanes):
        raise ReaderError("two lanes have the same id")
    if described.footways is None:
        del road["footways"]
    return RoadMap(lanes=lanes, **{key: tuple(features) for key, features in road.items()})
