"""Waymo Open Motion Dataset: TFRecords of ``Scenario`` messages, plain or gzip.

A TFRecord file has records laid end to end, each with its length and two checksums::

    8 bytes  payload length n, little-endian      4 bytes  masked CRC-32C of the length
    n bytes  payload                              4 bytes  masked CRC-32C of the payload

The file is plain, or gzip around the whole stream, by its first two bytes. Offsets are positions in
the unpacked stream.
"""

import hashlib
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO, Final

import google_crc32c
import numpy as np
from google.protobuf.message import DecodeError

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    HISTORY_STEPS,
    AgentKind,
    Floats,
    RoadMap,
    Signals,
    Source,
)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TfRecord:
    """One whole record, and where it starts."""

    index: int
    offset: int
    payload: bytes

    @property
    def end(self) -> int:
        """Where the next one starts."""
        return self.offset + HEADER + len(self.payload) + FOOTER


@dataclass(frozen=True, slots=True, kw_only=True)
class Broken:
    """A record that cannot be read; ``end`` is None if the rest of the file is lost, too."""

    index: int
    offset: int
    reason: str
    end: int | None = None


def framed(payload: bytes) -> bytes:
    """The payload as one record."""
    length = struct.pack("<Q", len(payload))
    return length + _masked_crc(length) + payload + _masked_crc(payload)


def looks_framed(path: Path) -> bool:
    """Whether the file starts with a length and its checksum."""
    try:
        with _stream(path) as stream:
            header = stream.read(HEADER)
    except OSError:
        return False
    return len(header) == HEADER and _masked_crc(header[:8]) == header[8:]


def records(path: Path) -> Iterator[TfRecord | Broken]:
    """All records in order; damaged ones as `Broken`.

    After a payload with a wrong checksum the next record is read, since its position is known. A
    wrong length, or a file that ends too early, ends the iteration.
    """
    offset, index = 0, 0
    try:
        with _stream(path) as stream:
            while True:
                found = _next(stream, index, offset)
                if found is None:
                    return
                yield found
                if found.end is None:
                    return
                offset, index = found.end, index + 1
    except OSError as error:
        reason = f"cannot be read further ({files.reason(error)}); copy or download the file again"
        yield Broken(index=index, offset=offset, reason=reason)


def record_at(path: Path, offset: int, index: int) -> TfRecord:
    """The record that starts at an offset of the decompressed stream.

    Raises ReaderError if there is no whole record. A gzip file is decompressed up to it.
    """
    try:
        with _stream(path) as stream:
            _skip(stream, offset)
            found = _next(stream, index, offset)
    except OSError as error:
        raise ReaderError(
            f"{path} record {index}: cannot be read ({files.reason(error)})."
        ) from None
    if isinstance(found, TfRecord):
        return found
    reason = found.reason if found else f"{_ENDS if offset else _EMPTY}; copy or download it again"
    raise ReaderError(f"{path} record {index}: {reason}.")


_ENDS: Final = "the file ends before it"
_EMPTY: Final = "the file contains no scene"


def _next(stream: BinaryIO, index: int, offset: int) -> TfRecord | Broken | None:
    """The record at the stream's position; None at the end of the file."""
    header = stream.read(HEADER)
    if not header:
        return None
    if len(header) < HEADER:
        return _truncated(index, offset, len(header), HEADER)
    (length,) = struct.unpack("<Q", header[:8])
    damage = _damage(header, length)
    if damage:
        return Broken(index=index, offset=offset, reason=damage)
    body = stream.read(length + FOOTER)
    if len(body) < length + FOOTER:
        return _truncated(index, offset, HEADER + len(body), HEADER + length + FOOTER)
    payload = body[:length]
    if _masked_crc(payload) != body[length:]:
        reason = "the checksum of its content is wrong; copy or download the file again"
        end = offset + HEADER + len(body)
        return Broken(index=index, offset=offset, reason=reason, end=end)
    return TfRecord(index=index, offset=offset, payload=payload)


def _damage(header: bytes, length: int) -> str:
    """What is wrong with a record's header; empty if nothing is."""
    if _masked_crc(header[:8]) != header[8:]:
        return (
            "the checksum of its length is wrong, so that neither it nor what follows can be "
            "found; copy or download the file again"
        )
    if length > LARGEST_RECORD:
        return f"claims {length} bytes, more than the {LARGEST_RECORD} that a scene may have"
    return ""


def _truncated(index: int, offset: int, there: int, needed: int) -> Broken:
    reason = f"is cut off: {there} of its {needed} bytes are there; copy or download the file again"
    return Broken(index=index, offset=offset, reason=reason)


def _masked_crc(content: bytes) -> bytes:
    """CRC-32C rotated by 15 bits plus a constant, so that a record can contain checksums itself."""
    crc = google_crc32c.value(content)
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)


def _stream(path: Path) -> BinaryIO:
    with files.opened(path) as file:
        packed = file.read(len(files.GZIP)) == files.GZIP
    return files.unpacked(path, LARGEST_FILE) if packed else files.opened(path)


def _skip(stream: BinaryIO, count: int) -> None:
    """Skip a number of bytes, or to the end; a packed stream is unpacked for that."""
    if stream.seekable():
        stream.seek(count)
        return
    while count and (piece := stream.read(min(count, _PIECE))):
        count -= len(piece)


KINDS: Final[tuple[AgentKind, ...]] = ("other", "vehicle", "pedestrian", "cyclist", "other")
"""By Track.ObjectType; unset is ``other``."""
_SHARD = re.compile(r"\.tfrecords?(-\d+-of-\d+)?(\.gz)?$")
_NAME = "womd"
HEADER: Final = 12
FOOTER: Final = 4
LARGEST_RECORD: Final = 32 * 2**20
"""Bytes. The largest known scene has 4 MB; a larger length is damage, not data."""
LARGEST_FILE: Final = 2**40
"""Bytes, unpacked. A file is never in memory as a whole; this only sets an end."""

_PIECE: Final = 2**20


def recordings(root: Path) -> Iterator[RecordRef]:
    """The records of a file that starts as a TFRecord does, or is named like one (a damaged one).

    A record's content is passed on: it is read and, in packed files, unpacked once.
    """
    if not (looks_framed(root) or _SHARD.search(root.name)):
        return
    empty = True
    for found in records(root):
        message, empty = None, False
        if isinstance(found, TfRecord):
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
        found = record_at(ref.file, ref.offset or 0, ref.record)
    if isinstance(found, Broken):
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
    return framed(message.SerializeToString(deterministic=True))


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
