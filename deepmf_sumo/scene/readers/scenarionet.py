"""ScenarioNet and MetaDrive: one scene in one pickle, read without running what it names.

What the converters of the data sets write differently about the road is in `_scenarionet_road`.
"""

import pickle
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    DT_S,
    HISTORY_STEPS,
    AgentKind,
    Bools,
    Floats,
    Ints,
    Lane,
    Signals,
    SignalState,
    Source,
)
from deepmf_sumo.scene.readers._pickle import load_plain
from deepmf_sumo.scene.readers._scenarionet_road import (
    EDGE_KINDS,
    LANE_KINDS,
    LINE_KINDS,
    WrittenBy,
    origin_of,
    points_of,
    road_of,
)
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks
from deepmf_sumo.scene.readers.raw.one_file import OneFile, head
from deepmf_sumo.scene.readers.raw.road import SignalsBuilder, agent_at, identifier, quoted

KINDS: Final[dict[str, AgentKind]] = {
    "VEHICLE": "vehicle",
    "PEDESTRIAN": "pedestrian",
    "CYCLIST": "cyclist",
}
OTHER_KINDS: Final = {"OTHER", "UNSET"}
"""Of Waymo: what they are is not known."""
STATES: Final = {f"LANE_STATE_{state.name}": state.value for state in SignalState} | {
    "TRAFFIC_LIGHT_UNKNOWN": SignalState.UNKNOWN.value,
    "TRAFFIC_LIGHT_RED": SignalState.STOP.value,
    "TRAFFIC_LIGHT_YELLOW": SignalState.CAUTION.value,
    "TRAFFIC_LIGHT_GREEN": SignalState.GO.value,
}
"""Signal states in files of all versions but the earliest, which have numbers. The second kind is
nuPlan's and MetaDrive's."""
NOT_SEEN: Final = "TRAFFIC_LIGHT_UNKNOWN"
"""Written for each step without a state by the converters that write the second kind."""
MOVING_MPS: Final = 1.0
"""A road user of recorded speed 0 that moves faster than this has no recorded speed."""
TURNED_RAD: Final = 0.1
"""Headings that are 0 throughout are right where the motion differs from them by less."""
LARGEST_FILE: Final = 2**25
"""Bytes. The largest known scene has 2 MB."""

Described = Mapping[str, Any]

__all__ = ["EDGE_KINDS", "KINDS", "LANE_KINDS", "LINE_KINDS", "load", "recordings"]

_STARTS = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def recordings(root: Path) -> Iterator[RecordRef]:
    """The file's one scene, if it is a pickle (of protocols 0 and 1 the file's name tells that)."""
    start = head(root, 2)
    if start in _STARTS or (start is not None and root.suffix in {".pkl", ".pickle"}):
        yield from _FORMAT.recordings(root)


def load(ref: RecordRef) -> RawScene:
    """The file's scene."""
    return _FORMAT.load(ref)


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


def _name(described: Described, path: Path) -> str:
    return identifier(described["metadata"].get("scenario_id", described.get("id", path.stem)))


def _described(described: Described, name: str, source: Source) -> RawScene:
    metadata = described["metadata"]
    origin = origin_of(described)
    ids = [identifier(key) for key in described["tracks"]]
    repairs: list[str] = []
    if origin.is_mirrored:
        repairs.append("MetaDrive's early frame has y to the right; the scene was mirrored.")
    tracks = _tracks(ids, list(described["tracks"].values()), origin, repairs)
    av_id = _av_id(metadata, ids)
    _turn_av(tracks, av_id, repairs)
    road = road_of(described["map_features"], origin, repairs)
    lights = _Lights(lanes=road.lanes, origin=origin, version=str(described.get("version", "")))
    return RawScene(
        name=name,
        source=source,
        now=max(int(metadata.get("current_time_index") or 0), HISTORY_STEPS - 1),
        timestamps_s=_timestamps(metadata, tracks.valid.shape[1]),
        tracks=tracks,
        road=road,
        signals=lights.read(
            described.get("dynamic_map_states") or {}, tracks.valid.shape[1], repairs
        ),
        av_id=av_id,
        interest=_agents(metadata.get("objects_of_interest")),
        to_predict=_agents(metadata.get("tracks_to_predict")),
        repairs=repairs,
    )


def _av_id(metadata: Described, ids: Sequence[str]) -> str:
    if metadata.get("sdc_id") is not None:
        return identifier(metadata["sdc_id"])
    return agent_at(ids, metadata["sdc_track_index"], "sdc_track_index")


def _agents(listed: Any) -> tuple[str, ...]:
    """Ids of agents, in a list or as the keys of a mapping."""
    return () if listed is None else tuple(map(identifier, listed))


def _timestamps(metadata: Described, steps: int) -> Floats:
    """(T) as recorded, else from the sample rate (in s, or in Hz above 1), else empty."""
    times = metadata.get("ts")
    if times is not None:
        recorded = np.asarray(times, float).reshape(-1)
        # nuScenes' are made by adding 0.1 s, which can come to one too many.
        return recorded[:steps] if len(recorded) == steps + 1 else recorded
    rate = metadata.get("sample_rate")
    if rate is None:
        return np.zeros(0)
    step_s = float(rate) if float(rate) <= 1 else 1 / float(rate)
    return step_s * np.arange(steps, dtype=float)


