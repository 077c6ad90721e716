"""91 moments of SUMO traffic -> scenes: smooth motion, the AV and its partner, the road nearby."""

import hashlib
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from deepmf_sumo import files
from deepmf_sumo.scene import (
    DT_S,
    HISTORY_STEPS,
    SIMULATED,
    AgentId,
    Bools,
    Boundary,
    Floats,
    Lane,
    Neighbour,
    RoadMap,
    Scene,
    SignalLink,
    Signals,
    SignalState,
    Source,
    Tracks,
    frozen,
)
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.ground import distance_m
from deepmf_sumo.sumo.simulation.frame import Body

_HALF_WINDOW: Final = 5
_WEIGHTS: Final = (_HALF_WINDOW + 1.0 - np.abs(np.arange(-_HALF_WINDOW, _HALF_WINDOW + 1))) / 36.0
"""A triangle of 1.1 s. SUMO's vehicles turn within one step where two lanes meet at an angle."""
_JUMP_MPS: Final = 70.0
"""A vehicle that moves faster has been teleported by SUMO."""
_FINEST: Final = 1024.0
"""Motion is rounded to 1/1024 m, m/s and rad: finer than any tracker, and files are half as big."""
_MOVES_M: Final = 10.0
"""The AV moves farther than this, its partner than the next."""
_PARTNER_MOVES_M: Final = 3.0
_NEIGHBOURS: Final = 2
"""At least this number of vehicles are near the AV."""
_NEIGHBOUR_M: Final = 50.0
_PARTNER_GAP_M: Final = 8.0
_TURN_RAD: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """What to record.

    Attributes:
        config: a .sumocfg with traffic.
        seed: of SUMO, of the drivers, of the choice of AVs.
        start_s, stop_s: simulation time; recording starts when the network has filled.
        every_s: interval between the starts of scenes; below 9 s they overlap.
        diverse: use a mixed driver population instead of the demand's own vehicle types.
        avs: maximum number of scenes per moment, each with another AV.
        radius_m: agents that do not come closer to the AV are left out.
        map_radius_m: parts of the road that are not closer to the AV's path are left out.
        name: start of the scenes' names, and their source; None is the configuration's name with
            the seed, and its file.
    """

    config: Path
    seed: int
    start_s: float = 60.0
    stop_s: float = 660.0
    every_s: float = 9.0
    diverse: bool = True
    avs: int = 1
    radius_m: float = 100.0
    map_radius_m: float = 150.0
    name: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficState:
    """State of the traffic at one step: x, y, heading, speed and z as SUMO has them."""

    states: dict[AgentId, tuple[float, float, float, float, float]]
    signals: dict[str, SignalState]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cast:
    """Sorted rows of a scene, the AV, its interacting pair (or none), and vehicles to predict."""

    rows: list[int]
    av_id: AgentId
    interest: tuple[AgentId, ...]
    to_predict: tuple[AgentId, ...]


class Scenes:
    """Makes scenes of windows of 91 moments of one recording."""

    def __init__(
        self, recording: Recording, road: RoadMap, links: dict[str, tuple[SignalLink, ...]]
    ) -> None:
        self._recording = recording
        self._excerpts = Excerpts(road)
        self._stops = {lane: road.lanes[lane].centre_m[0] for lane in links if lane in road.lanes}
        self._digest = hashlib.sha256(files.content(recording.config))
        self._digest.update(repr(replace(recording, config=Path())).encode())
        self._taken = 0

    def of(
        self,
        window: list[TrafficState],
        body: Callable[[AgentId], Body],
        time_s: float,
        rng: np.random.Generator,
    ) -> Iterator[Scene]:
        """A scene for each chosen AV of the window."""
        recording = self._recording
        tracks = _tracks(window, body)
        casts = choose(tracks, HISTORY_STEPS - 1, recording.radius_m, rng, recording.avs)
        first = recording.name or f"{recording.config.stem}-{recording.seed}"
        for number, cast in enumerate(casts):
            name = f"{first}-{time_s:.1f}s" + (f"-{number}" if recording.avs > 1 else "")
            yield self._scene(name, window, tracks, cast)
            self._taken += 1

    def _scene(self, name: str, window: list[TrafficState], tracks: Tracks, cast: Cast) -> Scene:
        way_m = tracks.position_m[tracks.row(cast.av_id), ::5]
        road = self._excerpts.near(way_m, self._recording.map_radius_m)
        stops = {lane: stop for lane, stop in self._stops.items() if lane in road.lanes}
        return Scene(
            name=name,
            source=self._source(),
            dt_s=DT_S,
            now=HISTORY_STEPS - 1,
            timestamps_s=frozen(np.arange(tracks.steps) * DT_S),
            tracks=tracks.select(cast.rows),
            road=road,
            signals=_signals(window, stops),
            av_id=cast.av_id,
            interest=cast.interest,
            to_predict=cast.to_predict,
        )

    def _source(self) -> Source:
        digest = self._digest.copy()
        digest.update(str(self._taken).encode())
        file = self._recording.name or str(self._recording.config)
        return Source(dataset=SIMULATED, file=file, record=self._taken, sha256=digest.hexdigest())


