"""Waymo Open Motion Dataset: TFRecords of ``Scenario`` messages, plain or gzip."""

import hashlib
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError

from deepmf_sumo.datatypes import (
    HISTORY_STEPS,
    AgentKind,
    Floats,
    RoadMap,
    Scene,
    Signals,
    Source,
)
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import _bounded, _checks, _tfrecord
from deepmf_sumo.readers._recording import (
    MPS_PER_MPH,
    TWO_STATES,
    Recording,
    RecordingTracks,
    RoadBuilder,
    SignalsBuilder,
    agent_at,
    boundary,
    lane_kind,
    neighbour,
)
from deepmf_sumo.readers.base import RecordRef, Refusal
from deepmf_sumo.readers.protos import scenario_pb2 as pb

KINDS: Final[tuple[AgentKind, ...]] = ("other", "vehicle", "pedestrian", "cyclist", "other")
"""By Track.ObjectType; unset is ``other``."""
_SHARD = re.compile(r"\.tfrecords?(-\d+-of-\d+)?(\.gz)?$")
_NAME = "womd"
_UNDECODABLE = (DecodeError, UnicodeDecodeError)
# A file of some kilobytes can unpack to millions of records that cannot be used.
_MOST_LOST = 1000
_ENOUGH = f"the rest of it was not read, since {_MOST_LOST} records could not be used"


def accepts(path: Path) -> bool:
    """Whether the file starts as a TFRecord does, or is named like one (a damaged one, then)."""
    return _tfrecord.looks_framed(path) or _SHARD.search(path.name) is not None


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The scenes of a TFRecord file in order."""
    lost = 0
    for found in _tfrecord.records(path):
        if isinstance(found, _tfrecord.Broken):
            reason = f"{path} record {found.index}: {found.reason}."
            scene: Scene | Refusal = _refusal(path, found.index, "", reason)
        else:
            scene = _scene(path, found)
        yield scene
        lost += isinstance(scene, Refusal)
        if lost == _MOST_LOST:
            raise _bounded.EndedError(_ENOUGH)


def records(path: Path) -> Iterator[RecordRef]:
    """The locations of a TFRecord file's records; one without an id is named by its number."""
    lost = 0
    for found in _tfrecord.records(path):
        name = ""
        if isinstance(found, _tfrecord.Record):
            with suppress(*_UNDECODABLE):
                name = pb.Scenario.FromString(found.payload).scenario_id
        lost += not name
        name = name or f"{path.name} record {found.index}"
        yield RecordRef(file=path, name=name, record=found.index, offset=found.offset)
        if lost == _MOST_LOST:
            raise _bounded.EndedError(_ENOUGH)


def scene_at(ref: RecordRef) -> Scene | Refusal:
    """The scene at a location from `records`. Raises ReaderError if there is no record."""
    return _scene(ref.file, _tfrecord.record_at(ref.file, ref.offset or 0, ref.record))


def packed(message: pb.Scenario) -> bytes:
    """A TFRecord file of one scene; the same message gives the same bytes."""
    return _tfrecord.framed(message.SerializeToString(deterministic=True))


def _scene(path: Path, record: _tfrecord.Record) -> Scene | Refusal:
    name = ""
    try:
        message = pb.Scenario.FromString(record.payload)
        name = message.scenario_id
        source = Source(
            dataset=_NAME,
            file=str(path),
            record=record.index,
            sha256=hashlib.sha256(record.payload).hexdigest(),
        )
        return _checks.checked(_recording(message, source))
    except _UNDECODABLE as error:
        reason = "is not a Scenario message. Is it a 'scenario' file, not a 'tf_example' one?"
        if "alloc failed" in str(error):  # a MemoryError by another name
            reason = f"{_bounded.TOO_LARGE}."
        return _refusal(path, record.index, name, f"{path} record {record.index}: {reason}")
    except ReaderError as error:
        return _refusal(path, record.index, name, str(error))


def _refusal(path: Path, record: int, name: str, reason: str) -> Refusal:
    return Refusal(file=str(path), record=record, name=name, reason=reason, dataset=_NAME)


def _recording(message: pb.Scenario, source: Source) -> Recording:
    where = f"{source.file} record {source.record}"
    _refuse(message, where)
    ids = [str(track.id) for track in message.tracks]
    repairs: list[str] = []
    try:
        road = _road(message.map_features)
        av_id = agent_at(ids, message.sdc_track_index, "sdc_track_index")
        to_predict = tuple(
            agent_at(ids, wanted.track_index, "tracks_to_predict")
            for wanted in message.tracks_to_predict
        )
    except ValueError as error:
        raise ReaderError(f"{where}: {error}.") from None
    return Recording(
        name=message.scenario_id,
        source=source,
        # Files of 20 s have their current step at 0, which leaves no history to predict from.
        now=max(message.current_time_index, HISTORY_STEPS - 1),
        timestamps_s=np.fromiter(message.timestamps_seconds, float),
        tracks=_tracks(message, ids),
        road=road,
        signals=_signals(message.dynamic_map_states, repairs),
        av_id=av_id,
        interest=tuple(str(agent) for agent in message.objects_of_interest),
        to_predict=to_predict,
        repairs=repairs,
    )


