"""Vehicles that bend: trains, trams, articulated buses and trucks, as boxes along their track.

SUMO lets a vehicle lie along the lanes behind its front, and draws it in carriages; the rear of a
stiff box behind the front of a tram of 42 m is 6 m beside the track in a bend. So such a vehicle is
a row of boxes here, each from one point of the track to another, without gaps. How many there are
follows from the type as in SUMO's drawing: ``carriageLength``, ``locomotiveLength`` and
``carriageGap``, as attributes or parameters of the type, else SUMO's values for its shape.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.scene import AgentId, Floats, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.polylines import Measured
from deepmf_sumo.sumo.simulation import on_lane
from deepmf_sumo.sumo.simulation.files_read import with_named
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

State = tuple[float, float, float, float, float]
"""In SUMO's terms: front bumper x, y (m), angle (degrees), speed (m/s), z (m)."""
Lengths = tuple[float, ...]
"""Of the boxes of a vehicle, from its front; () for a vehicle that does not bend."""


class _Carriages(NamedTuple):
    """Lengths in m as a type has them; 0 for a first carriage like the others."""

    carriage: float
    first: float = 0.0
    gap: float = 1.0


_BY_SHAPE: Final[Mapping[str, _Carriages]] = {
    "bus/flexible": _Carriages(8.25, gap=0.0),
    "truck/semitrailer": _Carriages(13.5, 2.5, 0.5),
    "truck/trailer": _Carriages(6.75, 9.25, 0.5),
    "rail": _Carriages(24.5, 16.4),
    "rail/railcar": _Carriages(16.85),
    "rail/cargo": _Carriages(13.86),
}
_BY_SHAPE_AND_CLASS: Final[Mapping[tuple[str, str], _Carriages]] = {
    ("rail", "rail_electric"): _Carriages(24.5, 19.1),
    ("rail", "rail_fast"): _Carriages(24.775, 25.835),
    ("rail/railcar", "tram"): _Carriages(5.71),
    ("rail/railcar", "rail_urban"): _Carriages(18.4),
}
"""What SUMO 1.28 draws where a type says nothing."""
_SHORTEST_M: Final = 10.0
"""Vehicles up to this length are stiff."""
_NAMES: Final = ("carriageLength", "locomotiveLength", "carriageGap")
_TYPE: Final = re.compile(rb"<vType\b[^<>]*\bcarriageLength\s*=[^<>]*>")
_CHUNK: Final = 1 << 20
_OVERLAP: Final = 1 << 12
_LARGEST: Final = 1 << 32
_ON_TRACK_M: Final = 1.0
"""A front farther from where its lane says is off the track: parked, or put somewhere."""


def divided(length_m: float, type_has: _Carriages) -> Lengths:
    """Lengths of the boxes of a vehicle, without gaps, in SUMO's number; () for a single one."""
    first = type_has.first or type_has.carriage
    count = 1 + int((length_m - first) / (type_has.carriage + type_has.gap) + 0.5)
    if count < 2:
        return ()
    if first == type_has.carriage:
        return (length_m / count,) * count
    return (first, *((length_m - first) / (count - 1),) * (count - 1))


class _Piece(NamedTuple):
    """A lane on the way that a vehicle has come, and SUMO's length of it."""

    lane: str
    length_m: float
    against: bool = False