def _tracks(window: list[TrafficState], body: Callable[[AgentId], Body]) -> Tracks:
    ids = sorted({agent for moment in window for agent in moment.states})
    state = np.zeros((len(ids), len(window), 5))
    valid = np.zeros((len(ids), len(window)), bool)
    row_of = {agent: row for row, agent in enumerate(ids)}
    for step, moment in enumerate(window):
        rows = [row_of[agent] for agent in moment.states]
        state[rows, step] = list(moment.states.values()) or np.zeros((0, 5))
        valid[rows, step] = True
    bodies = [body(agent) for agent in ids]
    size = np.array([one.size_m for one in bodies]).reshape(-1, 3)
    centre, heading = frames.from_sumo(state[..., :2], state[..., 2], size[:, None, 0])
    raw = Tracks(
        ids=tuple(ids),
        kinds=tuple(one.kind for one in bodies),
        size_m=size,
        position_m=centre,
        z_m=state[..., 4],
        heading_rad=heading,
        velocity_mps=state[..., 3:4] * frames.unit(heading),
        valid=valid,
    )
    return smooth(raw)


def _signals(window: list[TrafficState], stops: dict[str, Floats]) -> Signals:
    state = np.array(
        [[int(moment.signals.get(lane, 0)) for moment in window] for lane in stops], np.uint8
    ).reshape(len(stops), len(window))
    return Signals(
        lane_ids=tuple(stops),
        state=state,
        seen=state > 0,
        stop_m=np.array(list(stops.values())).reshape(-1, 2),
    )


def smooth(tracks: Tracks) -> Tracks:
    """Tracks with smoothed bumper positions and headings; centres and velocities follow from them.

    A track ends where SUMO teleports its vehicle.
    """
    half = tracks.size_m[:, None, :1] / 2
    front = tracks.position_m + half * frames.unit(tracks.heading_rad)
    valid = _until_jump(front, tracks.valid)
    heading = np.zeros_like(tracks.heading_rad)
    position = np.zeros_like(tracks.position_m)
    velocity = np.zeros_like(tracks.velocity_mps)
    for row in range(tracks.agents):
        for run in _runs(valid[row]):
            heading[row, run] = frames.wrap(_mean(np.unwrap(tracks.heading_rad[row, run])))
            bumper = np.stack([_mean(axis) for axis in front[row, run].T], axis=-1)
            position[row, run] = bumper - half[row] * frames.unit(heading[row, run])
            # a single step has no difference: SUMO's speed is kept
            if run.stop - run.start > 1:
                velocity[row, run] = np.gradient(position[row, run], DT_S, axis=0)
            else:
                velocity[row, run] = tracks.velocity_mps[row, run]
    return Tracks(
        ids=tracks.ids,
        kinds=tracks.kinds,
        size_m=tracks.size_m,
        position_m=np.round(position * _FINEST) / _FINEST,
        z_m=tracks.z_m,
        heading_rad=np.round(heading * _FINEST) / _FINEST,
        velocity_mps=np.round(velocity * _FINEST) / _FINEST,
        valid=valid,
    )


