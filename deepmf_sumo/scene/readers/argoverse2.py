"""Argoverse 2 motion forecasting: a scenario is a folder with a table and a map.

``scenario_<id>.parquet`` has a row per road user and step, ``log_map_archive_<id>.json`` the map.
Scenarios have 110 steps, of which 50 are before the moment of prediction. A scene is the last 91 of
them, so that the 8 s that an attack may take are recorded; its current step is the scenario's 29.
(From the moment of prediction on there are 6 s alone.) Of the test split, which has 50 steps, a
scene has all.

The files have no sizes, no heights of road users, no signals and no speed limits. Sizes are those
typical of a class (`CLASSES`), and heights are those of the nearest lane, which can be a wrong one
where roads cross on several levels.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    HISTORY_STEPS,
    AgentKind,
    Boundary,
    Floats,
    Lane,
    Neighbour,
    RoadMap,
    Source,
)
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks
from deepmf_sumo.scene.readers.raw.ground import ground_m
from deepmf_sumo.scene.readers.raw.motion import FARTHEST_M
from deepmf_sumo.scene.readers.raw.one_file import MALFORMED, head
from deepmf_sumo.scene.readers.raw.road import (
    RoadBuilder,
    SignalsBuilder,
    identifier,
)
from deepmf_sumo.scene.road_users import ROAD_USERS

LARGEST_FILE: Final = 2**25
"""Bytes of the table, and of the map. Scenarios have 0.1 MB to 0.5 MB of each."""
STEPS: Final = HISTORY_STEPS + FUTURE_STEPS
AV_ID: Final = "AV"
AV_SIZE_M: Final = (4.9, 1.9, 1.5)
"""The recording vehicles are Ford Fusions."""
CLASSES: Final[dict[str, tuple[AgentKind, tuple[float, float, float]]]] = {
    "vehicle": ("vehicle", ROAD_USERS["car"].size_m),
    "bus": ("vehicle", ROAD_USERS["truck"].size_m),
    "motorcyclist": (
        "vehicle",
        ROAD_USERS["motorcycle"].size_m,
    ),
    "cyclist": ("cyclist", ROAD_USERS["bicycle"].size_m),
    "pedestrian": ("pedestrian", ROAD_USERS["pedestrian"].size_m),
    "riderless_bicycle": ("other", (1.8, 0.6, 1.1)),
    "static": ("other", ROAD_USERS["other"].size_m),
    "construction": ("other", ROAD_USERS["other"].size_m),
    "background": ("other", ROAD_USERS["other"].size_m),
    "unknown": ("other", ROAD_USERS["other"].size_m),
}
"""Kind, and length, width and height, by ``object_type``. Motorcycles are vehicles, as in WOMD."""
MARKS: Final[dict[str, int]] = {
    "DASHED_WHITE": 1,
    "DOUBLE_DASH_WHITE": 1,
    "SOLID_WHITE": 2,
    "DOUBLE_SOLID_WHITE": 3,
    "DASH_SOLID_WHITE": 3,
    "SOLID_DASH_WHITE": 3,
    "DASHED_YELLOW": 4,
    "DOUBLE_DASH_YELLOW": 5,
    "SOLID_YELLOW": 6,
    "DOUBLE_SOLID_YELLOW": 7,
    "DASH_SOLID_YELLOW": 8,
    "SOLID_DASH_YELLOW": 8,
}
"""WOMD's RoadLine.type by the type of a lane's mark; the nearest one where WOMD has none."""
UNMARKED: Final = "NONE"
BOUNDARY: Final = 1
"""WOMD's RoadEdge.type of the outline of the drivable area."""
SPACING_M: Final = 1.0
"""At most, between the points of centre lines that the map does not have."""
SCORED: Final = 2
FOCAL: Final = 3
"""``object_category`` of the tracks that are to be predicted."""

_COLUMNS: Final = (
    *("track_id", "object_type", "object_category", "timestep", "position_x", "position_y"),
    *("heading", "velocity_x", "velocity_y", "start_timestamp", "end_timestamp", "num_timestamps"),
)
_NAME = "argoverse2"
_TABLE = "scenario_"
_MAP = "log_map_archive_"
Segment = Mapping[str, Any]
Table = dict[str, np.ndarray]


