"""Raw scene -> Scene: checks and repairs. Every repair is reported in a sentence."""

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import (
    DT_S,
    Bools,
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    StopSign,
    Tracks,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks, motion
from deepmf_sumo.scene.readers.raw.ground import ground_m, lanes_with_heights
from deepmf_sumo.scene.readers.raw.motion import FARTHEST_M
from deepmf_sumo.scene.readers.raw.road import quoted
from deepmf_sumo.scene.road_users import usual_size_m
from deepmf_sumo.texts import LONGEST_ID, is_plain, shown

MOST_STATES: Final = 1_000_000
"""Agents times steps; the largest scenes have 80 000."""
MOST_FEATURES: Final = 50_000
MOST_POINTS: Final = 2_000_000
"""The largest maps of scenes have 2 000 features with 100 000 points in all."""
LONGEST_SENTENCE: Final = 2000
"""Characters of what is said of one fault, which can name many ids, or quote a text of the file."""
_SIZES_M: Final = (0.05, 200.0)
"""Lengths and widths outside were not measured."""
_HIGHEST_M: Final = 30.0
"""Larger heights were not measured."""
_HIGH_M: Final = 1.0
"""Tracks at 0 stay there where the road is nearer to 0 than this, or flatter."""

Feature = Lane | Polyline | Polygon | StopSign
F = TypeVar("F", Polyline, Polygon, StopSign)


def repair(found: RawScene | Scene) -> Scene:
    """The scene of what a reader loaded, repaired where that is possible; `Scene.repairs` says how.

    A Scene, which was checked before it was written, stays as it is: where it would need a repair
    it is refused. Raises ReaderError with the reason, without place and full stop.
    """
    with np.errstate(all="ignore"):  # the checks find damaged numbers
        if isinstance(found, RawScene):
            found = motion.thinned(found)
        tracks, lights = found.tracks, found.signals
        _refuse_ids(found.name, tracks.ids, lights.lane_ids, found.road)
        _refuse_extent(tracks.ids, tracks.valid.shape[1], found.now)
        _refuse_twice(tracks.ids, lights.lane_ids)
        return _repaired(found) if isinstance(found, RawScene) else _confirmed(found)


def _confirmed(scene: Scene) -> Scene:
    """A scene that was checked before, unchanged."""
    tracks, now = scene.tracks, scene.now
    _refuse_values(tracks)
    _refuse_av(scene.av_id, tracks.valid[tracks.row(scene.av_id)], now)
    _refuse_unknown(scene)
    repairs: list[str] = []
    _repaired_road(scene.road, repairs)
    if repairs:
        raise ReaderError(f"the road was changed: {repairs[0].rstrip('.')}")
    return scene


def _repaired(recording: RawScene) -> Scene:
    raw, now, repairs = recording.tracks, recording.now, list(recording.repairs)
    steps = raw.valid.shape[1]
    av_id = _named_av(recording)
    timestamps = motion.timestamps(recording.timestamps_s, steps, repairs)
    motion.fill_unknown_heights(raw, repairs)
    motion.drop_impossible_states(raw, repairs)
    _refuse_av(av_id, raw.valid[raw.ids.index(av_id)], now, repairs)
    motion.refuse_other_rate(raw, timestamps)
    motion.cut_jumps(raw, timestamps, now, av_id, repairs)
    road = _repaired_road(with_heights(recording.road, repairs), repairs)
    tracks = _on_the_road(_finished(raw, now, av_id, repairs), road, repairs)
    return Scene(
        name=recording.name,
        source=recording.source,
        dt_s=DT_S,
        now=now,
        timestamps_s=timestamps,
        tracks=tracks,
        road=road,
        signals=_signals(recording.signals, road.lanes, steps, repairs),
        av_id=av_id,
        interest=_known(recording.interest, tracks.ids, "objects of interest", repairs),
        to_predict=_known(recording.to_predict, tracks.ids, "tracks to predict", repairs),
        repairs=tuple(shown(cut(repair)) for repair in repairs),
    )


def cut(sentence: str) -> str:
    """The sentence, or its beginning if it is very long."""
    return sentence if len(sentence) <= LONGEST_SENTENCE else f"{sentence[:LONGEST_SENTENCE]} ..."


# Ids and extent


def _refuse_ids(name: str, agents: Iterable[str], signals: Iterable[str], road: RoadMap) -> None:
    """Raises ReaderError, with its place, for the first id that is not short, printable text."""
    named: dict[str, Iterable[str]] = {
        "name of the scene": [name],
        "id of an agent": agents,
        "lane of a signal": signals,
        "id on the map": _ids_of(road),
    }
    for what, ids in named.items():
        for one in ids:
            if not isinstance(one, str):
                raise ReaderError(f"the {what} is of type {type(one).__name__}, not text")
            if len(one) > LONGEST_ID:
                raise ReaderError(f"the {what}, {one[:20]}..., is longer than {LONGEST_ID} letters")
            if not is_plain(one):
                raise ReaderError(f"the {what}, {one[:40]!a}, has characters that cannot be shown")


def _ids_of(road: RoadMap) -> Iterator[str]:
    for key, lane in road.lanes.items():
        yield from (key, lane.id, *lane.next, *lane.previous, *lane.gives_way_to)
        for neighbour in (*lane.left, *lane.right):
            yield neighbour.lane_id
        for boundary in (*lane.left_boundaries, *lane.right_boundaries):
            yield boundary.feature_id
    features: tuple[Feature, ...] = (*road.lines, *road.edges, *road.polygons, *road.stop_signs)
    yield from (feature.id for feature in (*features, *road.beside))
    for sign in road.stop_signs:
        yield from sign.lane_ids


def _refuse_extent(agents: Sequence[str], steps: int, now: int) -> None:
    """Raises ReaderError for too many states, or a missing future."""
    if len(agents) * steps > MOST_STATES:
        raise ReaderError(
            f"has {len(agents)} agents over {steps} steps, more than {MOST_STATES} states in all"
        )
    if steps < now + 2:
        raise ReaderError(
            f"has {steps} steps, and at least {now + 2} are needed: step {now} is the current one, "
            "so that no future was recorded; take a file of the training or validation split"
        )


def _refuse_twice(agents: Iterable[str], signals: Iterable[str]) -> None:
    """Raises ReaderError for an id of two tracks, or a lane of two signals."""
    for ids, said in ((agents, "two tracks have the id"), (signals, "two signals are of lane")):
        twice = next((one for one, count in Counter(ids).items() if count > 1), None)
        if twice is not None:
            raise ReaderError(f"{said} {twice}")


def _refuse_unknown(scene: Scene) -> None:
    """Raises ReaderError for agents that the scene lacks, and for invalid times and signals."""
    missing = set(scene.interest + scene.to_predict).difference(scene.tracks.ids)
    if missing:
        raise ReaderError(f"'interest' or 'to_predict' names {min(missing)}, which is not there")
    if abs(scene.dt_s - DT_S) > 1e-9:
        raise ReaderError(f"'dt_s' is {scene.dt_s:g}; only {DT_S} s can be used")
    times = scene.timestamps_s
    if not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise ReaderError("'timestamps_s' is not finite or runs backwards")
    motion.timestamps(times, scene.tracks.steps, [])
    strange = scene.signals.state[scene.signals.state > max(SignalState)]
    if len(strange):
        raise ReaderError(f"'signals_state' has the unknown state {strange[0]}")
    if not np.isfinite(scene.signals.stop_m).all():
        raise ReaderError("'signals_stop_m' is not finite")


def _known(
    wanted: tuple[str, ...], ids: tuple[str, ...], what: str, repairs: list[str]
) -> tuple[str, ...]:
    missing = [agent for agent in wanted if agent not in ids]
    if missing:
        repairs.append(f"The {what} {', '.join(missing)} are not tracks and were dropped.")
    return tuple(agent for agent in wanted if agent in ids)


# The AV and the clock


def _named_av(recording: RawScene) -> str:
    av_id = recording.av_id
    if av_id is None:
        raise ReaderError(
            "the AV is not named, and no object has the size of the recording vehicle"
        )
    if av_id not in recording.tracks.ids:
        raise ReaderError(f"the AV is '{av_id}', but there is no such track")
    return av_id


def _refuse_av(av_id: str, valid: Bools, now: int, repairs: Sequence[str] = ()) -> None:
    """Raises ReaderError; states dropped from the AV's track before are the likely cause."""
    if not valid[now]:
        causes = [line.rstrip(".") for line in repairs if line.startswith(f"Agent {av_id}:")]
        why = f" ({'; '.join(causes)})" if causes else ""
        raise ReaderError(f"the AV ({av_id}) has no valid state at the current step {now}{why}")


# Motion


def _refuse_values(tracks: Tracks) -> None:
    """Raises ReaderError for a valid state that is not finite, or an agent without a size."""
    for name in ("position_m", "heading_rad", "velocity_mps", "z_m"):
        values = getattr(tracks, name)
        bad = ~np.isfinite(values if values.ndim == 2 else values.sum(-1)) & tracks.valid
        if bad.any():
            agent, step = np.argwhere(bad)[0]
            raise ReaderError(f"{name} of {tracks.ids[agent]} at step {step} is not finite")
    flat = ~((tracks.size_m[:, :2] > 0).all(-1) & np.isfinite(tracks.size_m).all(-1))
    if flat.any():
        raise ReaderError(f"agent {tracks.ids[int(flat.argmax())]} has no length or width")


def _finished(raw: RawTracks, now: int, av_id: str, repairs: list[str]) -> Tracks:
    """Tracks with one size per agent, wrapped headings, zeros where invalid.

    Agents without a valid state are dropped. Raises ReaderError if the AV has no size.
    """
    seen = raw.valid.any(axis=1)
    rows = np.flatnonzero(seen)
    if len(rows) < len(raw.ids):
        never = [raw.ids[row] for row in np.flatnonzero(~seen)]
        repairs.append(f"Agents without a valid state were dropped: {', '.join(never)}.")
    ids, kinds = [raw.ids[row] for row in rows], [raw.kinds[row] for row in rows]
    valid = raw.valid[rows]
    position = np.where(valid[..., None], raw.position_m[rows], 0.0)
    sizes, sized = _sizes(ids, raw.size_m[rows], valid, now, repairs)
    for agent in np.flatnonzero(~sized):
        if ids[agent] == av_id:
            raise ReaderError(f"the AV ({av_id}) has no size{_plausible()}")
        length, width, _ = sizes[agent] = usual_size_m(kinds[agent])
        repairs.append(
            f"Agent {ids[agent]} has no size{_plausible()}; {length} x {width} m, typical of its "
            f"kind ({kinds[agent]}), was used."
        )
    for agent in np.flatnonzero(~((sizes[:, 2] >= 0) & (sizes[:, 2] <= _HIGHEST_M))):
        repairs.append(f"Agent {ids[agent]} has a height of {sizes[agent, 2]:g} m; it is unknown.")
        sizes[agent, 2] = 0.0
    return Tracks(
        ids=tuple(ids),
        kinds=tuple(kinds),
        size_m=sizes,
        position_m=position[..., :2],
        z_m=_ground_m(position[..., 2], sizes[:, 2], valid),
        heading_rad=np.where(valid, frames.wrap(np.where(valid, raw.heading_rad[rows], 0.0)), 0.0),
        velocity_mps=np.where(valid[..., None], raw.velocity_mps[rows], 0.0),
        valid=valid,
    )


def _on_the_road(tracks: Tracks, road: RoadMap, repairs: list[str]) -> Tracks:
    """Tracks without heights stand on the lanes; if none has one, only where lanes climb.

    Else vehicles that climb and descend a hill from 0 on, each with the lanes below it, would come
    to pass over each other. No height is 0, and a road near 0 leaves it.
    """
    bare = tracks.valid & (tracks.z_m == 0.0).all(axis=1, keepdims=True)
    if not bare.any():
        return tracks
    ground = ground_m(road, tracks.position_m, tracks.heading_rad, bare)
    flat = np.ptp(ground[bare]) < _HIGH_M and not tracks.z_m.any()
    if np.median(np.abs(ground[bare])) < _HIGH_M or flat:
        return tracks
    some = f"{int(bare.any(axis=1).sum())} tracks have"
    who = some if tracks.z_m.any() else "The tracks have"
    repairs.append(f"{who} no heights; those of the lanes below were used.")
    return replace(tracks, z_m=np.where(bare, ground, tracks.z_m))


def _ground_m(middle_m: Floats, height_m: Floats, valid: Bools) -> Floats:
    """(A, T) heights below the boxes: recordings tell those of their middles, and 0 for none."""
    told = valid & (middle_m != 0.0)
    return np.where(told, middle_m - height_m[:, None] / 2, middle_m)


def _plausible() -> str:
    return f" of {_SIZES_M[0]:g} to {_SIZES_M[1]:g} m"


def _sizes(
    ids: list[str], size_m: Floats, valid: Bools, now: int, repairs: list[str]
) -> tuple[Floats, Bools]:
    """(A, 3) size at the valid step nearest to ``now`` that has one, and (A) whether there is one.

    A height of 0 means that the source has none; it stays.
    """
    away = np.abs(np.arange(valid.shape[1]) - now)
    far = len(away) * 2
    measured = (size_m[..., :2] >= _SIZES_M[0]) & (size_m[..., :2] <= _SIZES_M[1])
    sized = valid & np.isfinite(size_m).all(-1) & measured.all(-1)
    nearest = np.where(valid, away, far).argmin(axis=1)
    usable = np.where(sized, away, far).argmin(axis=1)
    has_size = np.asarray(sized.any(axis=1))
    repairs.extend(
        f"Agent {ids[agent]} has no size at step {nearest[agent]}; "
        f"that of step {usable[agent]} was used."
        for agent in np.flatnonzero((nearest != usable) & has_size)
    )
    return size_m[np.arange(len(ids)), usable].copy(), has_size


# Road and signals


def is_placed(feature: Feature) -> bool:
    """Whether all its points are finite numbers and within the extent of a recording."""
    match feature:
        case Lane(centre_m=points) | Polyline(points_m=points) | Polygon(points_m=points):
            xyz = np.column_stack([points, feature.z_m])
        case StopSign(position_m=point, z_m=height):
            xyz = np.array([[*point, height]])
    return bool((np.abs(xyz) < FARTHEST_M).all())  # false for NaN, too


def _refuse_road(road: RoadMap) -> None:
    """Raises ReaderError for a map without lanes, with a bad lane, or larger than a recording's."""
    if not road.lanes:
        raise ReaderError("the record has no lanes")
    features: tuple[Polyline | Polygon, ...] = (*road.lines, *road.edges, *road.polygons)
    features += road.beside
    if len(road.lanes) + len(features) + len(road.stop_signs) > MOST_FEATURES:
        raise ReaderError(f"the map has more than {MOST_FEATURES} features")
    points = sum(len(lane.centre_m) for lane in road.lanes.values())
    if points + sum(len(feature.points_m) for feature in features) > MOST_POINTS:
        raise ReaderError(f"the map has more than {MOST_POINTS} points")
    for lane in road.lanes.values():
        if not is_placed(lane):
            # Other lanes refer to its points by index: none of them can be dropped.
            raise ReaderError(
                f"lane {lane.id} has points that are not finite numbers, or too far away"
            )


def with_heights(road: RoadMap, repairs: list[str]) -> RoadMap:
    """The road with heights everywhere, see `ground.lanes_with_heights`."""
    unknown = [lane.id for lane in road.lanes.values() if not np.isfinite(lane.z_m).all()]
    if not unknown:
        return road
    filled = lanes_with_heights(road, unknown)
    low = not any(lane.z_m.any() for lane in filled.values())
    said = "were taken to be at 0" if low else "have those of the nearest lanes"
    repairs.append(f"{len(unknown)} lanes without heights {said}: {quoted(unknown)}.")
    return replace(road, lanes=road.lanes | filled)


def _repaired_road(road: RoadMap, repairs: list[str]) -> RoadMap:
    """The road without features that have no usable points, and without links to nowhere.

    Raises ReaderError as `_refuse_road`.
    """
    _refuse_road(road)
    empty = [lane.id for lane in road.lanes.values() if not len(lane.centre_m)]
    if empty:
        repairs.append(f"Lanes without points were dropped: {', '.join(empty)}.")
    lanes = {name: lane for name, lane in road.lanes.items() if len(lane.centre_m)}
    if not lanes:
        raise ReaderError("no lane of the record has points")
    lost: list[str] = []
    linked = {name: _linked(lane, lanes, lost) for name, lane in lanes.items()}
    signs = [_linked_sign(sign, lanes, lost) for sign in road.stop_signs]
    if lost:
        repairs.append(
            f"{len(lost)} links to lanes, or to points of lanes, that are not in the record were "
            f"dropped, e.g. {lost[0]}."
        )
    walked = road.footways
    return replace(
        road,
        lanes=linked,
        lines=_usable(road.lines, "lines", repairs),
        edges=_usable(road.edges, "edges", repairs),
        polygons=_usable(road.polygons, "polygons", repairs),
        stop_signs=_usable(signs, "stop signs", repairs),
        buildings=_usable(road.buildings, "buildings", repairs),
        footways=None if walked is None else _usable(walked, "footways", repairs),
        water=_usable(road.water, "areas of water", repairs),
    )


def _linked(lane: Lane, lanes: dict[str, Lane], lost: list[str]) -> Lane:
    beside = (*lane.left, *lane.right)
    missing = [other for other in (*lane.next, *lane.previous) if other not in lanes]
    missing += [other.lane_id for other in beside if not _is_beside(other, lane, lanes)]
    if not missing:
        return lane
    lost.extend(f"lane {lane.id} to {other}" for other in missing)
    return replace(
        lane,
        next=tuple(other for other in lane.next if other in lanes),
        previous=tuple(other for other in lane.previous if other in lanes),
        left=tuple(other for other in lane.left if _is_beside(other, lane, lanes)),
        right=tuple(other for other in lane.right if _is_beside(other, lane, lanes)),
    )


def _is_beside(neighbour: Neighbour, lane: Lane, lanes: dict[str, Lane]) -> bool:
    """Whether the neighbour exists; ends may be one past the last point, as in WOMD."""
    if neighbour.lane_id not in lanes:
        return False
    own, other = len(lane.centre_m), len(lanes[neighbour.lane_id].centre_m)
    return (
        0 <= neighbour.self_start < own
        and neighbour.self_start <= neighbour.self_end <= own
        and 0 <= neighbour.other_start < other
        and neighbour.other_start <= neighbour.other_end <= other
    )


def _linked_sign(sign: StopSign, lanes: dict[str, Lane], lost: list[str]) -> StopSign:
    lost.extend(f"stop sign {sign.id} to {other}" for other in sign.lane_ids if other not in lanes)
    return replace(sign, lane_ids=tuple(other for other in sign.lane_ids if other in lanes))


def _usable(features: Sequence[F], what: str, repairs: list[str]) -> tuple[F, ...]:
    """The features that have points, all of them in range; the others are reported."""
    usable = [is_placed(feature) and bool(np.size(feature.z_m)) for feature in features]
    if not all(usable):
        lost = [
            feature.id for feature, is_kept in zip(features, usable, strict=True) if not is_kept
        ]
        repairs.append(
            f"{len(lost)} {what} without points, or with points out of range, were dropped: "
            f"{quoted(lost)}."
        )
    return tuple(itertools.compress(features, usable))


def _signals(signals: Signals, lanes: Collection[str], steps: int, repairs: list[str]) -> Signals:
    """Signals of the given lanes over all steps of the scene; unrecorded steps are not seen."""
    kept = np.array([lane in lanes for lane in signals.lane_ids], bool)
    lost = [lane for lane in signals.lane_ids if lane not in lanes]
    if lost:
        repairs.append(f"Signals of lanes not in the record were dropped: {', '.join(lost)}.")
    there = signals.state.shape[1]
    if there > steps:
        repairs.append(f"Signals of {there - steps} steps after the last track state were dropped.")
    state = np.zeros((int(kept.sum()), steps), "uint8")
    seen = np.zeros(state.shape, bool)
    last = min(there, steps)
    state[:, :last], seen[:, :last] = signals.state[kept, :last], signals.seen[kept, :last]
    unknown = seen & (state > max(SignalState))
    if unknown.any():
        repairs.append(f"{int(unknown.sum())} signal states above 8 were read as unknown.")
    state[~seen | unknown] = 0
    return Signals(
        lane_ids=tuple(lane for lane in signals.lane_ids if lane in lanes),
        state=state,
        seen=seen,
        stop_m=signals.stop_m[kept],
        stop_z_m=signals.stop_z_m[kept],
    )
