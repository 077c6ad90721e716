"""A recorded scene: the road, its signals, and the motion of its agents."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Final, Literal

import numpy as np

from deepmf_sumo.scene._arrays import Bools, Bytes, Floats, Frozen, frozen

LaneKind = Literal["unknown", "freeway", "street", "bike"]
PolygonKind = Literal[
    "crosswalk", "speed_bump", "driveway", "building", "footway", "track", "water"
]  # fmt: skip


LINE_TYPES: Final = 9
"""Kinds of painted lines are numbers below this, as WOMD's RoadLine.type."""
EDGE_TYPES: Final = 3
"""Kinds of road edges are numbers below this, as WOMD's RoadEdge.type."""


class SignalState(IntEnum):
    """State of a traffic signal, numbered as in WOMD's TrafficSignalLaneState."""

    UNKNOWN = 0
    ARROW_STOP = 1
    ARROW_CAUTION = 2
    ARROW_GO = 3
    STOP = 4
    CAUTION = 5
    GO = 6
    FLASHING_STOP = 7
    FLASHING_CAUTION = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbour:
    """A lane beside another; indices are into the two polylines."""

    lane_id: str
    self_start: int
    self_end: int
    other_start: int
    other_end: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Boundary:
    """A lane's boundary between two of its points; ``kind`` numbered as WOMD's RoadLine.type."""

    start: int
    end: int
    feature_id: str
    kind: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lane(Frozen):
    """One driving lane.

    Attributes:
        centre_m: (P, 2) centre line in driving direction; P may be 1 in recordings.
        z_m: (P).
        interpolating: added to connect two other lanes, typically inside a junction.
        width_m: None if the source does not state it.
        speed_limit_mps: None if unknown.
        next, previous: ids of the lanes that follow and precede.
        left, right: neighbours in the same direction.
        gives_way_to: lanes inside the junction that have priority, and tracks of trams, which are
            no lanes of the map; also empty if the source does not state it, as in recordings.
    """

    id: str
    kind: LaneKind
    centre_m: Floats
    z_m: Floats
    interpolating: bool = False
    width_m: float | None = None
    speed_limit_mps: float | None = None
    next: tuple[str, ...] = ()
    previous: tuple[str, ...] = ()
    left: tuple[Neighbour, ...] = ()
    right: tuple[Neighbour, ...] = ()
    left_boundaries: tuple[Boundary, ...] = ()
    right_boundaries: tuple[Boundary, ...] = ()
    gives_way_to: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polyline(Frozen):
    """A painted line or a road edge; ``kind`` numbered as WOMD's RoadLine.type or RoadEdge.type."""

    id: str
    kind: int
    points_m: Floats
    z_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polygon(Frozen):
    """A crosswalk, building or other area: closed without repeating the first point."""

    id: str
    kind: PolygonKind
    points_m: Floats
    z_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StopSign(Frozen):
    """A stop sign: (2) position and the lanes that it governs."""

    id: str
    position_m: Floats
    z_m: float
    lane_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, weakref_slot=True)
class RoadMap:
    """All known features of the road; ``lanes`` by id, in the source's order.

    Recordings have none of what is beside the road. ``buildings`` hide road users
    (`geometry.sight`), and with ``water`` keep people away (`geometry.walkable`). ``footways`` are
    sidewalks and other areas for people, and tracks of trams (kind ``track``); None: the source
    maps none.
    """

    lanes: dict[str, Lane]
    lines: tuple[Polyline, ...] = ()
    edges: tuple[Polyline, ...] = ()
    polygons: tuple[Polygon, ...] = ()
    stop_signs: tuple[StopSign, ...] = ()
    buildings: tuple[Polygon, ...] = ()
    footways: tuple[Polygon, ...] | None = None
    water: tuple[Polygon, ...] = ()

    @property
    def beside(self) -> tuple[Polygon, ...]:
        """All areas beside the road."""
        return (*self.buildings, *self.water, *(self.footways or ()))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals(Frozen):
    """Signals of L lanes over T steps.

    Attributes:
        state: (L, T) SignalState numbers.
        seen: (L, T) False if the recording has no state for the step.
        stop_m: (L, 2) where to stop.
    """

    lane_ids: tuple[str, ...]
    state: Bytes
    seen: Bools
    stop_m: Floats
    stop_z_m: Floats = field(default_factory=lambda: frozen([]))

    def __post_init__(self) -> None:
        Frozen.__post_init__(self)
        object.__setattr__(self, "stop_m", self.stop_m.reshape(-1, 2))
        if not len(self.stop_z_m):
            object.__setattr__(self, "stop_z_m", frozen([0.0] * len(self.lane_ids)))

    def at(self, step: int) -> dict[str, SignalState]:
        """Last observed state up to ``step`` inclusive, by lane id; only of lanes observed."""
        states = {}
        for row, lane_id in enumerate(self.lane_ids):
            seen = self.seen[row, : step + 1].nonzero()[0]
            if len(seen):
                states[lane_id] = SignalState(int(self.state[row, seen[-1]]))
        return states

    def later(self, steps: int) -> "Signals":
        """Without the first steps; what was seen last in them is seen at the first that is left."""
        state, seen = self.state[:, steps:].copy(), self.seen[:, steps:].copy()
        known = self.at(steps)
        for row, lane_id in enumerate(self.lane_ids):
            if lane_id in known and seen.shape[1]:
                state[row, 0], seen[row, 0] = known[lane_id], True
        return replace(self, state=state, seen=seen)