def _until_jump(position: Floats, valid: Bools) -> Bools:
    both = valid[:, 1:] & valid[:, :-1]
    step = np.hypot(*np.moveaxis(np.diff(position, axis=1), -1, 0))
    jump = both & (step > _JUMP_MPS * DT_S)
    # a teleported vehicle is absent for a while: when it returns, its motion is another one
    back = valid[:, 1:] & ~valid[:, :-1] & (np.cumsum(valid, axis=1)[:, :-1] > 0)
    after = np.cumsum(jump | back, axis=1) > 0
    kept: Bools = valid & ~np.pad(after, ((0, 0), (1, 0)))
    return kept


def _runs(valid: Bools) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _mean(values: Floats) -> Floats:
    """Weighted mean over time; both ends are extrapolated, so that even motion is unchanged."""
    if len(values) < 2:
        return values
    padded = np.pad(values, _HALF_WINDOW, mode="reflect", reflect_type="odd")
    mean: Floats = np.convolve(padded, _WEIGHTS, mode="valid")
    return mean


def choose(
    tracks: Tracks, now: int, radius_m: float, rng: np.random.Generator, most: int = 1
) -> list[Cast]:
    """Draw AVs among the vehicles that are valid at all steps, move, and have others around.

    Vehicles that turn or change their speed are drawn more often, since most traffic drives
    evenly. Returns at most ``most`` casts, none if there is no such vehicle.
    """
    car = np.array([kind == "vehicle" for kind in tracks.kinds], bool)
    moved = _travelled(tracks)
    here = tracks.valid[:, now]
    between = np.hypot(*np.moveaxis(_offsets(tracks.position_m[:, now]), -1, 0))
    around = ((between < _NEIGHBOUR_M) & here & here[:, None] & car).sum(axis=1) - 1
    suits = np.flatnonzero(
        car & tracks.valid.all(axis=1) & (moved > _MOVES_M) & (around >= _NEIGHBOURS)
    )
    if not len(suits):
        return []
    weight = _eventfulness(tracks, now)[suits]
    count = min(most, len(suits))
    drawn = rng.choice(suits, count, replace=False, p=weight / weight.sum())
    movers = car & here & (moved > _PARTNER_MOVES_M)
    return [_cast(tracks, int(av), now, radius_m, movers, between[av]) for av in drawn]


def _cast(
    tracks: Tracks, av: int, now: int, radius_m: float, movers: Bools, away_now: Floats
) -> Cast:
    away = np.hypot(*np.moveaxis(tracks.position_m - tracks.position_m[av], -1, 0))
    kept = np.where(tracks.valid, away, np.inf).min(axis=1) < radius_m
    partner = _partner(tracks, av, now, movers & kept)
    others = movers & kept
    others[av] = False
    nearest = [int(row) for row in np.argsort(away_now, kind="stable") if others[row]][:8]
    return Cast(
        rows=[int(row) for row in np.flatnonzero(kept)],
        av_id=tracks.ids[av],
        interest=() if partner is None else (tracks.ids[av], tracks.ids[partner]),
        to_predict=tuple(tracks.ids[row] for row in [av, *nearest]),
    )


def _eventfulness(tracks: Tracks, now: int) -> Floats:
    """(A) from 1 for even motion up to 7 for a vehicle that turns and brakes or accelerates."""
    heading = tracks.heading_rad[:, now::10]
    turned = np.abs(frames.difference(heading[:, 1:], heading[:, :-1])).sum(axis=1)
    speed = np.where(tracks.valid, tracks.speed_mps, np.nan)[:, now:]
    known = tracks.valid[:, now:].any(axis=1)
    change = np.zeros(tracks.agents)
    change[known] = np.nanmax(speed[known], axis=1) - np.nanmin(speed[known], axis=1)
    eventfulness: Floats = 1.0 + 3.0 * (turned > _TURN_RAD) + 3.0 * np.minimum(change / 6.0, 1.0)
    return eventfulness


def _travelled(tracks: Tracks) -> Floats:
    step = np.hypot(*np.moveaxis(np.diff(tracks.position_m, axis=1), -1, 0))
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    travelled: Floats = np.where(both, step, 0.0).sum(axis=1)
    return travelled


