"""ScenarioNet and MetaDrive: one scene in one pickle, read without running what it names.

Neighbours of lanes are under singular keys, indices can be text, and crosswalks changed their name.
The lanes' ``width`` was computed by the converter and is not read.
"""

import pickle
from collections.abc import Iterator, Mapping
from functools import partial
from operator import getitem
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import (
    HISTORY_STEPS,
    AgentKind,
    Bools,
    Floats,
    Ints,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
)
from deepmf_sumo.datatypes.scene import LaneKind, PolygonKind
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import _single_file
from deepmf_sumo.readers._pickle import load_plain
from deepmf_sumo.readers._recording import (
    MPS_PER_MPH,
    Recording,
    RecordingTracks,
    RoadBuilder,
    SignalsBuilder,
    agent_at,
    boundary,
    identifier,
    neighbour,
)
from deepmf_sumo.readers.base import Refusal

KINDS: Final[dict[str, AgentKind]] = {
    "VEHICLE": "vehicle",
    "PEDESTRIAN": "pedestrian",
    "CYCLIST": "cyclist",
}
LANE_KINDS: Final[dict[str, LaneKind]] = {
    "LANE_FREEWAY": "freeway",
    "LANE_SURFACE_STREET": "street",
    "LANE_BIKE_LANE": "bike",
}
LINE_KINDS: Final = (
    "ROAD_LINE_UNKNOWN",
    "ROAD_LINE_BROKEN_SINGLE_WHITE",
    "ROAD_LINE_SOLID_SINGLE_WHITE",
    "ROAD_LINE_SOLID_DOUBLE_WHITE",
    "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    "ROAD_LINE_BROKEN_DOUBLE_YELLOW",
    "ROAD_LINE_SOLID_SINGLE_YELLOW",
    "ROAD_LINE_SOLID_DOUBLE_YELLOW",
    "ROAD_LINE_PASSING_DOUBLE_YELLOW",
)
"""By WOMD's RoadLine.type."""
EDGE_KINDS: Final = ("ROAD_EDGE_UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN")
"""By WOMD's RoadEdge.type."""
POLYGON_KINDS: Final[dict[str, PolygonKind]] = {
    "CROSSWALK": "crosswalk",
    "CROSS_WALK": "crosswalk",
    "SPEED_BUMP": "speed_bump",
    "DRIVEWAY": "driveway",
}
STATES: Final = {f"LANE_STATE_{state.name}": state.value for state in SignalState}
"""Signal states in files of all versions but the earliest, which have numbers."""
LARGEST_FILE: Final = 2**25
"""Bytes. The largest known scene has 2 MB."""

Described = Mapping[str, Any]

_NAME = "scenarionet"
_STARTS = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def accepts(path: Path) -> bool:
    """Whether the file is a pickle (protocols 0 and 1 are recognised by the file's name alone)."""
    start = _single_file.head(path, 2)
    return start in _STARTS or (start is not None and path.suffix in {".pkl", ".pickle"})


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The file's one scene."""
    return _single_file.found(path, _NAME, _scene)


def _scene(path: Path) -> Scene:
    return _single_file.scene(path, _NAME, LARGEST_FILE, _parsed, _described)


def _parsed(content: bytes) -> Described:
    try:
        described = load_plain(content)
    except pickle.UnpicklingError as error:
        raise ReaderError(f"cannot be unpickled: {error}") from None
    if not isinstance(described, dict) or not {"tracks", "map_features"} <= described.keys():
        raise ReaderError(
            "is a pickle, but not a scene: it has no 'tracks' and 'map_features'. "
            "The summary and mapping files of a ScenarioNet folder are not needed"
        )
    return described