class LongVehicles:
    """The boxes of the vehicles that bend in a running SUMO.

    Attributes:
        lane: of each box behind the first, where it was seen last; empty off the lanes.
    """

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._lengths: dict[AgentId, Lengths] = {}
        self._declared: dict[str, _Carriages] | None = None
        self._before: dict[tuple[str, str], tuple[str, ...]] = {}
        self._shapes: dict[tuple[str, bool], tuple[Measured, Floats, float]] = {}
        self.lane: dict[AgentId, str] = {}
        self._ends: dict[AgentId, tuple[Floats, Floats]] = {}
        self._reversed: set[AgentId] = set()

    def lengths_m(self, name: AgentId) -> Lengths:
        """Of the boxes of a vehicle that is present."""
        if name not in self._lengths:
            length = float(self._api.vehicle.getLength(name))
            found = self._carriages(name) if length > _SHORTEST_M else None
            stiff = found is None or found.carriage <= 0
            self._lengths[name] = () if stiff or found is None else divided(length, found)
        return self._lengths[name]

    def boxes(self, name: AgentId, state: State) -> dict[AgentId, State]:
        """The states of all boxes of a vehicle that bends, by agent; the first has its front.

        A train that reverses has its front at its other end from one step to the next. Its boxes
        stay where they are: then the last one has its front.
        """
        lengths = self.lengths_m(name)
        numbers = list(range(1, len(lengths) + 1))
        if self._reverses(name, state):
            self._reversed ^= {name}
        if name in self._reversed:
            lengths, numbers = lengths[::-1], numbers[::-1]
        places = self._places(name, state, np.concatenate([[0.0], np.cumsum(lengths)]))
        self._ends[name] = places[0][0][:2], places[-1][0][:2]
        found = {}
        for number, ((front, lane), (back, _)) in zip(numbers, pairwise(places), strict=True):
            along = front[:2] - back[:2]
            angle = float(frames.sumo_angle(np.arctan2(along[1], along[0])))
            agent = name if number == 1 else agent_ids.of_part(name, number)
            found[agent] = (float(front[0]), float(front[1]), angle, state[3], float(front[2]))
            self.lane[agent] = lane
        return {agent: found[agent] for _, agent in sorted(zip(numbers, found, strict=True))}

    def _reverses(self, name: AgentId, state: State) -> bool:
        """Whether the front is where the rear was when the vehicle was last seen."""
        if name not in self._ends:
            return False
        front, rear = self._ends[name]
        ahead = frames.unit(np.radians(90.0 - state[2]))
        return bool(
            ahead @ (front - rear) < 0
            and np.hypot(*(state[:2] - rear)) < min(_ON_TRACK_M, np.hypot(*(state[:2] - front)))
        )

    def _places(self, name: AgentId, state: State, behind_m: Floats) -> list[tuple[Floats, str]]:
        """Points (3) at distances behind the front, along the track, and their lanes."""
        vehicle, front = self._api.vehicle, np.array([state[0], state[1], state[4]])
        lane = str(vehicle.getLaneID(name))
        if lane:
            at = float(vehicle.getLanePosition(name))
            own = _Piece(lane, self._length_m(lane), self._against(name, lane, at, state[2]))
            at = own.length_m - at if own.against else at
            line_m, heading = self._foot(own, at)
            left = on_lane.left_m(self._api, name, line_m[:2], heading)
            if np.hypot(*(_beside(line_m, heading, left) - front)[:2]) <= _ON_TRACK_M:
                way = self._way_back(name, own, float(behind_m[-1]) - at)
                places = [self._along(way, at - one, left) for one in behind_m.tolist()]
                return [(front, lane), *places[1:]]
        ahead = np.append(frames.unit(np.radians(90.0 - state[2])), 0.0)
        return [(front - one * ahead, lane) for one in behind_m.tolist()]

    def _along(self, way: list[_Piece], at_m: float, left_m: float) -> tuple[Floats, str]:
        """The point at a position on the first lane of a way; below 0 on those before it."""
        for number, piece in enumerate(way):
            if number:
                at_m += piece.length_m
            if at_m >= 0.0:
                break
        return _beside(*self._foot(piece, at_m), left_m), piece.lane

    def _way_back(self, name: AgentId, own: _Piece, missing_m: float) -> list[_Piece]:
        """The lane, and those before it, as far as the vehicle reaches or its route is known.

        On the opposite lane, to overtake, it has come from before its own edge.
        """
        way = [own]
        if missing_m <= 0:
            return way
        vehicle = self._api.vehicle
        route, at = vehicle.getRoute(name), int(vehicle.getRouteIndex(name))
        edges, lane = [*route[: max(at, 0)]], own.lane
        if lane.startswith(":") and at >= 0:
            edges.append(route[at])
        elif own.against and at >= 0:
            lane = f"{route[at]}_0"
        for edge in reversed(edges):
            for before in self._lanes_before(str(edge), lane):
                lane = before
                way.append(_Piece(lane, self._length_m(lane)))
                missing_m -= way[-1].length_m
            if missing_m <= 0 or _edge(lane) != edge:
                break
        return way

    def _lanes_before(self, edge: str, lane: str) -> tuple[str, ...]:
        """The lanes that lead from an edge to a lane, the nearest first; () without a way."""
        key = edge, lane
        if key not in self._before:
            self._before[key] = self._search(edge, lane)
        return self._before[key]

    def _search(self, edge: str, lane: str) -> tuple[str, ...]:
        beside = [lane]
        if not lane.startswith(":"):  # after a change of lanes: those that its edge has, too
            own = _edge(lane)
            count = int(self._api.edge.getLaneNumber(own))
            beside += [one for one in (f"{own}_{number}" for number in range(count)) if one != lane]
        for wanted in beside:
            for number in range(int(self._api.edge.getLaneNumber(edge))):
                start = f"{edge}_{number}"
                for link in self._api.lane.getLinks(start):
                    chain, following = [start], str(link[4] or link[0])
                    # walking areas lead to each other: a chain that returns to itself ends
                    while following.startswith(":") and following not in {wanted, *chain}:
                        chain.append(following)
                        onward = self._api.lane.getLinks(following)
                        following = str(onward[0][4] or onward[0][0]) if onward else ""
                    if following == wanted:
                        return tuple(reversed(chain))
        return ()

    def _against(self, name: AgentId, lane: str, at_m: float, angle_deg: float) -> bool:
        """Whether a vehicle drives against its lane at SUMO's position there."""
        _, heading = self._foot(_Piece(lane, self._length_m(lane)), at_m)
        return on_lane.against(self._api, name, lane, heading, angle_deg)

    def _foot(self, piece: _Piece, at_m: float) -> tuple[Floats, float]:
        """(3) the point of a lane at SUMO's position, which may lie before it, and its heading."""
        line, z_m, length_m = self._shape(piece.lane, against=piece.against)
        along = at_m * line.along_m[-1] / max(length_m, 1e-6)
        point, heading = line.at(np.array(along))
        return np.array([*point, np.interp(along, line.along_m, z_m)]), float(heading)

    def _length_m(self, lane: str) -> float:
        return self._shape(lane)[2]

    def _shape(self, lane: str, *, against: bool = False) -> tuple[Measured, Floats, float]:
        """Line and heights of a lane, as one drives along or against it, and SUMO's length."""
        key = lane, against
        if key not in self._shapes:
            points = np.array(self._api.lane.getShape(lane), float)[:: -1 if against else 1]
            apart = np.concatenate([[True], np.hypot(*np.diff(points[:, :2], axis=0).T) > 1e-6])
            points = points[apart] if apart.sum() > 1 else points[:1] + np.array([[0.0], [1e-3]])
            z_m = points[:, 2] if points.shape[1] > 2 else np.zeros(len(points))
            length = float(self._api.lane.getLength(lane))
            self._shapes[key] = Measured(points[:, :2]), z_m, length
        return self._shapes[key]

    def _carriages(self, name: AgentId) -> _Carriages | None:
        """What its type says, else SUMO's values for its shape; None for a stiff vehicle."""
        vehicle = self._api.vehicle
        kind = str(vehicle.getTypeID(name))
        shape, permission = str(vehicle.getShapeClass(name)), str(vehicle.getVehicleClass(name))
        usual = _BY_SHAPE_AND_CLASS.get((shape, permission)) or _BY_SHAPE.get(shape)
        said = self._api.vehicletype.getParameter(kind, _NAMES[0])
        if said:
            texts = (self._api.vehicletype.getParameter(kind, one) for one in _NAMES)
            return _stated(dict(zip(_NAMES, map(str, texts), strict=True)), usual)
        if self._declared is None:
            self._declared = dict(self._from_files())
        return self._declared.get(kind.partition("@")[0], usual)

    def _from_files(self) -> Iterator[tuple[str, _Carriages]]:
        """Types with the attribute, which SUMO tells no client: of the files that it was given."""
        options = ("route-files", "additional-files")
        told = ",".join(str(self._api.simulation.getOption(one)) for one in options).split(",")
        paths = [path for name in told if name.strip() and (path := Path(name.strip())).is_file()]
        for path in with_named(paths):
            for tag in _types(path):
                usual = _BY_SHAPE.get(tag.get("guiShape", ""))
                yield tag.get("id", ""), _stated(tag.attrib, usual)


