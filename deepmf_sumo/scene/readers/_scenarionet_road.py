"""The map of a ScenarioNet description, which each of ScenarioNet's converters writes differently.

- Waymo: lanes with heights, neighbours by the indices of their points, limits in mph.
- nuScenes and Lyft: the third number of a lane's point is its direction, not its height. Walkways
  are polygons, and lanes have no neighbours.
- nuPlan: flat, neighbours are ids alone, limits in m/s.
- Argoverse 2: all lanes are ``interpolating``, all limits are 85 mph, and nothing has neighbours.
- MetaDrive's own scenes: flat, neighbours are ids alone, each lane of a road leads to all lanes of
  the next road, and 1000 km/h means no limit. Before version 0.4 their y axis points to the right.

What is inferred, left out or replaced is reported in sentences. The lanes' ``width`` was computed
by the converter and is not read.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import getitem
from typing import Any, Final

import numpy as np

from deepmf_sumo.scene import Floats, Ints, Lane, Neighbour, RoadMap
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.readers.raw import lane_links
from deepmf_sumo.scene.readers.raw.repair import is_placed
from deepmf_sumo.scene.readers.raw.road import (
    MPS_PER_MPH,
    RoadBuilder,
    boundary,
    identifier,
    neighbour,
    quoted,
)
from deepmf_sumo.scene.scene import LaneKind, PolygonKind

LANE_KINDS: Final[dict[str, LaneKind]] = {
    "LANE_FREEWAY": "freeway",
    "LANE_SURFACE_STREET": "street",
    "LANE_SURFACE_UNSTRUCTURE": "street",
    "LANE_BIKE_LANE": "bike",
}
INSIDE_JUNCTION: Final = "LANE_SURFACE_UNSTRUCTURE"
"""The type of lanes that connect others inside a junction, where ``interpolating`` is missing."""
LINE_KINDS: Final = (
    "ROAD_LINE_UNKNOWN",
    "ROAD_LINE_BROKEN_SINGLE_WHITE",
    "ROAD_LINE_SOLID_SINGLE_WHITE",
    "ROAD_LINE_SOLID_DOUBLE_WHITE",
    "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    "ROAD_LINE_BROKEN_DOUBLE_YELLOW",
    "ROAD_LINE_SOLID_SINGLE_YELLOW",
    "ROAD_LINE_SOLID_DOUBLE_YELLOW",
    "ROAD_LINE_PASSING_DOUBLE_YELLOW",
)
"""By WOMD's RoadLine.type."""
EDGE_KINDS: Final = ("ROAD_EDGE_UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN")
"""By WOMD's RoadEdge.type."""
POLYGON_KINDS: Final[dict[str, PolygonKind]] = {
    "CROSSWALK": "crosswalk",
    "CROSS_WALK": "crosswalk",
    "SPEED_BUMP": "speed_bump",
    "DRIVEWAY": "driveway",
}
BESIDE_ROAD: Final = {"ROAD_EDGE_SIDEWALK": "sidewalks", "GUARDRAIL": "guardrails"}
"""Areas beside the road, which a scene has no place for."""
FASTEST_LIMIT_MPS: Final = 60.0
"""Higher limits mean that there is none."""
DIRECTION_OFF_RAD: Final = 0.1
"""Third coordinates that are the directions of their lanes differ from them by less,"""
DIRECTION_SHARE: Final = 0.9
"""at this share of the points at least."""
ONE_WAY: Final = 0.98
"""Lanes whose mean direction is longer than this all lead the same way."""
CONTINUES_M: Final = 1.75
"""A lane that starts farther from another's end is beside the one that follows it."""
SPACING_M: Final = 1.5
"""Between the points at which neighbours are looked for."""

Described = Mapping[str, Any]

