"""A network as rules look at it: movements with their lines, foes and signals."""

import itertools
import math
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
import shapely

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.results.risk.places import Places, read
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network.sumo_net import (
    ROAD_VEHICLES,
    TURNS,
    NetEdge,
    NetFile,
    NetLane,
    NetLink,
    edge_of,
    elements,
    number,
    read_once,
)
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

_CARS: Final = ("passenger", "private", "taxi")
_MOTORS: Final = sorted({*ROAD_VEHICLES} - {"emergency", "authority", "army"})
"""Who meets whom is judged for all of them, e.g. on ways for deliveries; ends of lanes for cars."""
_NEAR_M: Final = 2.5
"""Lines of foes that come no nearer than this have no common place."""
_LARGEST: Final = 2**32
_FASTEST_MPS: Final = 1000.0
_FARTHEST_M: Final = 1e9
"""Beyond these a number is a mistake, and squares of it may not be numbers any more."""
_HEADING_M: Final = 10.0
"""Length of a lane's end that its direction is taken from."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A phase of a light: seconds, least and most where it is actuated, and SUMO's letters."""

    duration_s: float
    least_s: float
    most_s: float
    state: str

    @property
    def fixed(self) -> bool:
        """Whether it always takes the same time."""
        return self.least_s == self.most_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """A program of a light; ``in_turn``: its phases follow each other as they are listed."""

    light: str
    name: str
    kind: str
    phases: tuple[Phase, ...]
    in_turn: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """A connection over a junction that motor vehicles may use.

    Attributes:
        turn: straight, left, right, turnaround, or empty.
        lane, target: before and behind the junction.
        line: from the stop line to the lane behind the junction. row: of its request; None
            where the network has none.
    """

    link: NetLink
    junction: str
    turn: str
    lane: NetLane
    target: NetLane
    line: shapely.LineString
    row: int | None
    inner: tuple[NetLane, ...]

    @property
    def edges(self) -> tuple[str, str]:
        """Before and behind the junction."""
        return self.lane.edge, self.target.edge

    @property
    def said(self) -> str:
        """As part of a sentence."""
        return f"{self.lane.edge} -> {self.target.edge}"

    @property
    def bend_rad(self) -> float:
        """How far its direction changes over the junction, by the last 10 m of both lanes."""
        return _bend(self.lane.shape_m[:, :2], self.target.shape_m[:, :2])

    @property
    def inner_m(self) -> float:
        """Length inside the junction."""
        return float(self.line.length)


def _heading(shape_m: Floats) -> float:
    """Of the first metres of a line (P, 2), in radians."""
    line = shapely.LineString(shape_m)
    reach = min(_HEADING_M, line.length)
    ends = shapely.get_coordinates(shapely.line_interpolate_point(line, [0.0, reach]))
    x, y = ends[1] - ends[0]
    return math.atan2(y, x)