def _described(described: Described, source: Source) -> Recording:
    metadata = described["metadata"]
    if metadata.get("metadrive_processed"):
        raise ReaderError(f"{source.file} was recorded in MetaDrive; take the file made of WOMD.")
    ids = [identifier(key) for key in described["tracks"]]
    repairs: list[str] = []
    tracks = _tracks(ids, list(described["tracks"].values()))
    scene_id = metadata.get("scenario_id", described.get("id", Path(source.file).stem))
    return Recording(
        name=identifier(scene_id),
        source=source,
        now=max(int(metadata.get("current_time_index", 0)), HISTORY_STEPS - 1),
        timestamps_s=np.asarray(metadata.get("ts", ()), float).reshape(-1),
        tracks=tracks,
        road=_road(described["map_features"], repairs),
        signals=_signals(
            described.get("dynamic_map_states", {}),
            tracks.valid.shape[1],
            # Files of MetaDrive 0.3 write the same for an unknown and for a missing state.
            unknown_is_missing=str(described.get("version", "")).startswith("MetaDrive v0.3"),
            repairs=repairs,
        ),
        av_id=identifier(metadata["sdc_id"])
        if "sdc_id" in metadata
        else agent_at(ids, metadata["sdc_track_index"], "sdc_track_index"),
        interest=tuple(map(identifier, metadata.get("objects_of_interest", ()))),
        to_predict=tuple(map(identifier, metadata.get("tracks_to_predict", ()))),
        repairs=repairs,
    )


def _tracks(ids: list[str], tracks: list[Described]) -> RecordingTracks:
    if not tracks:
        raise ValueError("it has no tracks")
    states = [track["state"] for track in tracks]
    position = np.array([_rows(state["position"]) for state in states])
    if position.shape[2] == 2:
        position = np.concatenate([position, np.zeros((*position.shape[:2], 1))], axis=2)
    steps = position.shape[1]
    return RecordingTracks(
        ids=ids,
        kinds=[KINDS.get(str(track["type"]), "other") for track in tracks],
        size_m=np.array([_size(state, steps) for state in states]),
        position_m=position,
        heading_rad=np.array([_column(state["heading"], steps) for state in states]),
        velocity_mps=np.array([_rows(state["velocity"])[:, :2] for state in states]),
        valid=np.array([_column(state["valid"], steps) for state in states]) > 0,
    )


def _size(state: Described, steps: int) -> Floats:
    """(T, 3); the earliest files have one key for all three."""
    if "size" in state:
        return _rows(state["size"])
    return np.column_stack([_column(state[key], steps) for key in ("length", "width", "height")])


def _rows(values: Any) -> Floats:
    rows = np.asarray(values, float)
    if rows.ndim != 2:
        raise ValueError(f"an array over time has shape {rows.shape}, not (T, 2) or (T, 3)")
    return rows


def _column(values: Any, steps: int) -> Floats:
    """(T) from (T), (T, 1), or one number for all steps."""
    column = np.asarray(values, float).reshape(-1)
    if len(column) not in {1, steps}:
        raise ValueError(f"an array over time has {len(column)} values, not {steps}")
    return np.broadcast_to(column, (steps,))


def _road(features: Mapping[Any, Described], repairs: list[str]) -> RoadMap:
    """The road. Features of unknown kinds are dropped and listed in ``repairs``."""
    road = RoadBuilder()
    unknown: set[str] = set()
    for key, feature in features.items():
        name, kind = identifier(key), identifier(feature["type"])
        # UNKNOWN is a lane's and a road line's type; only lanes have a speed limit.
        if kind.startswith("LANE_") or "speed_limit_mph" in feature:
            _add_lane(road, name, kind, feature)
        elif kind == "UNKNOWN" or kind.startswith("ROAD_LINE_"):
            road.line(name, _number(LINE_KINDS, kind), _points(feature["polyline"]))
        elif kind.startswith("ROAD_EDGE_"):
            road.edge(name, _number(EDGE_KINDS, kind), _points(feature["polyline"]))
        elif kind in POLYGON_KINDS:
            outline = feature["polygon"] if "polygon" in feature else feature["polyline"]
            road.polygon(name, POLYGON_KINDS[kind], _points(outline))
        elif kind == "STOP_SIGN":
            road.stop_sign(name, _point(feature), tuple(map(identifier, feature.get("lane", ()))))
        else:
            unknown.add(kind)
    if unknown:
        repairs.append(f"Map features of unknown kinds were dropped: {', '.join(sorted(unknown))}.")
    return road.built()