# Road users


def _tracks(
    ids: list[str], tracks: Sequence[Described], origin: WrittenBy, repairs: list[str]
) -> RawTracks:
    if not tracks:
        raise ValueError("it has no tracks")
    steps = len(tracks[0]["state"]["position"])
    motions = [_CompletedMotion(track["state"], steps, origin) for track in tracks]
    kinds = [identifier(track["type"]) for track in tracks]
    unusual = sorted(set(kinds) - KINDS.keys() - OTHER_KINDS)
    if unusual:
        count = sum(kind in unusual for kind in kinds)
        repairs.append(f"{count} tracks of the kinds {', '.join(unusual)} were read as 'other'.")
    for what, found in (
        ("headings are missing; the direction of motion", [one.turned for one in motions]),
        ("speeds are missing; the motion between steps", [one.sped for one in motions]),
    ):
        rows = [agent for agent, count in zip(ids, found, strict=True) if count]
        if rows:
            repairs.append(f"{sum(found)} {what} was used for {len(rows)} agents: {quoted(rows)}.")
    return RawTracks(
        ids=ids,
        kinds=[KINDS.get(kind, "other") for kind in kinds],
        size_m=np.array([_size(track["state"], steps) for track in tracks]),
        position_m=np.array([one.position_m for one in motions]),
        heading_rad=np.array([one.heading_rad for one in motions]),
        velocity_mps=np.array([one.velocity_mps for one in motions]),
        valid=np.array([one.valid for one in motions]),
    )


class _CompletedMotion:
    """The motion of a road user, in the scene's frame, completed where it is not recorded.

    Attributes:
        position_m: (T, 3). heading_rad: (T). velocity_mps: (T, 2). valid: (T).
        turned, sped: numbers of steps whose heading, or velocity, is that of the motion.
    """

    def __init__(self, state: Described, steps: int, origin: WrittenBy) -> None:
        sign = origin.signs[1]
        self.position_m = _rows(state["position"], steps, 3) * origin.signs
        self.valid = _column(state["valid"], steps) > 0
        self.heading_rad = _column(state["heading"], steps) * sign
        self.turned = self.sped = 0
        if state.get("velocity") is None:
            self.velocity_mps = np.zeros((steps, 2))
        else:
            self.velocity_mps = _rows(state["velocity"], steps, 2) * [1.0, sign]
        if not origin.is_waymo:
            self._complete()

    def _complete(self) -> None:
        """Fill in headings and velocities that are missing, from the motion between steps.

        The nuScenes converter writes speed 0 at the last step of a track, and before each gap.
        """
        moved = np.diff(self.position_m[:, :2], axis=0)
        moved[~(self.valid[1:] & self.valid[:-1])] = 0.0
        before, after = np.zeros((2, len(self.valid), 2))
        before[1:] = after[:-1] = moved / DT_S
        motion = np.where(before.any(axis=1, keepdims=True), before, after)
        speed = np.hypot(motion[:, 0], motion[:, 1])
        missing = self.valid & ~(self.velocity_mps != 0).any(axis=1) & (speed > MOVING_MPS)
        self.velocity_mps[missing] = motion[missing]
        self.sped = int(missing.sum())
        if not (np.nan_to_num(self.heading_rad[self.valid]) != 0).any():
            self._turn(motion, speed)

    def _turn(self, motion: Floats, speed: Floats) -> None:
        """Head in the direction of the motion, unless it is the recorded one, or unknown."""
        moving = np.flatnonzero(self.valid & (speed > MOVING_MPS))
        if not len(moving):
            return
        direction = np.arctan2(motion[moving, 1], motion[moving, 0])
        known = np.isfinite(self.heading_rad[moving])
        if known.all() and np.abs(direction).max() < TURNED_RAD:
            return
        nearest = np.searchsorted((moving[1:] + moving[:-1]) / 2, np.arange(len(speed)))
        self.heading_rad = np.where(self.valid, direction[nearest], 0.0)
        self.turned = int(self.valid.sum())


def _turn_av(tracks: RawTracks, av_id: str, repairs: list[str]) -> None:
    """Exchange length and width of an AV that is wider than long, in place.

    nuScenes' sizes begin with the width; the converter gives those of the AV the other way round.
    """
    if av_id not in tracks.ids:
        return
    row = tracks.ids.index(av_id)
    length, width = tracks.size_m[row, tracks.valid[row], :2].T
    if len(length) and (width > length).all():
        tracks.size_m[row, :, :2] = tracks.size_m[row, :, 1::-1]
        repairs.append("The AV is wider than long; its length and width were exchanged.")