def _refuse(message: pb.Scenario, where: str) -> None:
    """Raises ReaderError for what is missing or too large, before arrays are made of it."""
    if not message.tracks or not message.scenario_id:
        missing = "tracks" if not message.tracks else "scenario_id"
        raise ReaderError(
            f"{where}: no {missing}. Is it a 'scenario' file, not a 'tf_example' one?"
        )
    if len(message.map_features) > _checks.MOST_FEATURES:
        raise ReaderError(f"{where}: the map has more than {_checks.MOST_FEATURES} features.")
    steps = len(message.timestamps_seconds)
    for track in message.tracks:
        if len(track.states) != steps:
            raise ReaderError(
                f"{where}: track {track.id} has {len(track.states)} states, "
                f"but there are {steps} timestamps."
            )
    if steps * len(message.tracks) > _checks.MOST_STATES:
        raise ReaderError(f"{where}: has more than {_checks.MOST_STATES} states.")


def _tracks(message: pb.Scenario, ids: list[str]) -> RecordingTracks:
    values = np.array([_states(track) for track in message.tracks])
    return RecordingTracks(
        ids=ids,
        kinds=[KINDS[track.object_type] for track in message.tracks],
        position_m=values[..., :3],
        size_m=values[..., 3:6],
        heading_rad=values[..., 6],
        velocity_mps=values[..., 7:9],
        valid=values[..., 9] > 0,
    )


def _states(track: pb.Track) -> Floats:
    """(T, 10); agent by agent, since the numbers take much more memory than the array."""
    values = [
        (
            *(state.center_x, state.center_y, state.center_z),
            *(state.length, state.width, state.height),
            *(state.heading, state.velocity_x, state.velocity_y, state.valid),
        )
        for state in track.states
    ]
    return np.array(values, float).reshape(-1, 10)


def _signals(states: Iterable[pb.DynamicMapState], repairs: list[str]) -> Signals:
    per_step = [list(step.lane_states) for step in states]
    rows: dict[int, int] = {}
    for light in (light for step in per_step for light in step):
        rows.setdefault(light.lane, len(rows))
    signals = SignalsBuilder([str(lane) for lane in rows], len(per_step))
    changed = 0
    for step, lights in enumerate(per_step):
        for light in lights:
            row, point = rows[light.lane], light.stop_point
            changed += signals.see(row, step, light.state)
            signals.stop_m[row] = point.x, point.y, point.z
    if changed:
        repairs.append(TWO_STATES.format(changed))
    return signals.built()


def _road(features: Iterable[pb.MapFeature]) -> RoadMap:
    road = RoadBuilder()
    for feature in features:
        name = str(feature.id)
        match feature.WhichOneof("feature_data"):
            case "lane":
                _add_lane(road, name, feature.lane)
            case "road_line":
                road.line(name, feature.road_line.type, _points(feature.road_line.polyline))
            case "road_edge":
                road.edge(name, feature.road_edge.type, _points(feature.road_edge.polyline))
            case "stop_sign":
                sign = feature.stop_sign
                road.stop_sign(name, _points([sign.position])[0], tuple(map(str, sign.lane)))
            case "crosswalk" | "speed_bump" | "driveway" as kind:
                road.polygon(name, kind, _points(getattr(feature, kind).polygon))
            case _:
                pass  # a kind of feature that is newer than this reader
    return road.built()


def _add_lane(road: RoadBuilder, name: str, lane: pb.LaneCenter) -> None:
    left, right = (
        tuple(neighbour(partial(getattr, one)) for one in side)
        for side in (lane.left_neighbors, lane.right_neighbors)
    )
    left_boundaries, right_boundaries = (
        tuple(boundary(partial(getattr, one), one.boundary_type) for one in side)
        for side in (lane.left_boundaries, lane.right_boundaries)
    )
    road.lane(
        name,
        lane_kind(lane.type),
        _points(lane.polyline),
        interpolating=lane.interpolating,
        speed_limit_mps=lane.speed_limit_mph * MPS_PER_MPH if lane.speed_limit_mph > 0 else None,
        next=tuple(str(other) for other in lane.exit_lanes),
        previous=tuple(str(other) for other in lane.entry_lanes),
        left=left,
        right=right,
        left_boundaries=left_boundaries,
        right_boundaries=right_boundaries,
    )


def _points(points: Iterable[pb.MapPoint]) -> Floats:
    flat = np.fromiter((value for p in points for value in (p.x, p.y, p.z)), float)
    return flat.reshape(-1, 3)