def roots(folder: Path) -> list[Path] | None:
    """The folder itself, if it has a scenario."""
    if not _tables(folder):
        return None
    _parquet()  # loaded here once: each scene is read in a process of its own
    return [folder]


def recordings(root: Path) -> Iterator[RecordRef]:
    """The scenarios of a folder, or the one whose table the root is."""
    is_table = _is_table(root) and head(root, 4) == b"PAR1"
    found = _tables(root) if root.is_dir() else [root] if is_table else []
    for number, table in enumerate(found):
        yield RecordRef(file=root, name=_id(table), record=number)


def load(ref: RecordRef) -> RawScene:
    """The scenario. Raises ReaderError with the file and the reason."""
    listed = _tables(ref.file) if ref.file.is_dir() else [ref.file]
    if ref.record >= len(listed):
        raise ReaderError(f"{ref.file} has no scenario {ref.record} any more; list it again.")
    table = listed[ref.record]
    map_file = table.with_name(f"{_MAP}{_id(table)}.json")
    rows, digest = _parsed(table, _table)
    described, map_digest = _parsed(map_file, json.loads)
    both = hashlib.sha256(f"{digest} {map_digest}".encode()).hexdigest()
    source = Source(dataset=_NAME, file=str(ref.file), record=ref.record, sha256=both)
    repairs: list[str] = []
    road = _part(map_file, lambda: _road(described, repairs))
    return _part(table, lambda: _raw(_id(table), source, rows, road, repairs))


def _tables(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob(f"{_TABLE}*.parquet") if path.is_file())


def _is_table(path: Path) -> bool:
    return path.name.startswith(_TABLE) and path.suffix == ".parquet"


def _id(table: Path) -> str:
    return table.stem.removeprefix(_TABLE)


def _parquet() -> Any:
    """The module that reads tables. Raises UsageError where it is not installed."""
    try:
        from pyarrow import parquet
    except ImportError:
        raise UsageError(
            "Scenarios of Argoverse 2 need pyarrow, which is not installed:"
            ' `pip install "deepmf-sumo[argoverse]"`.'
        ) from None
    return parquet


def _parsed(path: Path, parse: Callable[[bytes], Any]) -> tuple[Any, str]:
    """A file's content, and its digest."""
    try:
        content = files.content(path, LARGEST_FILE)
    except OSError as error:
        raise ReaderError(f"{path} cannot be read ({files.reason(error)}).") from None
    return _part(path, lambda: parse(content)), hashlib.sha256(content).hexdigest()


def _part(path: Path, work: Callable[[], Any]) -> Any:
    """What some work on a file's content gives. Raises ReaderError with the file."""
    try:
        return work()
    except KeyError as error:
        raise ReaderError(f"{path} is incomplete: it lacks {error}.") from None
    except MALFORMED as error:
        raise ReaderError(f"{path} is no part of a valid scenario: {error}.") from None


def _table(content: bytes) -> Table:
    """The columns of a table. One thread: the process that reads a scene has no room for more."""
    parquet = _parquet()
    try:
        file = parquet.ParquetFile(BytesIO(content), pre_buffer=False)
        there = file.schema_arrow.names
        table = file.read(columns=list(_COLUMNS), use_threads=False)
    except Exception as error:  # noqa: BLE001 - a damaged table can raise anything
        raise ValueError(f"the table cannot be read: {error}") from None
    missing = next((name for name in _COLUMNS if name not in there), None)
    if missing:
        raise KeyError(missing)
    if not table.num_rows:
        raise ValueError("it has no rows")
    return {name: table.column(name).to_numpy() for name in _COLUMNS}


# Motion