def _size(state: Described, steps: int) -> Floats:
    """(T, 3); the earliest files have one key for all three. What is missing is 0."""
    if "size" in state:
        return np.broadcast_to(np.asarray(state["size"], float), (steps, 3))
    return np.column_stack(
        [_column(state.get(key, 0.0), steps) for key in ("length", "width", "height")]
    )


def _rows(values: Any, steps: int, columns: int) -> Floats:
    """(T, columns) from (T, 2) or (T, 3); a missing third column is 0."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] not in {2, 3} or len(rows) != steps:
        raise ValueError(
            f"an array over time has shape {rows.shape}, not ({steps}, 2) or ({steps}, 3)"
        )
    return np.column_stack([rows, np.zeros(steps)])[:, :columns]


def _column(values: Any, steps: int) -> Floats:
    """(T) from (T), (T, 1), or one number for all steps."""
    column = np.asarray(values, float).reshape(-1)
    if len(column) not in {1, steps}:
        raise ValueError(f"an array over time has {len(column)} values, not {steps}")
    return np.broadcast_to(column, (steps,))


# Signals


@dataclass(kw_only=True)
class _Lights:
    """Reads the signals of the lanes of a road.

    Attributes:
        strange: states that are not known.
        placed: lanes at whose start the stop point was put.
    """

    lanes: Mapping[str, Lane]
    origin: WrittenBy
    version: str
    strange: set[str] = field(default_factory=set)
    placed: list[str] = field(default_factory=list)

    def read(self, described: Mapping[Any, Described], steps: int, repairs: list[str]) -> Signals:
        """Signals over all steps; ``described`` is by lane id."""
        found: dict[str, Described] = {}
        twice: list[str] = []
        for key, light in described.items():
            name = self._lane_of(identifier(key), light)
            if name in found:
                twice.append(name)
            found.setdefault(name, light)
        signals = SignalsBuilder(list(found), steps)
        for row, (name, light) in enumerate(found.items()):
            numbers, there = self._states(light["state"]["object_state"])
            kept = min(steps, len(numbers))
            signals.seen[row, :kept] = there[:kept]
            signals.state[row, :kept] = np.where(there, numbers, 0)[:kept]
            signals.stop_m[row] = self._stop_point(name, light, there)
        self._report(twice, repairs)
        return signals.built()

    def _report(self, twice: Collection[str], repairs: list[str]) -> None:
        if self.strange:
            names = ", ".join(sorted(self.strange))
            repairs.append(f"Unknown signal states were read as unknown: {names}.")
        if self.placed:
            repairs.append(
                f"{len(self.placed)} signals have no stop point; the start of their lane was used: "
                f"{quoted(self.placed)}."
            )
        if twice:
            repairs.append(f"Second signals of a lane were dropped: {quoted(sorted(twice))}.")

    def _lane_of(self, key: str, light: Described) -> str:
        """The lane of a signal: its key, or what it names if the key is no lane."""
        named = light.get("lane")
        is_lane = key in self.lanes or not isinstance(named, str | int | np.integer)
        return key if is_lane else identifier(named)

    def _states(self, listed: Any) -> tuple[Ints, Bools]:
        """(T) numbers of the states, and whether there is one."""
        if isinstance(listed, np.ndarray) and listed.dtype.kind in "iuf":
            return _from_numbers(listed)
        names = [None if name is None else identifier(name) for name in listed]
        self.strange.update(name for name in names if name is not None and name not in STATES)
        numbers = np.array([STATES.get(name or "", 0) for name in names], "int64")
        there = np.array([name is not None and name != NOT_SEEN for name in names], bool)
        # Files of MetaDrive 0.3 write the same for an unknown and for a missing state.
        if self.version.startswith("MetaDrive v0.3"):
            there &= numbers > 0
        return numbers, there

    def _stop_point(self, name: str, light: Described, there: Bools) -> Floats:
        """(3) where to stop: the last one that is written, else the start of the lane.

        That of nuPlan lies 8 m behind the stop line.
        """
        written = light.get("stop_point", light["state"].get("stop_point"))
        if written is not None and self.origin.dataset != "nuplan":
            points = np.atleast_2d(np.asarray(written, float))
            if len(points) == len(there) and len(points) > 1:
                points = points[there]
            points = points[np.isfinite(points).all(axis=1)]
            if self.origin.is_simulated:  # zeros where MetaDrive knows none
                points = points[points.any(axis=1)]
            if len(points):
                return points_of(points[-1:])[0] * self.origin.signs
        lane = self.lanes.get(name)
        if lane is None or not len(lane.centre_m) or not there.any():
            return np.zeros(3)
        self.placed.append(name)
        return np.append(lane.centre_m[0], lane.z_m[0])


def _from_numbers(listed: np.ndarray) -> tuple[Ints, Bools]:
    """The earliest files: WOMD's numbers, 0 at steps without a state."""
    numbers = listed.reshape(-1).astype("int64")
    return np.clip(numbers, 0, 255), numbers > 0


_FORMAT: Final = OneFile(
    dataset="scenarionet", largest=LARGEST_FILE, parse=_parsed, name=_name, describe=_described
)
