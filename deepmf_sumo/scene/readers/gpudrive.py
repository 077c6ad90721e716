"""GPUDrive and Nocturne: one scene in one JSON file, in all four forms that exist.

Links between lanes, boundaries and speed limits are not in these files; the links are inferred.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    HISTORY_STEPS,
    AgentKind,
    Bools,
    Floats,
    Lane,
    RoadMap,
    Signals,
    SignalState,
    Source,
)
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks, lane_links
from deepmf_sumo.scene.readers.raw.one_file import OneFile, head
from deepmf_sumo.scene.readers.raw.repair import with_heights
from deepmf_sumo.scene.readers.raw.road import (
    TWO_STATES,
    RoadBuilder,
    SignalsBuilder,
    agent_at,
    identifier,
    lane_kind,
    quoted,
)

LARGEST_FILE: Final = 2**26
"""Bytes. The largest known scene has 10 MB."""
HEAD: Final = 2**16
"""Bytes at the start of a file that must contain one of its keys."""
KINDS: Final[dict[str, AgentKind]] = {
    "vehicle": "vehicle",
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
}
STATES: Final = {state.name.lower(): state.value for state in SignalState}
AV_SIZE_M: Final = (5.286, 2.332)
"""Length and width of the recording vehicle; no other object of the data set has this size."""
SIZE_TOLERANCE_M: Final = 0.002
MISSING: Final = -10000.0
"""Written for positions and velocities of steps without a state."""
MOVING_MPS: Final = 1.0
"""The motion of slower objects does not show their heading."""
SURE: Final = 0.01
"""Least difference of the mean cosines that decides the unit: if all vehicles head east, both are
about equal."""
FIRST_LINE: Final = 5
"""``map_element_id`` of road line type 0; up to 13."""
FIRST_EDGE: Final = 14
"""``map_element_id`` of road edge type 0; up to 16."""
STOP_GAP_M: Final = 0.5
"""A lane's signal is at its first point: coordinates differ by rounding alone."""

Described = Mapping[str, Any]

_KEYS = (b'"objects"', b'"roads"', b'"tl_states"')


def recordings(root: Path) -> Iterator[RecordRef]:
    """The file's one scene, if it is a JSON object with a key of these scenes near its start.

    So is a short file that is named as JSON but is none: what is left of one that was cut off.
    """
    return _FORMAT.recordings(root) if _is_scene(root) else iter(())


def load(ref: RecordRef) -> RawScene:
    """The file's scene."""
    return _FORMAT.load(ref)


def _is_scene(path: Path) -> bool:
    start = head(path, HEAD)
    if start is None:
        return False
    if start.lstrip()[:1] == b"{" and any(key in start for key in _KEYS):
        return True
    return path.suffix == ".json" and len(start) < HEAD and not _is_json(start)


def _is_json(content: bytes) -> bool:
    try:
        json.loads(content)
    except (ValueError, RecursionError):
        return False
    return True


def _parsed(content: bytes) -> Any:
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ReaderError(f"is not valid JSON ({error}); copy it again") from None


def _name(described: Described, path: Path) -> str:
    return identifier(described.get("scenario_id") or path.stem)


def _described(described: Described, name: str, source: Source) -> RawScene:
    if "ego_idx" in described:
        raise ValueError("its map was re-sampled (key 'ego_idx'); take the file it was made from")
    repairs: list[str] = []
    tracks = _tracks(described["objects"], repairs)
    metadata = described.get("metadata") or {}
    road = _road(described["roads"], repairs)
    steps = tracks.valid.shape[1]
    return RawScene(
        name=name,
        source=source,
        now=HISTORY_STEPS - 1,
        timestamps_s=np.zeros(0),
        tracks=tracks,
        road=road,
        signals=_signals(described.get("tl_states") or {}, road.lanes, steps, repairs),
        av_id=_av_id(metadata, tracks),
        interest=tuple(map(identifier, metadata.get("objects_of_interest", ()))),
        to_predict=tuple(
            agent_at(tracks.ids, wanted["track_index"], "tracks_to_predict")
            for wanted in metadata.get("tracks_to_predict", ())
        ),
        repairs=repairs,
    )