def _raw(name: str, source: Source, rows: Table, road: RoadMap, repairs: list[str]) -> RawScene:
    count = int(rows["num_timestamps"][0])
    first = max(count - STEPS, 0)
    if first:
        repairs.append(f"The first {first} of {count} steps were left out; a scene has {STEPS}.")
    if count < STEPS:
        repairs.append(f"It has {count} steps; nothing is known of the {STEPS - count} after them.")
    ids = [str(one) for one in dict.fromkeys(rows["track_id"])]
    begin_ns, end_ns = (float(rows[key][0]) for key in ("start_timestamp", "end_timestamp"))
    step_s = (end_ns - begin_ns) / 1e9 / (count - 1) if count > 1 else DT_S
    return RawScene(
        name=name,
        source=source,
        now=HISTORY_STEPS - 1,
        timestamps_s=step_s * np.arange(count - first, dtype=float),
        tracks=_tracks(rows, ids, first, count, road, repairs),
        road=road,
        signals=SignalsBuilder([], 0).built(),
        av_id=AV_ID,
        to_predict=_wanted(rows),
        repairs=repairs,
    )


def _wanted(rows: Table) -> tuple[str, ...]:
    """The tracks that are to be predicted: the focal one, then the scored ones."""
    categories = dict(zip(rows["track_id"], rows["object_category"], strict=True))
    return tuple(
        str(agent)
        for category in (FOCAL, SCORED)
        for agent, its in categories.items()
        if its == category
    )


def _tracks(
    rows: Table, ids: list[str], first: int, count: int, road: RoadMap, repairs: list[str]
) -> RawTracks:
    row_of = {agent: row for row, agent in enumerate(ids)}
    agent = np.array([row_of[str(one)] for one in rows["track_id"]])
    step = rows["timestep"].astype("int64") - first
    if (step >= count - first).any() or (step < -first).any():
        raise ValueError(f"'timestep' is not below 'num_timestamps', which is {count}")
    used = step >= 0
    at = agent[used], step[used]
    shape = (len(ids), count - first)
    position, velocity = np.zeros((*shape, 3)), np.zeros((*shape, 2))
    heading, valid = np.zeros(shape), np.zeros(shape, bool)
    for axis, name in enumerate("xy"):
        position[(*at, axis)] = rows[f"position_{name}"][used]
        velocity[(*at, axis)] = rows[f"velocity_{name}"][used]
    heading[at], valid[at] = rows["heading"][used], True
    kinds, size = _classes(rows, ids, repairs)
    ground = ground_m(road, position[..., :2], heading, valid)
    position[..., 2] = np.where(valid, ground + size[:, 2:] / 2, 0.0)
    return RawTracks(
        ids=ids,
        kinds=kinds,
        size_m=np.repeat(size[:, None], shape[1], axis=1),
        position_m=position,
        heading_rad=heading,
        velocity_mps=velocity,
        valid=valid,
    )


def _classes(rows: Table, ids: list[str], repairs: list[str]) -> tuple[list[AgentKind], Floats]:
    """Kinds (A) and sizes (A, 3)."""
    types = dict(zip(map(str, rows["track_id"]), map(str, rows["object_type"]), strict=True))
    strange = sorted(set(types.values()) - CLASSES.keys())
    if strange:
        repairs.append(f"Road users of unknown types were read as 'other': {', '.join(strange)}.")
    found = [CLASSES.get(types[agent], CLASSES["unknown"]) for agent in ids]
    size = np.array([size for _, size in found])
    size[[agent == AV_ID for agent in ids]] = AV_SIZE_M
    repairs.append("The sizes of road users are unknown; those typical of their types were used.")
    return [kind for kind, _ in found], size


# Road


def _road(described: Segment, repairs: list[str]) -> RoadMap:
    segments = {identifier(one["id"]): one for one in described["lane_segments"].values()}
    road = RoadBuilder()
    lines = _Lines(road)
    for name, segment in segments.items():
        _add_lane(road, lines, name, segment)
    road.lanes = _with_neighbours(road.lanes, segments, repairs)
    for crossing in described.get("pedestrian_crossings", {}).values():
        edges = [_points(crossing["edge1"]), _points(crossing["edge2"])[::-1]]
        road.polygon(identifier(crossing["id"]), "crosswalk", np.concatenate(edges))
    for area in described.get("drivable_areas", {}).values():
        outline = _points(area["area_boundary"])
        road.edge(identifier(area["id"]), BOUNDARY, np.concatenate([outline, outline[:1]]))
    return road.built()