def _offsets(position: Floats) -> Floats:
    offsets: Floats = position[:, None] - position
    return offsets


def _partner(tracks: Tracks, av: int, now: int, candidates: Bools) -> int | None:
    """The moving vehicle whose box comes closest to the AV's at one time after ``now``."""
    rows = [int(row) for row in np.flatnonzero(candidates) if row != av]
    if not rows:
        return None
    gap = boxes.gap(
        tracks.position_m[av, now:],
        tracks.heading_rad[av, now:],
        tracks.size_m[av, :2],
        tracks.position_m[rows, now:],
        tracks.heading_rad[rows, now:],
        np.broadcast_to(tracks.size_m[rows, None, :2], (*tracks.position_m[rows, now:].shape,)),
    )
    gap = distance_m(gap, tracks.z_m[av, now:], tracks.z_m[rows, now:])
    closest = np.where(tracks.valid[rows, now:], gap, np.inf).min(axis=1)
    best = int(closest.argmin())
    return rows[best] if closest[best] < _PARTNER_GAP_M else None


class Excerpts:
    """Parts of one road map near paths: recorded scenes contain no more of a road.

    Its features are indexed once.
    """

    def __init__(self, road: RoadMap) -> None:
        self._road = road
        shapes: list[Floats] = [lane.centre_m for lane in road.lanes.values()]
        shapes += [one.points_m for one in (*road.lines, *road.edges)]
        shapes += [one.points_m for one in road.polygons]
        shapes += [sign.position_m.reshape(1, 2) for sign in road.stop_signs]
        shapes += [one.points_m for one in road.beside]
        self._tree = shapely.STRtree([_shape_of(shape) for shape in shapes])

    def near(self, path_m: Floats, radius_m: float) -> RoadMap:
        """The features within a radius of a path (P, 2), each as a whole.

        Lanes do not refer to neighbours, successors, predecessors and lines that are left out.
        """
        found = self._tree.query(_shape_of(path_m), predicate="dwithin", distance=radius_m)
        kept = np.zeros(len(self._tree.geometries), bool)
        kept[found] = True
        road, taken = self._road, iter(kept.tolist())
        lanes = {name: lane for name, lane in road.lanes.items() if next(taken)}
        lines = tuple(one for one in road.lines if next(taken))
        edges = tuple(one for one in road.edges if next(taken))
        borders = {one.id for one in (*lines, *edges)}
        return RoadMap(
            lanes={name: _without(lane, lanes.keys(), borders) for name, lane in lanes.items()},
            lines=lines,
            edges=edges,
            polygons=tuple(one for one in road.polygons if next(taken)),
            stop_signs=tuple(
                replace(sign, lane_ids=tuple(name for name in sign.lane_ids if name in lanes))
                for sign in road.stop_signs
                if next(taken)
            ),
            buildings=tuple(one for one in road.buildings if next(taken)),
            water=tuple(one for one in road.water if next(taken)),
            footways=None
            if road.footways is None
            else tuple(one for one in road.footways if next(taken)),
        )


def _shape_of(points_m: Floats) -> shapely.Geometry:
    # shapely finds no line without a length
    still = bool((points_m == points_m[0]).all())
    return shapely.Point(points_m[0]) if still else shapely.LineString(points_m)


def _without(lane: Lane, lanes: Container[str], borders: Container[str]) -> Lane:
    """The lane, without references to lanes and lines that are left out."""

    def neighbours(beside: Iterable[Neighbour]) -> tuple[Neighbour, ...]:
        return tuple(one for one in beside if one.lane_id in lanes)

    def boundaries(beside: Iterable[Boundary]) -> tuple[Boundary, ...]:
        return tuple(one for one in beside if one.feature_id in borders)

    return replace(
        lane,
        next=tuple(name for name in lane.next if name in lanes),
        previous=tuple(name for name in lane.previous if name in lanes),
        left=neighbours(lane.left),
        right=neighbours(lane.right),
        left_boundaries=boundaries(lane.left_boundaries),
        right_boundaries=boundaries(lane.right_boundaries),
    )