def _av_id(metadata: Described, tracks: RawTracks) -> str | None:
    """The id in the metadata, else that of the last vehicle of the recording vehicle's size."""
    index = metadata.get("sdc_track_index")
    if index is not None:
        return agent_at(tracks.ids, index, "sdc_track_index")
    alike = (np.abs(tracks.size_m[:, 0, :2] - AV_SIZE_M) <= SIZE_TOLERANCE_M).all(-1)
    rows = [row for row in np.flatnonzero(alike) if tracks.kinds[row] == "vehicle"]
    return tracks.ids[rows[-1]] if rows else None


# Motion


def _tracks(objects: Sequence[Described], repairs: list[str]) -> RawTracks:
    """Motion of all objects; ids are those of the file, else the positions in its list."""
    if not objects:
        raise ValueError("it has no objects; maps without a recording cannot be used")
    position = np.array([_points(one["position"]) for one in objects])
    velocity = np.array([_points(one["velocity"]) for one in objects])[..., :2]
    written = np.array([one["heading"] for one in objects], float)
    valid = np.array([one["valid"] for one in objects], float) > 0
    # The early forms have no height: 0 is unknown.
    size = np.array(
        [
            [float(one["length"]), float(one["width"]), float(one.get("height", 0.0))]
            for one in objects
        ]
    )
    marked = valid & (position[..., :2] == MISSING).any(-1)
    if marked.any():
        repairs.append(
            f"{int(marked.sum())} valid states contain the marker of missing values "
            f"({MISSING:.0f}); they were dropped."
        )
    valid &= ~marked
    return RawTracks(
        ids=[identifier(one.get("id", index)) for index, one in enumerate(objects)],
        kinds=[KINDS.get(str(one["type"]), "other") for one in objects],
        size_m=np.repeat(size[:, None], valid.shape[1], axis=1),
        position_m=position,
        heading_rad=_radians(written, velocity, valid, "id" in objects[0], repairs),
        velocity_mps=velocity,
        valid=valid,
    )


def _radians(
    written: Floats, velocity: Floats, valid: Bools, has_ids: bool, repairs: list[str]
) -> Floats:
    """Headings in radians. The files do not state the unit: it is inferred from the motion.

    Moving objects head in the direction of their velocity, so the unit is the one with the larger
    mean cosine between heading and velocity. If both are alike, numbers beyond a full turn are
    degrees; without such numbers, files with object ids have radians, and all others degrees.
    """
    valid = valid & np.isfinite(written)
    moving = valid & (np.hypot(velocity[..., 0], velocity[..., 1]) > MOVING_MPS)
    direction = np.arctan2(velocity[..., 1], velocity[..., 0])
    gain = np.cos(np.radians(written) - direction) - np.cos(written - direction)
    degrees_fit = float(gain[moving].mean()) if moving.any() else 0.0
    if abs(degrees_fit) > SURE:
        in_degrees = degrees_fit > 0
    elif (np.abs(written[valid]) > 2 * np.pi).any():
        in_degrees = True
    else:
        in_degrees = not has_ids
        unit = "degrees" if in_degrees else "radians"
        repairs.append(
            f"The motion does not show the unit of the headings; that of the form was used: {unit}."
        )
    return np.radians(written) if in_degrees else written


# Road and signals


def _road(features: Sequence[Described], repairs: list[str]) -> RoadMap:
    """The road. Ids are those of the file, else the positions in its list.

    The file does not state which lanes follow each other or are neighbours: that is inferred from
    the geometry. Speed limits, boundaries and the lanes of stop signs are unknown.
    """
    road = RoadBuilder()
    strange: set[str] = set()
    for index, feature in enumerate(features):
        name = identifier(feature.get("id", index))
        xyz = _points(feature["geometry"])
        element = int(feature.get("map_element_id", -1))
        match feature["type"]:
            case "lane":
                road.lane(name, lane_kind(element), xyz)
            case "road_line":
                road.line(name, _kind(element, FIRST_LINE, 8), xyz)
            case "road_edge":
                road.edge(name, _kind(element, FIRST_EDGE, 2), xyz)
            case "crosswalk" | "speed_bump" | "driveway" as area:
                road.polygon(name, area, xyz)
            case "stop_sign" if len(xyz):
                road.stop_sign(name, xyz[0])
            case other:
                strange.add(str(other))
    if strange:
        repairs.append(f"Roads of unknown types were dropped: {', '.join(sorted(strange))}.")
    road.lanes = with_heights(road.built(), repairs).lanes
    road.lanes = lane_links.linked(list(road.lanes.values()))
    return road.built()