def _points(written: Sequence[Segment]) -> Floats:
    """(P, 3)."""
    flat = np.fromiter((one[axis] for one in written for axis in "xyz"), float)
    return flat.reshape(-1, 3)


class _Lines:
    """Painted lines; one between two lanes is written twice, and kept once.

    Both times it has the same ends, but not the same points between them.
    """

    def __init__(self, road: RoadBuilder) -> None:
        self._road = road
        self._names: dict[frozenset[tuple[float, ...]], str] = {}

    def beside(self, lane: str, segment: Segment, side: str, points: int) -> tuple[Boundary, ...]:
        """The boundary of a lane of so many points, if it is painted."""
        mark = str(segment[f"{side}_lane_mark_type"])
        if mark == UNMARKED:
            return ()
        kind = MARKS.get(mark, 0)
        line = _points(segment[f"{side}_lane_boundary"])
        key = frozenset(tuple(line[at].round(2)) for at in (0, -1))
        if key not in self._names:
            self._names[key] = f"{lane} {side}"
            self._road.line(self._names[key], kind, line)
        return (Boundary(start=0, end=points - 1, feature_id=self._names[key], kind=kind),)


def _add_lane(road: RoadBuilder, lines: _Lines, name: str, segment: Segment) -> None:
    left, right = (_points(segment[f"{side}_lane_boundary"]) for side in ("left", "right"))
    if min(len(left), len(right)) < 2:
        raise ValueError(f"lane {name} has a boundary of less than two points")
    centre = _points(segment["centerline"]) if segment.get("centerline") else None
    count = _count(left, right) if centre is None else len(centre)
    left, right = _evenly(left, count), _evenly(right, count)
    middle = (left + right) / 2
    if centre is not None:  # it has no heights
        middle[:, :2] = centre[:, :2]
    width = float(np.median(np.hypot(*(left - right)[:, :2].T)))
    road.lane(
        name,
        "bike" if segment["lane_type"] == "BIKE" else "street",
        middle,
        interpolating=bool(segment["is_intersection"]),
        width_m=round(width, 2) or None,
        next=tuple(map(identifier, segment["successors"])),
        previous=tuple(map(identifier, segment["predecessors"])),
        left_boundaries=lines.beside(name, segment, "left", count),
        right_boundaries=lines.beside(name, segment, "right", count),
    )


def _count(left: Floats, right: Floats) -> int:
    """Points for the middle of two lines."""
    length = max(float(_along(line)[-1]) for line in (left, right))
    if length > FARTHEST_M:
        raise ValueError(f"a lane is {length:.3g} m long")
    return max(int(np.ceil(length / SPACING_M)) + 1, 2)


def _along(line: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])


def _evenly(line: Floats, count: int) -> Floats:
    """(count, 3) points at equal distances along a line."""
    along = _along(line)
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, axis) for axis in line.T])


def _with_neighbours(
    lanes: Mapping[str, Lane], segments: Mapping[str, Segment], repairs: list[str]
) -> dict[str, Lane]:
    """The lanes with their neighbours of the same direction and kind, over their whole lengths.

    Segments side by side begin and end beside each other.
    """
    opposite = 0

    def beside(lane: Lane, side: str) -> tuple[Neighbour, ...]:
        nonlocal opposite
        written = segments[lane.id][f"{side}_neighbor_id"]
        other = lanes.get(identifier(written)) if written is not None else None
        if other is None or other.kind != lane.kind:
            return ()
        if not _is_along(lane, other):
            opposite += 1
            return ()
        last, others_last = len(lane.centre_m) - 1, len(other.centre_m) - 1
        return (
            Neighbour(
                lane_id=other.id,
                self_start=0,
                self_end=last,
                other_start=0,
                other_end=others_last,
            ),
        )

    linked = {
        name: replace(lane, left=beside(lane, "left"), right=beside(lane, "right"))
        for name, lane in lanes.items()
    }
    if opposite:
        repairs.append(f"{opposite} neighbours that lead the other way were left out.")
    return linked


def _is_along(lane: Lane, other: Lane) -> bool:
    """Whether two lanes lead the same way."""
    ahead, beside = (one.centre_m[-1] - one.centre_m[0] for one in (lane, other))
    return float(ahead @ beside) > 0