DT_S: Final = 0.1
HISTORY_STEPS: Final = 11
"""1 s of history and the current step."""
FUTURE_STEPS: Final = 80
"""8 s to come."""

AgentId = str
AgentKind = Literal["vehicle", "pedestrian", "cyclist", "other"]
_BY_STEP: Final = ("position_m", "z_m", "heading_rad", "velocity_mps", "valid")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks(Frozen):
    """Motion of A agents over T steps.

    Attributes:
        ids: (A) unique.
        kinds: (A).
        size_m: (A, 3) length, width, height. One size per agent: that of the current step, else of
            the valid step nearest to it.
        position_m: (A, T, 2) box centre in the scene's frame.
        z_m: (A, T) height of the ground below the box; its middle is half its height above. Readers
            and exporters convert: most formats of recordings have the middle.
        heading_rad: (A, T).
        velocity_mps: (A, T, 2) in the scene's frame.
        valid: (A, T) False if the agent was not observed at the step (all values are zero then).
    """

    ids: tuple[AgentId, ...]
    kinds: tuple[AgentKind, ...]
    size_m: Floats
    position_m: Floats
    z_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    valid: Bools

    def __post_init__(self) -> None:
        agents, steps = len(self.ids), np.shape(self.valid)[1]
        shapes = {
            "size_m": (agents, 3),
            "position_m": (agents, steps, 2),
            "z_m": (agents, steps),
            "heading_rad": (agents, steps),
            "velocity_mps": (agents, steps, 2),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}, not {shape}")
        Frozen.__post_init__(self)

    @property
    def agents(self) -> int:
        """Number of agents, A."""
        return len(self.ids)

    @property
    def steps(self) -> int:
        """Number of steps, T."""
        return int(self.valid.shape[1])

    @property
    def speed_mps(self) -> Floats:
        """(A, T) length of the velocity."""
        return np.hypot(self.velocity_mps[..., 0], self.velocity_mps[..., 1])

    def row(self, agent_id: AgentId) -> int:
        """Row of an agent. Raises KeyError for an unknown id."""
        try:
            return self.ids.index(agent_id)
        except ValueError:
            raise KeyError(agent_id) from None

    def window(self, start: int, stop: int) -> "Tracks":
        """Steps start..stop-1 of all agents."""
        return replace(self, **{name: getattr(self, name)[:, start:stop] for name in _BY_STEP})

    def padded(self, steps: int) -> "Tracks":
        """With steps added at the end, at which no agent is valid."""
        more = [(0, 0), (0, steps), (0, 0)]
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _BY_STEP}
        arrays = {name: np.pad(one, more[: one.ndim]) for name, one in arrays.items()}
        return replace(self, **arrays)

    def select(self, rows: list[int]) -> "Tracks":
        """The given rows, in the given order."""
        return replace(
            self,
            ids=tuple(self.ids[row] for row in rows),
            kinds=tuple(self.kinds[row] for row in rows),
            size_m=self.size_m[rows],
            **{name: getattr(self, name)[rows] for name in _BY_STEP},
        )


SIMULATED: Final = "sumo"
"""Data set of scenes of SUMO's own traffic."""
ROLLOUT: Final = "rollout"
"""Data set of attacks written as scenes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where a scene came from.

    Attributes:
        dataset: name of the reader, e.g. ``womd``; else `SIMULATED` or `ROLLOUT`.
        file: path as given by the user.
        record: index of the record in the file.
        sha256: hex digest of the record's bytes (of the whole file if it contains one scene);
            empty for a `ROLLOUT` in a network's own traffic.
    """

    dataset: str
    file: str
    record: int
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene(Frozen):
    """One recorded scene.

    Attributes:
        name: the recording's scenario id.
        dt_s: seconds a step.
        now: index of the current step; steps up to it are history.
        timestamps_s: (T) as recorded.
        interest: ids of the labelled interacting agents (0 or 2).
        to_predict: ids that the data set selects for prediction.
        repairs: what the reader repaired, a sentence each.
    """

    name: str
    source: Source
    dt_s: float
    now: int
    timestamps_s: Floats
    tracks: Tracks
    road: RoadMap
    signals: Signals
    av_id: AgentId
    interest: tuple[AgentId, ...] = ()
    to_predict: tuple[AgentId, ...] = ()
    repairs: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        Frozen.__post_init__(self)
        self.tracks.row(self.av_id)

    @property
    def partner_id(self) -> AgentId | None:
        """The labelled agent that interacts with the AV, if the label names the AV."""
        others = [agent for agent in self.interest if agent != self.av_id]
        return others[0] if len(others) == 1 and self.av_id in self.interest else None

    def later(self, steps: int) -> "Scene":
        """The scene with its current step ``steps`` later, and as much history as before."""
        return replace(
            self,
            timestamps_s=self.timestamps_s[steps:],
            tracks=self.tracks.window(steps, self.tracks.steps),
            signals=self.signals.later(steps),
        )

    def of_agents(self, ids: Collection[AgentId]) -> "Scene":
        """The scene with the AV and these agents alone."""
        tracks = self.tracks
        kept = [row for row, one in enumerate(tracks.ids) if one in ids or one == self.av_id]
        return replace(self, tracks=tracks.select(kept))