def _kind(element: int, first: int, last_kind: int) -> int:
    """The kind's number; 0, which is unknown, if the file does not state it."""
    kind = element - first
    return kind if 0 <= kind <= last_kind else 0


def _points(written: Any) -> Floats:
    """(P, 3) from ``{"x": [..], "y": [..]}`` or ``[{"x": .., "y": ..}, ..]``; a missing z is 0.

    Raises KeyError, TypeError or ValueError if it is neither.
    """
    if isinstance(written, Mapping):
        columns = [np.asarray(written[axis], float) for axis in ("x", "y")]
        columns.append(np.asarray(written.get("z", np.zeros(len(columns[0]))), float))
        return np.column_stack(columns)
    if not isinstance(written, Sequence):
        raise TypeError(f"points are written as {type(written).__name__}")
    flat = np.fromiter(
        (value for one in written for value in (one["x"], one["y"], one.get("z", 0.0))), float
    )
    return flat.reshape(-1, 3)


def _signals(
    described: Mapping[str, Described], lanes: Mapping[str, Lane], steps: int, repairs: list[str]
) -> Signals:
    """Signals over all steps.

    Early files do not name their lanes: a signal is assigned to a lane that starts at its stop
    point. Several signals at one point are assigned to several lanes in the order of the file.
    """
    taken = {str(key) for key in described if str(key) in lanes}
    rows: dict[str, Described] = {}
    lost: list[str] = []
    moved = 0
    for key, light in described.items():
        name = str(key)
        if name not in lanes:
            match = _lane_at(light, lanes, taken)
            if match is None:
                lost.append(name)
                continue
            name, moved = match, moved + 1
            taken.add(name)
        rows[name] = light
    if moved:
        repairs.append(
            f"{moved} signals were assigned to the lanes that start at their stop point."
        )
    if lost:
        repairs.append(f"Signals of lanes that are not in the file were dropped: {quoted(lost)}.")
    return _over_time(rows, steps, repairs)


def _lane_at(light: Described, lanes: Mapping[str, Lane], taken: set[str]) -> str | None:
    if not light["x"]:
        return None
    stop = np.array([light["x"][-1], light["y"][-1]], float)
    for name, lane in lanes.items():
        if name in taken or not len(lane.centre_m):
            continue
        if np.hypot(*(lane.centre_m[0] - stop)) <= STOP_GAP_M:
            return name
    return None


def _over_time(rows: Mapping[str, Described], steps: int, repairs: list[str]) -> Signals:
    signals = SignalsBuilder(list(rows), steps)
    strange: set[str] = set()
    outside = changed = 0
    for row, light in enumerate(rows.values()):
        for step, name in zip(light["time_index"], light["state"], strict=True):
            if not 0 <= int(step) < steps:
                outside += 1
                continue
            if name not in STATES:
                strange.add(str(name))
            changed += signals.see(row, int(step), STATES.get(name, 0))
        for axis, key in enumerate(("x", "y", "z")):
            signals.stop_m[row, axis] = light[key][-1] if light.get(key) else 0.0
    if strange:
        repairs.append(f"Unknown signal states were read as unknown: {', '.join(sorted(strange))}.")
    if changed:
        repairs.append(TWO_STATES.format(changed))
    if outside:
        repairs.append(f"{outside} signal states of steps that are not recorded were dropped.")
    return signals.built()


_FORMAT: Final = OneFile(
    dataset="gpudrive", largest=LARGEST_FILE, parse=_parsed, name=_name, describe=_described
)
