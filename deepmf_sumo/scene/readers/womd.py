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

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    HISTORY_STEPS,
    AgentKind,
    Floats,
    RoadMap,
    Signals,
    Source,
)
from deepmf_sumo.scene.readers import _tfrecord
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.protos import scenario_pb2 as pb
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks
from deepmf_sumo.scene.readers.raw.road import (
    MPS_PER_MPH,
    TWO_STATES,
    RoadBuilder,
    SignalsBuilder,
    agent_at,
    boundary,
    lane_kind,
    neighbour,
)

KINDS: Final[tuple[AgentKind, ...]] = ("other", "vehicle", "pedestrian", "cyclist", "other")
"""By Track.ObjectType; unset is ``other``."""
_SHARD = re.compile(r"\.tfrecords?(-\d+-of-\d+)?(\.gz)?$")
_NAME = "womd"


def recordings(root: Path) -> Iterator[RecordRef]:
    """The records of a file that starts as a TFRecord does, or is named like one (a damaged one).

    A record's content is passed on: it is read and, in packed files, unpacked once.
    """
    if not (_tfrecord.looks_framed(root) or _SHARD.search(root.name)):
        return
    empty = True
    for found in _tfrecord.records(root):
        message, empty = None, False
        if isinstance(found, _tfrecord.TfRecord):
            with suppress(MemoryError):  # `load` meets it again
                message = _message(found.payload)
        yield RecordRef(
            file=root,
            name=message.scenario_id if message else "",
            record=found.index,
            offset=found.offset,
            content=(found, message),
        )
    if empty:  # of a record that was to be there, `load` says what is missing
        yield RecordRef(file=root, name="", record=0, offset=0)


def load(ref: RecordRef) -> RawScene:
    """The scene at a location from `recordings`. Raises ReaderError if there is no record."""
    where = f"{ref.file} record {ref.record}"
    found, message = ref.content or (None, None)
    if found is None:
        found = _tfrecord.record_at(ref.file, ref.offset or 0, ref.record)
    if isinstance(found, _tfrecord.Broken):
        raise ReaderError(f"{where}: {found.reason}.")
    if message is None:
        message = _message(found.payload)
    if message is None:
        raise ReaderError(
            f"{where}: is not a Scenario message. Is it a 'scenario' file, not a 'tf_example' one?"
        )
    digest = hashlib.sha256(found.payload).hexdigest()
    source = Source(dataset=_NAME, file=str(ref.file), record=ref.record, sha256=digest)
    return _raw(message, source)


def packed(message: pb.Scenario) -> bytes:
    """A TFRecord file of one scene; the same message gives the same bytes."""
    return _tfrecord.framed(message.SerializeToString(deterministic=True))


def _message(payload: bytes) -> pb.Scenario | None:
    """The message; None if it is none."""
    try:
        return pb.Scenario.FromString(payload)
    except (DecodeError, UnicodeDecodeError) as error:
        if "alloc failed" in str(error):  # a MemoryError by another name
            raise MemoryError from None
        return None


def _raw(message: pb.Scenario, source: Source) -> RawScene:
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
    return RawScene(
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
    """Raises ReaderError for what is missing."""
    if not message.tracks or not message.scenario_id:
        missing = "tracks" if not message.tracks else "scenario_id"
        raise ReaderError(
            f"{where}: no {missing}. Is it a 'scenario' file, not a 'tf_example' one?"
        )
    steps = len(message.timestamps_seconds)
    for track in message.tracks:
        if len(track.states) != steps:
            raise ReaderError(
                f"{where}: track {track.id} has {len(track.states)} states, "
                f"but there are {steps} timestamps."
            )


def _tracks(message: pb.Scenario, ids: list[str]) -> RawTracks:
    values = np.array([_states(track) for track in message.tracks])
    return RawTracks(
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