def _add_lane(road: RoadBuilder, name: str, kind: str, feature: Described) -> None:
    limit_mph = float(feature.get("speed_limit_mph") or 0.0)
    beside = {
        side: feature.get(f"{side}_neighbor", feature.get(f"{side}_neighbors", ()))
        for side in ("left", "right")
    }
    road.lane(
        name,
        LANE_KINDS.get(kind, "unknown"),
        _points(feature["polyline"]),
        interpolating=bool(feature.get("interpolating", False)),
        speed_limit_mps=limit_mph * MPS_PER_MPH if limit_mph > 0 else None,
        next=tuple(map(identifier, feature.get("exit_lanes", ()))),
        previous=tuple(map(identifier, feature.get("entry_lanes", ()))),
        **{
            side: tuple(neighbour(partial(getitem, one)) for one in listed)
            for side, listed in beside.items()
        },
        **{
            key: tuple(
                boundary(partial(getitem, one), _number(LINE_KINDS, one["boundary_type"]))
                for one in feature.get(key, ())
            )
            for key in ("left_boundaries", "right_boundaries")
        },
    )


def _number(kinds: tuple[str, ...], kind: Any) -> int:
    """WOMD's number of a kind; 0 (unknown) for a road edge beside a lane, as in WOMD."""
    return kinds.index(kind) if kind in kinds else 0


def _point(feature: Described) -> Floats:
    """(3) position; a missing third coordinate is 0."""
    position = np.asarray(feature["position"], float).reshape(-1)
    if len(position) < 2:
        raise ValueError(f"a stop sign has {len(position)} coordinates")
    return np.append(position, 0.0)[:3]


def _points(values: Any) -> Floats:
    """(P, 3); a missing third coordinate is 0."""
    points = np.asarray(values, float)
    points = points.reshape(len(points), -1)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    if len(points) and points.shape[1] != 3:
        raise ValueError(f"points have {points.shape[1]} coordinates")
    return points.reshape(-1, 3)


def _signals(
    described: Mapping[Any, Described],
    steps: int,
    unknown_is_missing: bool,
    repairs: list[str],
) -> Signals:
    """Signals over all steps.

    Args:
        described: by lane id.
        steps: of the scene.
        unknown_is_missing: the file writes UNKNOWN for steps without a state, too.
        repairs: gets a sentence for unknown states.
    """
    signals = SignalsBuilder([identifier(key) for key in described], steps)
    strange: set[str] = set()
    for row, light in enumerate(described.values()):
        listed = light["state"]["object_state"]
        if isinstance(listed, np.ndarray) and listed.dtype.kind in "iuf":
            numbers, there = _from_numbers(listed)
            points = np.asarray(light["state"]["stop_point"], float).reshape(len(listed), -1)
            points = points[there]
        else:
            numbers, there = _from_names(listed, unknown_is_missing, strange)
            points = np.asarray(light["stop_point"], float).reshape(1, -1)
        if len(points):
            signals.stop_m[row, : points.shape[1]] = points[-1]
        kept = min(steps, len(numbers))
        signals.seen[row, :kept] = there[:kept]
        signals.state[row, :kept] = np.where(there, numbers, 0)[:kept]
    if strange:
        repairs.append(f"Unknown signal states were read as unknown: {', '.join(sorted(strange))}.")
    return signals.built()


def _from_numbers(listed: np.ndarray) -> tuple[Ints, Bools]:
    """The earliest files: WOMD's numbers, 0 at steps without a state."""
    numbers = listed.reshape(-1).astype("int64")
    return np.clip(numbers, 0, 255), numbers > 0


def _from_names(listed: Any, unknown_is_missing: bool, strange: set[str]) -> tuple[Ints, Bools]:
    names = [None if name is None else identifier(name) for name in listed]
    strange.update(name for name in names if name is not None and name not in STATES)
    numbers = np.array([STATES.get(name or "", 0) for name in names], "int64")
    there = np.array([name is not None for name in names], bool)
    if unknown_is_missing:
        there &= numbers > 0
    return numbers, there