def _bend(before: Floats, behind: Floats) -> float:
    """Angle from the end of a line (P, 2) to the begin of another, 0 to pi."""
    return abs(float(frames.difference(_heading(behind), _heading(before[::-1]) + math.pi)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalledNetwork:
    """A network with the programs of its lights, those of additional files too."""

    file: Path
    places: Places
    programs: tuple[Program, ...]

    @property
    def net(self) -> NetFile:
        """As read."""
        return self.places.net

    @cached_property
    def ways(self) -> dict[str, list[Way]]:
        """Connections for motor vehicles, by junction, in the network's order."""
        inside = {link.origin: link for link in self.net.links if link.starts_inside}
        found: dict[str, list[Way]] = defaultdict(list)
        for link in self.net.links:
            if not link.starts_inside and not link.target.startswith(":"):
                way = self._way(link, inside)
                if for_motors(way.lane) and for_motors(way.target):
                    found[way.junction].append(way)
        return found

    def _way(self, link: NetLink, inside: dict[str, NetLink]) -> Way:
        lanes, via = self.places.lanes, link.via
        chain: list[NetLane] = []
        while via and via in lanes and lanes[via] not in chain:
            chain.append(lanes[via])
            via = inside[via].via if via in inside else ""
        start, end = lanes[link.origin], lanes[link.target]
        parts = [start.shape_m[-1:], *(one.shape_m for one in chain), end.shape_m[:1]]
        names = (*(one.id for one in chain), link)
        row = next((self._rows[one] for one in names if one in self._rows), None)
        return Way(
            link=link, junction=self.net.edges[start.edge].end, lane=start, target=end, row=row,
            turn=TURNS.get(link.direction, ""), inner=tuple(chain),
            line=shapely.LineString(np.concatenate(parts)[:, :2]),
        )  # fmt: skip

    @cached_property
    def _rows(self) -> dict[str | NetLink, int]:
        """The row of each lane inside a junction, or of each link where there are no such lanes."""
        after: dict[str, list[NetLink]] = defaultdict(list)
        for link in self.net.links:
            after[link.origin].append(link)
        found: dict[str | NetLink, int] = {}
        for one in self.net.junctions:
            links = [link for lane in one.incoming for link in after[lane]]
            if one.inner_lanes:
                found |= {lane: row for row, lane in enumerate(one.inner_lanes)}
            elif len(links) == len(one.goes_first):
                found |= {link: row for row, link in enumerate(links)}
        return found

    @cached_property
    def into(self) -> dict[str, list[Way]]:
        """Connections that lead to each lane."""
        found: dict[str, list[Way]] = defaultdict(list)
        for way in itertools.chain.from_iterable(self.ways.values()):
            found[way.target.id].append(way)
        return found

    @cached_property
    def out_of(self) -> dict[str, list[Way]]:
        """Connections that lead on from each edge."""
        found: dict[str, list[Way]] = defaultdict(list)
        for way in itertools.chain.from_iterable(self.ways.values()):
            found[way.lane.edge].append(way)
        return found

    @cached_property
    def starting(self) -> dict[str, list[NetEdge]]:
        """Normal edges that begin at each junction."""
        found: dict[str, list[NetEdge]] = defaultdict(list)
        for edge in self.net.edges.values():
            if not edge.function:
                found[edge.start].append(edge)
        return found

    def angle_rad(self, edge: str, other: str) -> float:
        """By how much the direction at the end of an edge differs from the begin of another."""
        ends = (self.net.edges[one].lanes[0].shape_m[:, :2] for one in (edge, other))
        return _bend(*ends)

    def pairs(self, junction: str) -> Iterator[tuple[Way, Way]]:
        """Ways that meet and come from two edges, each pair once."""
        for one, two in itertools.combinations(self.ways.get(junction, ()), 2):
            if one.lane.edge != two.lane.edge and self._meet(one, two):
                yield one, two

    def _meet(self, one: Way, two: Way) -> bool:
        foes = self.places.junctions[one.junction].foes
        known = [way.row is not None and way.row < len(foes) for way in (one, two)]
        if all(known):
            return two.row in foes[one.row or 0] or one.row in foes[two.row or 0]
        return one.target.id == two.target.id or one.line.intersects(two.line)

    def waits(self, one: Way, two: Way) -> bool:
        """Whether the first gives way to the second, by the network's request."""
        first = self.places.junctions[one.junction].goes_first
        return one.row is not None and one.row < len(first) and two.row in first[one.row]

    def opposite(self, edge: str, other: str) -> bool:
        """Whether an edge leads back to where the other one comes from."""
        mine, its = self.net.edges[edge], self.net.edges[other]
        return (mine.start, mine.end) == (its.end, its.start)


def for_cars(lane: NetLane) -> bool:
    """Whether cars may use it."""
    return any(lane.allows(kind) for kind in _CARS)


def for_motors(lane: NetLane) -> bool:
    """Whether vehicles with a motor may use it, without emergency vehicles, trams and trains."""
    return lane.road and any(lane.allows(kind) for kind in _MOTORS)


def common_place(one: Way, two: Way) -> tuple[float, float] | None:
    """Metres from the stop lines to where two ways meet; None where they do not.

    Of several places the last one of the first way, which clears, with the first one of the other.
    """
    met = shapely.intersection(one.line, two.line)
    if met.is_empty:
        near = shapely.shortest_line(one.line, two.line)
        if near.length > _NEAR_M:
            return None
        at, its = ([shapely.Point(end)] for end in shapely.get_coordinates(near))
    else:
        at = its = [shapely.Point(end) for end in shapely.get_coordinates(met)]
    return (
        max(float(one.line.project(point)) for point in at),
        min(float(two.line.project(point)) for point in its),
    )


def opened(file: Path) -> SignalledNetwork:
    """The network of a .net.xml, .net.xml.gz or .sumocfg.

    Raises UsageError where it is none of them, is damaged, or has no junctions.
    """
    try:
        net_file, additional = _named(file)
        net = read_once(net_file)
        _check(net_file, net)
        programs = _programs(net_file, "net")
        for one in additional:
            programs += _programs(one, "additional")
        return SignalledNetwork(file=net_file, places=read(net_file), programs=tuple(programs))
    except SimulationError as error:
        raise UsageError(str(error)) from None


def _named(file: Path) -> tuple[Path, tuple[Path, ...]]:
    """The network, and additional files of a configuration."""
    top = _root(file)
    if top == "net":
        return file, ()
    if file.suffix in {".sumocfg", ".cfg"} or "configuration" in top.lower():
        found = read_configuration(file, simulated=False)
        return found.net, found.additional
    raise UsageError(
        f"{file} contains <{top}>: it is neither a network of SUMO nor a .sumocfg; give"
        " one of them."
    )


def _root(file: Path) -> str:
    try:
        with files.unpacked(file, _LARGEST) as stream:
            _, top = next(ET.iterparse(stream, events=("start",)))  # noqa: S314 (the user's own)
            return str(top.tag)
    except OSError as error:
        why = files.reason(error)
    except (ET.ParseError, StopIteration, ValueError, LookupError) as error:
        why = str(error)
    raise UsageError(f"{file} cannot be read as XML: {why}; give a .net.xml or a .sumocfg.")


def _check(file: Path, net: NetFile) -> None:
    """Raise UsageError for a network that refers to what it does not have."""
    if not net.junctions:
        raise UsageError(f"{file} has no <junction>: there is nothing to screen.")
    known = {lane.id: lane for edge in net.edges.values() for lane in edge.lanes}
    junctions = {one.id for one in net.junctions}
    for edge in net.edges.values():
        if not edge.lanes:
            raise UsageError(f"{file}: the edge '{edge.id}' has no <lane>; build it again.")
        if not edge.function and not {edge.start, edge.end} <= junctions:
            raise UsageError(
                f"{file}: the edge '{edge.id}' is from '{edge.start}' to '{edge.end}', which are"
                " not both junctions of the network; build it again."
            )
    for lane in known.values():
        if len(lane.shape_m) < 2:
            raise UsageError(f"{file}: the lane '{lane.id}' has no shape; build it again.")
        if edge_of(lane.id) != lane.edge:
            raise UsageError(
                f"{file}: the lane '{lane.id}' is in the edge '{lane.edge}', whose name it does not"
                " begin with; build it again."
            )
        if not 0 <= lane.speed_mps <= _FASTEST_MPS or np.abs(lane.shape_m).max() > _FARTHEST_M:
            raise UsageError(
                f"{file}: the lane '{lane.id}' has a speed of {lane.speed_mps:g} m/s or a shape"
                f" beyond {_FARTHEST_M:g} m; build it again."
            )
    for link in net.links:
        for name in filter(None, (link.origin, link.target, link.via)):
            if name not in known:
                raise UsageError(
                    f"{file}: a <connection> names the lane '{name}', which the network does not"
                    " have; build it again."
                )


def _programs(file: Path, kind: Literal["net", "additional"]) -> list[Program]:
    try:
        return [_program(one) for one in elements(file, kind) if one.tag == "tlLogic"]
    except ValueError as error:
        raise UsageError(f"{file} has a wrong <tlLogic>: {error}.") from None


def _program(element: ET.Element) -> Program:
    phases: Sequence[ET.Element] = list(element.iter("phase"))
    return Program(
        light=element.get("id", ""),
        name=element.get("programID", ""),
        kind=element.get("type", "static"),
        phases=tuple(_phase(one, element.get("type", "static")) for one in phases),
        in_turn=not any(one.get("next") for one in phases),
    )


def _phase(element: ET.Element, kind: str) -> Phase:
    """SUMO takes ``minDur`` and ``maxDur`` only where a program is not static."""
    seconds = number(element, "duration", math.nan)
    least, most = seconds, seconds
    if kind != "static":
        least = number(element, "minDur", seconds)
        most = number(element, "maxDur", max(seconds, least))
    return Phase(duration_s=seconds, least_s=least, most_s=most, state=element.get("state", ""))
