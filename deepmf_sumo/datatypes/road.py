"""The road as both recordings and SUMO networks describe it."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

from deepmf_sumo.datatypes.arrays import Bools, Bytes, Floats, frozen

LaneKind = Literal["unknown", "freeway", "street", "bike"]
PolygonKind = Literal["crosswalk", "speed_bump", "driveway"]


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
    """What bounds a lane between two of its points; ``kind`` numbered as WOMD's RoadLine.type."""

    start: int
    end: int
    feature_id: str
    kind: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lane:
    """One driving lane.

    Attributes:
        centre_m: (P, 2) centre line in driving direction; P may be 1 in recordings.
        z_m: (P).
        interpolating: made up to join two others, typically inside a junction.
        width_m: None where the source does not say.
        speed_limit_mps: None where unknown.
        next, previous: ids of the lanes that follow and precede.
        left, right: neighbours in the same direction.
        gives_way_to: lanes inside the junction whose traffic goes first; empty, too, where the
            source does not say, as in recordings.
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_m", frozen(self.centre_m))
        object.__setattr__(self, "z_m", frozen(self.z_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polyline:
    """A painted line or a road edge; ``kind`` numbered as WOMD's RoadLine.type or RoadEdge.type."""

    id: str
    kind: int
    points_m: Floats
    z_m: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", frozen(self.points_m))
        object.__setattr__(self, "z_m", frozen(self.z_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Polygon:
    """A crosswalk, speed bump or driveway: closed without repeating the first point."""

    id: str
    kind: PolygonKind
    points_m: Floats
    z_m: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", frozen(self.points_m))
        object.__setattr__(self, "z_m", frozen(self.z_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StopSign:
    """A stop sign: (2) position and the lanes that it governs."""

    id: str
    position_m: Floats
    z_m: float
    lane_ids: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", frozen(self.position_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadMap:
    """All that is known of the road; ``lanes`` by id, in the source's order."""

    lanes: dict[str, Lane]
    lines: tuple[Polyline, ...] = ()
    edges: tuple[Polyline, ...] = ()
    polygons: tuple[Polygon, ...] = ()
    stop_signs: tuple[StopSign, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """Signals of L lanes over T steps.

    Attributes:
        state: (L, T) SignalState numbers.
        seen: (L, T) False where the recording holds no state for the step.
        stop_m: (L, 2) where to stop.
    """

    lane_ids: tuple[str, ...]
    state: Bytes
    seen: Bools
    stop_m: Floats
    stop_z_m: Floats = field(default_factory=lambda: frozen([]))

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", frozen(self.state, "uint8"))
        object.__setattr__(self, "seen", frozen(self.seen, bool))
        object.__setattr__(self, "stop_m", frozen(self.stop_m).reshape(-1, 2))
        heights = self.stop_z_m if len(self.stop_z_m) else [0.0] * len(self.lane_ids)
        object.__setattr__(self, "stop_z_m", frozen(heights))

    def at(self, step: int) -> dict[str, SignalState]:
        """Last state seen up to ``step`` inclusive, by lane id; lanes never seen are left out."""
        states = {}
        for row, lane_id in enumerate(self.lane_ids):
            seen = self.seen[row, : step + 1].nonzero()[0]
            if len(seen):
                states[lane_id] = SignalState(int(self.state[row, seen[-1]]))
        return states
