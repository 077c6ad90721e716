"""Waymo Open Motion Dataset: TFRecords of ``Scenario`` messages, plain or gzip."""

import hashlib
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError

from deepmf_sumo.datatypes import (
    HISTORY_STEPS,
    AgentKind,
    Boundary,
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    Source,
    StopSign,
)
from deepmf_sumo.datatypes.road import LaneKind
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import bounded, checks, framing
from deepmf_sumo.readers.base import Place, Refusal
from deepmf_sumo.readers.protos import scenario_pb2 as pb

KINDS: Final[tuple[AgentKind, ...]] = ("other", "vehicle", "pedestrian", "cyclist", "other")
"""By Track.ObjectType; unset is ``other``."""
LANE_KINDS: Final[tuple[LaneKind, ...]] = ("unknown", "freeway", "street", "bike")
"""By LaneCenter.type."""
MPS_PER_MPH: Final = 0.44704
_SHARD = re.compile(r"\.tfrecords?(-\d+-of-\d+)?(\.gz)?$")
_NAME = "womd"
_UNDECODABLE = (DecodeError, UnicodeDecodeError)
# A file of some kilobytes can unpack to millions of records that cannot be used.
_MOST_LOST = 1000
_ENOUGH = f"the rest of it was not read, since {_MOST_LOST} records could not be used"


