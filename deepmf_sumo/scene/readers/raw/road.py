"""The road and the signals of a raw scene, feature by feature, and what fields of formats mean."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from deepmf_sumo.scene import (
    Boundary,
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Signals,
    StopSign,
)
from deepmf_sumo.scene.scene import LaneKind, PolygonKind

LANE_KINDS: Final[tuple[LaneKind, ...]] = ("unknown", "freeway", "street", "bike")
"""By WOMD's LaneCenter.type."""
MPS_PER_MPH: Final = 0.44704


@dataclass
class RoadBuilder:
    """A road map, feature by feature; all points are (P, 3)."""

    lanes: dict[str, Lane] = field(default_factory=dict)
    lines: list[Polyline] = field(default_factory=list)
    edges: list[Polyline] = field(default_factory=list)
    polygons: list[Polygon] = field(default_factory=list)
    stop_signs: list[StopSign] = field(default_factory=list)

    def lane(self, name: str, kind: LaneKind, xyz: Floats, **known: Any) -> None:
        """Add a lane; ``known`` are further attributes of `Lane`.

        Raises ValueError if there is one of this id.
        """
        if name in self.lanes:
            raise ValueError(f"two lanes have the id {name}")
        self.lanes[name] = Lane(id=name, kind=kind, centre_m=xyz[:, :2], z_m=xyz[:, 2], **known)

    def line(self, name: str, kind: int, xyz: Floats) -> None:
        """Add a painted line."""
        self.lines.append(Polyline(id=name, kind=kind, points_m=xyz[:, :2], z_m=xyz[:, 2]))

    def edge(self, name: str, kind: int, xyz: Floats) -> None:
        """Add a road edge."""
        self.edges.append(Polyline(id=name, kind=kind, points_m=xyz[:, :2], z_m=xyz[:, 2]))

    def polygon(self, name: str, kind: PolygonKind, xyz: Floats) -> None:
        """Add a crosswalk, speed bump or driveway."""
        self.polygons.append(Polygon(id=name, kind=kind, points_m=xyz[:, :2], z_m=xyz[:, 2]))

    def stop_sign(self, name: str, xyz: Floats, lane_ids: tuple[str, ...] = ()) -> None:
        """Add a stop sign at a point (3)."""
        self.stop_signs.append(
            StopSign(id=name, position_m=xyz[:2], z_m=float(xyz[2]), lane_ids=lane_ids)
        )

    def built(self) -> RoadMap:
        """The road map of what was added."""
        return RoadMap(
            lanes=self.lanes,
            lines=tuple(self.lines),
            edges=tuple(self.edges),
            polygons=tuple(self.polygons),
            stop_signs=tuple(self.stop_signs),
        )


TWO_STATES: Final = "{} signal states of a lane that has another one at the same step were used."
"""What is said where a file has two states of a lane at a step, of which the last one counts."""


class SignalsBuilder:
    """Signals of L lanes over T steps: ``state`` and ``seen`` (L, T), ``stop_m`` (L, 3)."""

    def __init__(self, lane_ids: Sequence[str], steps: int) -> None:
        self.lane_ids = tuple(lane_ids)
        self.state = np.zeros((len(lane_ids), steps), "uint8")
        self.seen = np.zeros(self.state.shape, bool)
        self.stop_m = np.zeros((len(lane_ids), 3))

    def see(self, row: int, step: int, state: int) -> bool:
        """Set a state; whether another one was there."""
        is_other = bool(self.seen[row, step]) and int(self.state[row, step]) != state
        self.state[row, step], self.seen[row, step] = state, True
        return is_other

    def built(self) -> Signals:
        """The signals as they were filled in."""
        return Signals(
            lane_ids=self.lane_ids,
            state=self.state,
            seen=self.seen,
            stop_m=self.stop_m[:, :2],
            stop_z_m=self.stop_m[:, 2],
        )


Get = Callable[[str], Any]
"""Gives the value of a field that has the same name in WOMD and ScenarioNet."""


def neighbour(get: Get) -> Neighbour:
    """A lane's neighbour from the fields of WOMD's LaneNeighbor."""
    return Neighbour(
        lane_id=identifier(get("feature_id")),
        self_start=int(get("self_start_index")),
        self_end=int(get("self_end_index")),
        other_start=int(get("neighbor_start_index")),
        other_end=int(get("neighbor_end_index")),
    )


def boundary(get: Get, kind: int) -> Boundary:
    """A lane's boundary from the fields of WOMD's BoundarySegment, except its kind."""
    return Boundary(
        start=int(get("lane_start_index")),
        end=int(get("lane_end_index")),
        feature_id=identifier(get("boundary_feature_id")),
        kind=kind,
    )


def lane_kind(number: int) -> LaneKind:
    """The kind of a lane by WOMD's LaneCenter.type; unknown numbers are ``unknown``."""
    return LANE_KINDS[number] if 0 <= number < len(LANE_KINDS) else "unknown"


def identifier(value: Any) -> str:
    """An id as text. Raises ValueError if it is neither text nor a number."""
    if isinstance(value, str | int | float | np.integer | np.floating):
        return str(value)
    raise ValueError(f"an id is neither text nor a number, but of type {type(value).__name__}")


def agent_at(ids: Sequence[str], index: Any, key: str) -> str:
    """The id of a track. Raises ValueError, naming the key with the index, if there is none."""
    if not 0 <= int(index) < len(ids):
        raise ValueError(f"{key} is {index}, but there are {len(ids)} tracks")
    return ids[int(index)]


def quoted(names: Sequence[str]) -> str:
    """The first five names in a sentence."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