_WAYMO: Final = {"", "waymo", "womd", "deepmf_sumo"}
_DIRECTIONS: Final = {"nuscenes", "lyft", "l5"}
_OUTLINED: Final = {"nuscenes", "lyft", "l5", "nuplan", "av2"}
_MADE_UP: Final[dict[str, tuple[str, float]]] = {
    "av2": ("speed_limit_mph", 85.0),
    "nuscenes": ("speed_limit_kmh", 100.0),
}
"""The limit that a converter writes for lanes of which it knows none."""
_LIMITS: Final = {
    "speed_limit_mph": MPS_PER_MPH,
    "speed_limit_mps": 1.0,
    "speed_limit_kmh": 1 / 3.6,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenBy:
    """What is known about the program that wrote a description.

    Attributes:
        dataset: the name of the data set in lower case; empty if it is not stated.
        is_simulated: MetaDrive wrote it after a simulation.
        is_mirrored: its y axis points to the right of its x axis.
    """

    dataset: str
    is_simulated: bool
    is_mirrored: bool

    @property
    def is_waymo(self) -> bool:
        """Whether it is WOMD's scene, or of a program that describes scenes as completely."""
        return self.dataset in _WAYMO and not self.is_simulated

    @property
    def signs(self) -> Floats:
        """(3) factors of x, y and z in the scene's frame, whose y axis points to the left."""
        return np.array([1.0, -1.0 if self.is_mirrored else 1.0, 1.0])


def origin_of(described: Described) -> WrittenBy:
    """The origin of a description with ``metadata`` and ``map_features``."""
    metadata = described["metadata"]
    is_simulated = bool(metadata.get("metadrive_processed"))
    return WrittenBy(
        dataset=str(metadata.get("dataset") or "").lower(),
        is_simulated=is_simulated,
        is_mirrored=is_simulated
        and _is_mirrored(described["map_features"], str(described.get("version", ""))),
    )


def road_of(features: Mapping[Any, Described], origin: WrittenBy, repairs: list[str]) -> RoadMap:
    """The road. What is dropped, inferred or replaced is listed in ``repairs``."""
    reading = _Reading(origin=origin)
    for key, feature in features.items():
        reading.add(identifier(key), identifier(feature["type"]), feature)
    return reading.finished(repairs)


def _is_mirrored(features: Mapping[Any, Described], version: str) -> bool:
    """Whether neighbours lie on the wrong side; without any, whether the version is old."""
    right = wrong = 0
    by_name = {identifier(key): feature for key, feature in features.items()}
    for feature in by_name.values():
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for other in _listed(feature, side):
                name = other if _is_name(other) else other["feature_id"]
                beside = by_name.get(identifier(name), {})
                left_m = _left_of(feature.get("polyline"), beside.get("polyline"))
                right += left_m * sign > 0
                wrong += left_m * sign < 0
    if right or wrong:
        return wrong > right
    return version.startswith(("MetaDrive v0.2", "MetaDrive v0.3"))


def _left_of(own: Any, other: Any) -> float:
    """How far left of the middle of a line the middle of another one is; 0 if there is none."""
    if own is None or other is None or len(own) < 2 or not len(other):
        return 0.0
    line, beside = points_of(own)[:, :2], points_of(other)[:, :2]
    at = len(line) // 2
    ahead = line[at] - line[at - 1]
    away = beside[len(beside) // 2] - line[at]
    return float(ahead[0] * away[1] - ahead[1] * away[0]) / max(float(np.hypot(*ahead)), 1e-9)


@dataclass(kw_only=True)
class _Reading:
    """A map, feature by feature, and what cannot be kept of it."""

    origin: WrittenBy
    road: RoadBuilder = field(default_factory=RoadBuilder)
    lanes: dict[str, tuple[Described, Floats]] = field(default_factory=dict)
    unknown: set[str] = field(default_factory=set)
    beside_road: Counter[str] = field(default_factory=Counter)
    without_points: list[str] = field(default_factory=list)
    outlines: int = 0
    made_up: int = 0

    def add(self, name: str, kind: str, feature: Described) -> None:
        """Add a feature. UNKNOWN is a lane's and a line's type; only lanes have a speed limit."""
        if kind in BESIDE_ROAD:
            self.beside_road[BESIDE_ROAD[kind]] += 1
        elif kind.startswith("LANE_") or (kind == "UNKNOWN" and _LIMITS.keys() & feature.keys()):
            self._add_lane(name, feature)
        elif kind in {"UNKNOWN", "UNKNOWN_LINE"} or kind.startswith("ROAD_LINE_"):
            self._add_line(name, kind, feature)
        elif kind.startswith("ROAD_EDGE_"):
            points = self._outline(name, feature, "polyline", "polygon")
            if points is not None:
                self.road.edge(name, number_of(EDGE_KINDS, kind), points)
        elif kind in POLYGON_KINDS:
            points = self._outline(name, feature, "polygon", "polyline")
            if points is not None:
                self.road.polygon(name, POLYGON_KINDS[kind], points)
        elif kind == "STOP_SIGN":
            at = _point(feature) * self.origin.signs
            self.road.stop_sign(name, at, _ids(feature, "lane"))
        else:
            self.unknown.add(kind)

    def _outline(self, name: str, feature: Described, *keys: str) -> Floats | None:
        """The points under the first key that is there."""
        for key in keys:
            if feature.get(key) is not None:
                return points_of(feature[key]) * self.origin.signs
        self.without_points.append(name)
        return None

    def _add_lane(self, name: str, feature: Described) -> None:
        points = self._outline(name, feature, "polyline")
        if points is None:
            return
        if name in self.lanes:
            raise ValueError(f"two lanes have the id {name}")
        self.lanes[name] = feature, points

    def _add_line(self, name: str, kind: str, feature: Described) -> None:
        points = self._outline(name, feature, "polyline")
        if points is None:
            return
        # The converters write the outline of the drivable area as white lines of these names.
        if name.startswith("boundary_") and self.origin.dataset in _OUTLINED:
            self.road.edge(name, EDGE_KINDS.index("ROAD_EDGE_BOUNDARY"), points)
            self.outlines += 1
        else:
            self.road.line(name, number_of(LINE_KINDS, kind), points)

    def finished(self, repairs: list[str]) -> RoadMap:
        """The road map of what was added."""
        self._flatten(repairs)
        in_junctions = self._in_junctions(repairs)
        for name, (feature, points) in self.lanes.items():
            self.road.lane(name, xyz=points, **self._lane(name, feature, in_junctions))
        if self.origin.is_simulated:
            self.road.lanes = _continuing(self.road.lanes, repairs)
        self._find_neighbours(repairs)
        self._report(repairs)
        return self.road.built()

    def _flatten(self, repairs: list[str]) -> None:
        """Set the heights of lanes to 0 if they are directions."""
        lines = [points for _, points in self.lanes.values()]
        if not _are_directions(lines, self.origin.dataset in _DIRECTIONS):
            return
        for points in lines:
            points[:, 2] = 0.0
        repairs.append(
            f"The third coordinate of the {len(lines)} lanes is their direction, not their height; "
            "the road is taken as flat."
        )

    def _in_junctions(self, repairs: list[str]) -> set[str]:
        """Ids of the lanes that connect others inside a junction."""
        found = {
            name
            for name, (feature, _) in self.lanes.items()
            if feature.get("interpolating", feature["type"] == INSIDE_JUNCTION)
        }
        if len(found) < len(self.lanes) or len(found) < 2:
            return found
        repairs.append(
            "All lanes are marked as 'interpolating'; only lanes after a split or before a merge "
            "were taken as inside a junction."
        )
        after = {name: _ids(feature, "exit_lanes") for name, (feature, _) in self.lanes.items()}
        before = {name: _ids(feature, "entry_lanes") for name, (feature, _) in self.lanes.items()}
        splits = {other for each in after.values() if len(each) > 1 for other in each}
        merges = {other for each in before.values() if len(each) > 1 for other in each}
        return {name for name in splits | merges if after.get(name) and before.get(name)}

    def _lane(self, name: str, feature: Described, in_junctions: set[str]) -> dict[str, Any]:
        """The attributes of a lane, without its neighbours."""
        return {
            "kind": LANE_KINDS.get(identifier(feature["type"]), "unknown"),
            "interpolating": name in in_junctions,
            "speed_limit_mps": self._limit_mps(feature),
            "next": _ids(feature, "exit_lanes"),
            "previous": _ids(feature, "entry_lanes"),
            **{
                key: tuple(
                    boundary(partial(getitem, one), number_of(LINE_KINDS, one["boundary_type"]))
                    for one in _items(feature.get(key))
                )
                for key in ("left_boundaries", "right_boundaries")
            },
        }

    def _limit_mps(self, feature: Described) -> float | None:
        key = next((key for key in _LIMITS if feature.get(key) is not None), None)
        if key is None:
            return None
        value = float(feature[key])
        if (key, value) == _MADE_UP.get(self.origin.dataset):
            self.made_up += 1
            return None
        limit_mps = value * _LIMITS[key]
        return limit_mps if 0 < limit_mps <= FASTEST_LIMIT_MPS else None

    def _find_neighbours(self, repairs: list[str]) -> None:
        """Neighbours as recorded, or from the geometry if the file has no usable ones."""
        listed = {
            (name, side): _listed(feature, side)
            for name, (feature, _) in self.lanes.items()
            for side in ("left", "right")
        }
        beside = [one for each in listed.values() for one in each]
        is_complete = self.origin.is_waymo or any(isinstance(one, Mapping) for one in beside)
        if self.origin.is_simulated or any(map(_is_name, beside)) or not is_complete:
            found = _neighbours(self.road.lanes)
            if found or beside:
                repairs.append(
                    "The file does not say where lanes are side by side; "
                    f"{len(found)} neighbours were inferred from the geometry."
                )
        else:
            found = [
                (name, side, neighbour(partial(getitem, one)))
                for (name, side), each in listed.items()
                for one in each
            ]
        _set_neighbours(self.road.lanes, found)

    def _report(self, repairs: list[str]) -> None:
        """Say what was left out or replaced."""
        if self.unknown:
            kinds = ", ".join(sorted(self.unknown))
            repairs.append(f"Map features of unknown kinds were dropped: {kinds}.")
        for what, count in sorted(self.beside_road.items()):
            repairs.append(f"Left out: {count} {what}; a scene contains the road alone.")
        if self.without_points:
            repairs.append(
                f"{len(self.without_points)} map features without points were dropped: "
                f"{quoted(self.without_points)}."
            )
        if self.outlines:
            repairs.append(
                f"{self.outlines} outlines of the drivable area, written as white lines, were read "
                "as road edges."
            )
        if self.made_up:
            key, value = _MADE_UP[self.origin.dataset]
            repairs.append(
                f"The limit of {self.made_up} lanes is unknown: the converter writes "
                f"{value:g} {key.rpartition('_')[2]} where it knows none."
            )


def _listed(feature: Described, side: str) -> Sequence[Any]:
    """A lane's neighbours on a side, under the key of either version; () if it has none."""
    return _items(feature.get(f"{side}_neighbor", feature.get(f"{side}_neighbors")))


def _ids(feature: Described, key: str) -> tuple[str, ...]:
    return tuple(map(identifier, _items(feature.get(key))))


def _items(listed: Any) -> Sequence[Any]:
    """A list, which some converters write as None where it is empty."""
    return () if listed is None else listed


def _is_name(one: Any) -> bool:
    return not isinstance(one, Mapping)


def _are_directions(lines: Iterable[Floats], expected: bool) -> bool:
    """Whether the third coordinates are the directions of the lines.

    Those of a flat map whose lanes all lead the same way can be both; ``expected`` decides then.
    """
    off, angles = [np.zeros(0)], [np.zeros(0)]
    for points in lines:
        if len(points) < 2:
            continue
        ahead = np.gradient(points[:, :2], axis=0)
        moves = np.hypot(ahead[:, 0], ahead[:, 1]) > 1e-3
        angle = np.arctan2(ahead[moves, 1], ahead[moves, 0])
        off.append(np.abs(frames.difference(points[moves, 2], angle)))
        angles.append(angle)
    differences, directions = np.concatenate(off), np.concatenate(angles)
    if not len(differences) or (differences < DIRECTION_OFF_RAD).mean() < DIRECTION_SHARE:
        return False
    if not any(points[:, 2].any() for points in lines):
        return False
    return expected or bool(np.abs(np.exp(1j * directions).mean()) < ONE_WAY)


def _continuing(lanes: dict[str, Lane], repairs: list[str]) -> dict[str, Lane]:
    """The lanes with links to those lanes alone that start where they end."""
    lost = 0

    def near(before: str, after: str) -> bool:
        if before not in lanes or after not in lanes:
            return True  # the checks of all readers drop it
        one, other = lanes[before].centre_m, lanes[after].centre_m
        return not len(one) or not len(other) or np.hypot(*(other[0] - one[-1])) <= CONTINUES_M

    kept = {}
    for name, lane in lanes.items():
        after = tuple(other for other in lane.next if near(name, other))
        before = tuple(other for other in lane.previous if near(other, name))
        lost += len(lane.next) + len(lane.previous) - len(after) - len(before)
        kept[name] = replace(lane, next=after, previous=before)
    if lost:
        repairs.append(
            f"{lost} links to lanes that start beside a lane's end were dropped: MetaDrive links "
            "all lanes of a road to all of the next one."
        )
    return kept


def _neighbours(lanes: Mapping[str, Lane]) -> list[tuple[str, str, Neighbour]]:
    """(lane, side, neighbour) from the geometry, of lanes outside junctions.

    Points are up to 10 m apart in some data sets.
    """
    even, index = [], {}
    for name, lane in lanes.items():
        if len(lane.centre_m) > 1 and not lane.interpolating and is_placed(lane):
            thinned, index[name] = _evenly(lane)
            even.append(thinned)
    beside = lane_links.neighbours(even)
    return [
        (name, side, _at_points(one, index[name], index[one.lane_id]))
        for side, listed in (("left", beside.left), ("right", beside.right))
        for name, each in listed.items()
        for one in each
    ]


def _evenly(lane: Lane) -> tuple[Lane, Ints]:
    """The lane with points about `SPACING_M` apart, and the nearest point of the lane for each."""
    step = np.hypot(*np.diff(lane.centre_m, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0.0, along[-1], max(int(along[-1] / SPACING_M), 1) + 1)
    x, y, z = (np.interp(at, along, each) for each in (*lane.centre_m.T, lane.z_m))
    index: Ints = np.searchsorted((along[1:] + along[:-1]) / 2, at)
    return replace(lane, centre_m=np.column_stack([x, y]), z_m=z), index


def _at_points(one: Neighbour, own: Ints, other: Ints) -> Neighbour:
    return Neighbour(
        lane_id=one.lane_id,
        self_start=int(own[one.self_start]),
        self_end=int(own[one.self_end]),
        other_start=int(other[one.other_start]),
        other_end=int(other[one.other_end]),
    )


def _set_neighbours(lanes: dict[str, Lane], found: Iterable[tuple[str, str, Neighbour]]) -> None:
    """Give lanes their neighbours, in place."""
    beside: dict[str, dict[str, list[Neighbour]]] = {}
    for name, side, one in found:
        beside.setdefault(name, {"left": [], "right": []})[side].append(one)
    for name, sides in beside.items():
        lanes[name] = replace(lanes[name], left=tuple(sides["left"]), right=tuple(sides["right"]))


def number_of(kinds: tuple[str, ...], kind: Any) -> int:
    """WOMD's number of a kind; 0 (unknown) for a road edge beside a lane, as in WOMD."""
    return kinds.index(kind) if kind in kinds else 0


def _point(feature: Described) -> Floats:
    """(3) position; a missing third coordinate is 0."""
    position = np.asarray(feature["position"], float).reshape(-1)
    if len(position) < 2:
        raise ValueError(f"a stop sign has {len(position)} coordinates")
    return np.append(position, 0.0)[:3]


def points_of(values: Any) -> Floats:
    """(P, 3), a copy; a missing third coordinate is 0."""
    points = np.array(values, float)
    if not points.size:
        return np.zeros((0, 3))
    points = points.reshape(len(points), -1)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    if points.shape[1] != 3:
        raise ValueError(f"points have {points.shape[1]} coordinates")
    return points.reshape(-1, 3)