def accepts(path: Path) -> bool:
    """Whether the file begins as a TFRecord does, or is named as one (a damaged one, then)."""
    return framing.looks_framed(path) or _SHARD.search(path.name) is not None


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The scenes of a TFRecord file in order."""
    lost = 0
    for found in framing.records(path):
        if isinstance(found, framing.Broken):
            reason = f"{path} record {found.index}: {found.reason}."
            scene: Scene | Refusal = _refusal(path, found.index, "", reason)
        else:
            scene = _scene(path, found)
        yield scene
        lost += isinstance(scene, Refusal)
        if lost == _MOST_LOST:
            raise bounded.EndedError(_ENOUGH)


def places(path: Path) -> Iterator[Place]:
    """Where the records of a TFRecord file lie; what has no id is called by file and number."""
    lost = 0
    for found in framing.records(path):
        name = ""
        if isinstance(found, framing.Record):
            with suppress(*_UNDECODABLE):
                name = pb.Scenario.FromString(found.payload).scenario_id
        lost += not name
        name = name or f"{path.name} record {found.index}"
        yield Place(name=name, record=found.index, offset=found.offset)
        if lost == _MOST_LOST:
            raise bounded.EndedError(_ENOUGH)


def scene_at(path: Path, place: Place) -> Scene | Refusal:
    """The scene at a place that `places` told. Raises ReaderError where no record is there."""
    return _scene(path, framing.record_at(path, place.offset, place.record))


def _scene(path: Path, record: framing.Record) -> Scene | Refusal:
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
        return checks.checked(_recording(message, source))
    except _UNDECODABLE as error:
        reason = "is no Scenario message. Is it a 'scenario' file, not a 'tf_example' one?"
        if "alloc failed" in str(error):  # a MemoryError by another name
            reason = f"{bounded.TOO_LARGE}."
        return _refusal(path, record.index, name, f"{path} record {record.index}: {reason}")
    except ReaderError as error:
        return _refusal(path, record.index, name, str(error))


def _refusal(path: Path, record: int, name: str, reason: str) -> Refusal:
    return Refusal(file=str(path), record=record, name=name, reason=reason, dataset=_NAME)


def _recording(message: pb.Scenario, source: Source) -> checks.Recording:
    where = f"{source.file} record {source.record}"
    if not message.tracks or not message.scenario_id:
        missing = "tracks" if not message.tracks else "scenario_id"
        raise ReaderError(
            f"{where}: no {missing}. Is it a 'scenario' file, not a 'tf_example' one?"
        )
    if len(message.map_features) > checks.MOST_FEATURES:
        raise ReaderError(f"{where}: the map has more than {checks.MOST_FEATURES} features.")
    ids = [str(track.id) for track in message.tracks]
    return checks.Recording(
        name=message.scenario_id,
        source=source,
        # Files of 20 s have their current step at 0, which leaves no history to predict from.
        now=max(message.current_time_index, HISTORY_STEPS - 1),
        timestamps_s=np.fromiter(message.timestamps_seconds, float),
        tracks=_tracks(message, ids, where),
        road=_road(message.map_features),
        signals=_signals(message.dynamic_map_states),
        av_id=_by_index(ids, message.sdc_track_index, f"{where}: sdc_track_index"),
        interest=tuple(str(agent) for agent in message.objects_of_interest),
        to_predict=tuple(
            _by_index(ids, wanted.track_index, f"{where}: tracks_to_predict")
            for wanted in message.tracks_to_predict
        ),
    )


def _by_index(ids: list[str], index: int, what: str) -> str:
    if not 0 <= index < len(ids):
        raise ReaderError(f"{what} is {index}, but there are {len(ids)} tracks.")
    return ids[index]


def _tracks(message: pb.Scenario, ids: list[str], where: str) -> checks.RecordingTracks:
    steps = len(message.timestamps_seconds)
    for track in message.tracks:
        if len(track.states) != steps:
            raise ReaderError(
                f"{where}: track {track.id} has {len(track.states)} states, "
                f"but there are {steps} timestamps."
            )
    if steps * len(ids) > checks.MOST_STATES:
        raise ReaderError(f"{where}: has more than {checks.MOST_STATES} states.")
    values = np.array([_states(track) for track in message.tracks])
    return checks.RecordingTracks(
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


def _signals(states: Iterable[pb.DynamicMapState]) -> Signals:
    per_step = [list(step.lane_states) for step in states]
    lane_ids = list(dict.fromkeys(light.lane for step in per_step for light in step))
    rows = {lane: row for row, lane in enumerate(lane_ids)}
    shape = (len(lane_ids), len(per_step))
    state, seen = np.zeros(shape, "uint8"), np.zeros(shape, bool)
    stop = np.zeros((len(lane_ids), 3))
    for step, lights in enumerate(per_step):
        for light in lights:
            row = rows[light.lane]
            state[row, step], seen[row, step] = light.state, True
            point = light.stop_point
            stop[row] = point.x, point.y, point.z
    return Signals(
        lane_ids=tuple(str(lane) for lane in lane_ids),
        state=state,
        seen=seen,
        stop_m=stop[:, :2],
        stop_z_m=stop[:, 2],
    )


def _road(features: Iterable[pb.MapFeature]) -> RoadMap:
    lanes: dict[str, Lane] = {}
    lines: list[Polyline] = []
    edges: list[Polyline] = []
    polygons: list[Polygon] = []
    signs: list[StopSign] = []
    for feature in features:
        name = str(feature.id)
        match feature.WhichOneof("feature_data"):
            case "lane":
                lanes[name] = _lane(name, feature.lane)
            case "road_line":
                lines.append(_polyline(name, feature.road_line))
            case "road_edge":
                edges.append(_polyline(name, feature.road_edge))
            case "stop_sign":
                signs.append(_stop_sign(name, feature.stop_sign))
            case "crosswalk" | "speed_bump" | "driveway" as kind:
                points = _points(getattr(feature, kind).polygon)
                polygons.append(
                    Polygon(id=name, kind=kind, points_m=points[:, :2], z_m=points[:, 2])
                )
            case _:
                pass  # a kind of feature that is newer than this reader
    return RoadMap(
        lanes=lanes,
        lines=tuple(lines),
        edges=tuple(edges),
        polygons=tuple(polygons),
        stop_signs=tuple(signs),
    )


def _lane(name: str, lane: pb.LaneCenter) -> Lane:
    points = _points(lane.polyline)
    return Lane(
        id=name,
        kind=LANE_KINDS[lane.type] if 0 <= lane.type < len(LANE_KINDS) else "unknown",
        centre_m=points[:, :2],
        z_m=points[:, 2],
        interpolating=lane.interpolating,
        speed_limit_mps=lane.speed_limit_mph * MPS_PER_MPH if lane.speed_limit_mph > 0 else None,
        next=tuple(str(other) for other in lane.exit_lanes),
        previous=tuple(str(other) for other in lane.entry_lanes),
        left=_neighbours(lane.left_neighbors),
        right=_neighbours(lane.right_neighbors),
        left_boundaries=_boundaries(lane.left_boundaries),
        right_boundaries=_boundaries(lane.right_boundaries),
    )


def _neighbours(neighbours: Iterable[pb.LaneNeighbor]) -> tuple[Neighbour, ...]:
    return tuple(
        Neighbour(
            lane_id=str(neighbour.feature_id),
            self_start=neighbour.self_start_index,
            self_end=neighbour.self_end_index,
            other_start=neighbour.neighbor_start_index,
            other_end=neighbour.neighbor_end_index,
        )
        for neighbour in neighbours
    )


def _boundaries(segments: Iterable[pb.BoundarySegment]) -> tuple[Boundary, ...]:
    return tuple(
        Boundary(
            start=segment.lane_start_index,
            end=segment.lane_end_index,
            feature_id=str(segment.boundary_feature_id),
            kind=segment.boundary_type,
        )
        for segment in segments
    )


def _stop_sign(name: str, sign: pb.StopSign) -> StopSign:
    position = np.array([sign.position.x, sign.position.y])
    lanes = tuple(str(lane) for lane in sign.lane)
    return StopSign(id=name, position_m=position, z_m=sign.position.z, lane_ids=lanes)


def _polyline(name: str, feature: pb.RoadLine | pb.RoadEdge) -> Polyline:
    points = _points(feature.polyline)
    return Polyline(id=name, kind=feature.type, points_m=points[:, :2], z_m=points[:, 2])


def _points(points: Iterable[pb.MapPoint]) -> Floats:
    flat = np.fromiter((value for p in points for value in (p.x, p.y, p.z)), float)
    return flat.reshape(-1, 3)