def _beside(point_m: Floats, heading_rad: float, left_m: float) -> Floats:
    """(3) a point to the left of one of a line."""
    x, y = point_m[:2] + left_m * np.array([-np.sin(heading_rad), np.cos(heading_rad)])
    return np.array([x, y, point_m[2]])


def _stated(values: Mapping[str, str], usual: _Carriages | None) -> _Carriages:
    """Carriages of a type that says how long they are; what it leaves out is as SUMO has it."""
    usual = usual or _Carriages(0.0)
    try:
        carriage, first, gap = (float(values.get(name) or 0.0) for name in _NAMES)
    except ValueError:
        return usual
    return _Carriages(carriage, first, gap if values.get(_NAMES[2]) else usual.gap)


def _types(path: Path) -> Iterator[ET.Element]:
    """``<vType>`` elements with lengths of carriages, without the rest of a file of any size."""
    with files.unpacked(path, _LARGEST) as stream:
        held = b""
        while chunk := stream.read(_CHUNK):
            held += chunk
            for found in _TYPE.finditer(held):
                tag = found[0].rstrip(b"/>") + b"/>"
                try:
                    yield ET.fromstring(tag)  # noqa: S314 (the user's own)
                except ET.ParseError:
                    continue
            held = held[-_OVERLAP:]


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]
