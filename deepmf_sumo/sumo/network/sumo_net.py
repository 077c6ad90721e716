"""SUMO network files: edges, lanes, connections, right of way, and movements that conflict."""

import itertools
import math
import xml.etree.ElementTree as ET
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import Floats

_LARGEST: Final = 2**32
"""Limit of an unpacked network in bytes; that of a country has a few GB."""

OWN_CLASSES: Final = ("custom1", "custom2")
"""Classes whose meaning is a network's own: e.g. lanes for automated vehicles, or parked cars."""
ROAD_VEHICLES: Final = (
    "passenger", "bus", "taxi", "delivery", "truck", "motorcycle", "emergency", "private",
    "authority", "army", "vip", "hov", "evehicle", "coach", "trailer", "moped", *OWN_CLASSES,
)  # fmt: skip
RAIL_VEHICLES: Final = ("tram", "rail", "rail_urban", "rail_electric", "rail_fast", "subway")
"""SUMO's classes of vehicles whose lanes are roads and tracks; bicycles are neither."""
OTHER_VEHICLES: Final = ("cable_car", "ship", "container", "aircraft", "drone")
"""Those whose lanes are neither."""
_NARROWEST_M: Final = 2.5
"""Narrower lanes of `OWN_CLASSES` alone are strips for parked vehicles."""
TURNS: Final = {
    "s": "straight",
    **dict.fromkeys("lL", "left"),
    **dict.fromkeys("rR", "right"),
    **dict.fromkeys("tT", "turnaround"),
}
"""By the direction of a connection; ``T``: where traffic drives on the left."""
ON_FOOT: Final = {"crossing", "walkingarea"}
"""Functions of edges for pedestrians alone."""

Way = tuple[str, str]
"""The edge before a junction and the one behind it."""


def edge_of(lane: str) -> str:
    """The edge of a SUMO lane."""
    return lane.rpartition("_")[0]


def junction_of(edge: str) -> str:
    """The junction of an edge inside it, as netconvert names it: ``:J_2``, ``:J_c0``, ``:J_w0``.

    Empty for other edges.
    """
    return edge[1:].rpartition("_")[0] if edge.startswith(":") else ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetLane:
    """A ``<lane>``: ``shape_m`` (P, 3), z = 0 where the net is flat."""

    id: str
    edge: str
    index: int
    speed_mps: float
    length_m: float
    width_m: float
    allow: frozenset[str] | None
    disallow: frozenset[str]
    shape_m: Floats

    def allows(self, vehicle_class: str) -> bool:
        """Whether vehicles of a SUMO class may use the lane."""
        if self.allow is not None:
            return vehicle_class in self.allow or "all" in self.allow
        return not self.disallow & {vehicle_class, "all"}

    @property
    def road(self) -> bool:
        """Whether road vehicles drive on the lane."""
        own = self.width_m < _NARROWEST_M
        return any(self.allows(one) for one in ROAD_VEHICLES if not (own and one in OWN_CLASSES))

    def area(self) -> BaseGeometry:
        """The lane with its width, along a line of at least two points."""
        line = shapely.LineString(self.shape_m[:, :2])
        return shapely.buffer(line, self.width_m / 2, cap_style="flat", join_style="mitre")


@dataclass(frozen=True, slots=True, kw_only=True)
class NetEdge:
    """An ``<edge>``; ``function`` is empty for normal ones.

    Attributes:
        name: of the street, or empty.
        bidi: the edge that shares its lane on purpose, or empty.
    """

    id: str
    start: str
    end: str
    function: str
    type: str
    lanes: tuple[NetLane, ...]
    name: str = ""
    bidi: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetLink:
    """A ``<connection>`` between two lanes.

    Attributes:
        via: the lane inside the junction, or empty.
        light: the traffic light's id, or empty. index: of the link in it; -1 if it shows the link
            nothing, as at the rails of a crossing.
        state, direction: SUMO's letters, e.g. ``M`` has right of way, ``s`` straight on.
    """

    origin: str
    target: str
    via: str
    light: str
    index: int
    state: str
    direction: str

    @property
    def onto(self) -> str:
        """The lane that comes next.

        At a light of a network without lanes inside its junctions a name for the straight way over
        the junction: links of several lights, or states, lead to one lane behind it.
        """
        if self.via or not self.light or self.starts_inside:
            return self.via or self.target
        return f":{self.origin}>{self.target}"

    @property
    def starts_inside(self) -> bool:
        """Whether it continues another link, from a lane inside a junction."""
        return self.origin.startswith(":")

    @property
    def edges(self) -> "Way":
        """The edges of its two lanes."""
        return edge_of(self.origin), edge_of(self.target)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetJunction:
    """A ``<junction>`` with its outline (P, 3), z = 0 where the net is flat.

    Attributes:
        inner_lanes: lanes inside, one per connection over the junction: the last one of those that
            wait in the middle.
        goes_first: for each of these connections, the rows of those that it gives way to.
        foes: for each of them, the rows of those that it meets, in both directions.
        incoming: lanes that lead to it, in the order of the connections' rows.
        name: its street name, or empty.
    """

    id: str
    type: str
    shape_m: Floats
    inner_lanes: tuple[str, ...] = ()
    goes_first: tuple[frozenset[int], ...] = ()
    foes: tuple[frozenset[int], ...] = ()
    incoming: tuple[str, ...] = ()
    name: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetLocation:
    """A ``<location>``: where on earth a network is.

    Attributes:
        offset_m: (2,) that netconvert added to the projection's coordinates.
        projection: as PROJ writes it; ``!`` where there is none, ``-`` for one of SUMO's own.
    """

    offset_m: tuple[float, float] = (0.0, 0.0)
    projection: str = "!"

    @property
    def geographic(self) -> bool:
        """Whether PROJ places it on earth: not with what SUMO computes itself, or chooses."""
        return self.projection not in {"!", "-", ".", "..", "..."}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetFile:
    """Everything read, in the file's order.

    Attributes:
        left_hand: traffic keeps left, and lane 0 is the leftmost.
    """

    edges: dict[str, NetEdge]
    links: tuple[NetLink, ...]
    junctions: tuple[NetJunction, ...]
    left_hand: bool = False
    location: NetLocation = NetLocation()


def read_net(file: Path) -> NetFile:
    """Read a .net.xml or .net.xml.gz.

    Raises SimulationError if the file cannot be read or is not a SUMO network.
    """
    edges: dict[str, NetEdge] = {}
    links: list[NetLink] = []
    junctions: list[NetJunction] = []
    location = NetLocation()
    for element in elements(file, "net"):
        try:
            if element.tag == "edge":
                edge = _edge(element)
                edges[edge.id] = edge
            elif element.tag == "connection":
                links.append(_link(element))
            elif element.tag == "junction" and element.get("type") != "internal":
                junctions.append(_junction(element))
            elif element.tag == "location":
                location = _location(element)
        except ValueError as error:
            raise SimulationError(f"{file} is not a network of SUMO: {error}.") from None
    return NetFile(
        edges=edges,
        links=tuple(links),
        junctions=tuple(junctions),
        left_hand=_keeps_left(file),
        location=location,
    )


def _keeps_left(file: Path) -> bool:
    """Whether the first element of a file says so."""
    with _opened(file) as stream:
        _, top = next(ET.iterparse(stream, events=("start",)))  # noqa: S314 (the user's own)
        return truth(top.get("lefthand", ""))


@files.while_unchanged(4)
def read_once(file: Path) -> NetFile:
    """As ``read_net``; the last nets read are kept as long as their files stay as they are."""
    return read_net(file)


def elements(file: Path, kind: str) -> Iterator[ET.Element]:
    """Children of an XML file's root, one at a time.

    The root of a network is ``<net>``; SUMO accepts any root in additional files.

    Raises SimulationError if the file cannot be read, or is not a network but should be one.
    """
    try:
        with _opened(file) as stream:
            parser = ET.iterparse(stream, events=("start", "end"))  # noqa: S314 (the user's own)
            _, top = next(parser)
            if kind == "net" and top.tag != kind:
                raise SimulationError(
                    f"{file} contains <{top.tag}>, not <net>: it is not a network."
                )
            depth = 0
            for event, element in parser:
                depth += 1 if event == "start" else -1
                if event == "end" and depth == 0:
                    yield element
                    top.clear()
    except (OSError, ET.ParseError, StopIteration, EOFError, zlib.error) as error:
        raise SimulationError(f"{file} cannot be read as a SUMO {kind} file: {error}.") from None


def points(text: str) -> Floats:
    """(P, 3) of SUMO's ``x,y x,y,z``; z = 0 if it is left out.

    Raises ValueError if that is not a list of finite numbers.
    """
    rows = [pair.split(",") for pair in text.split()]
    if not rows:
        return np.zeros((0, 3))
    try:
        found = np.array([[float(row[0]), float(row[1]), float((*row, "0")[2])] for row in rows])
    except (ValueError, IndexError):
        raise ValueError(f"the shape {text!r:.80} is not a list of x,y or x,y,z") from None
    if not np.isfinite(found).all():
        raise ValueError(f"the shape {text!r:.80} has numbers that are not finite")
    return found


def truth(text: str) -> bool:
    """What SUMO takes an attribute for that is true or false; it ignores capitals."""
    return text.lower() in {"1", "yes", "true", "on", "x", "t"}


def number(element: ET.Element, name: str, default: float) -> float:
    """A finite number of an element. Raises ValueError, with the element and its value."""
    text = element.get(name, str(default))
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        which = element.get("id", element.get("from", ""))
        raise ValueError(f"{name} of <{element.tag}> {which!r:.80} is {text!r:.80}, not a number")
    return value


@contextmanager
def _opened(file: Path) -> Iterator[IO[bytes]]:
    """The file's content, unpacked where its first bytes are gzip's."""
    with files.unpacked(file, _LARGEST) as stream:
        yield stream


def _edge(element: ET.Element) -> NetEdge:
    key = element.get("id", "")
    return NetEdge(
        id=key,
        start=element.get("from", ""),
        end=element.get("to", ""),
        function="" if (function := element.get("function", "")) == "normal" else function,
        type=element.get("type", ""),
        lanes=tuple(_lane(lane, key, row) for row, lane in enumerate(element.iter("lane"))),
        name=_name(element),
        bidi=element.get("bidi", ""),
    )


def _name(element: ET.Element) -> str:
    """The name in one line, with single blanks."""
    return " ".join(element.get("name", "").split())


def _lane(element: ET.Element, edge: str, index: int) -> NetLane:
    allow = element.get("allow")
    return NetLane(
        id=element.get("id", ""),
        edge=edge,
        index=index,  # as SUMO counts; that in the file is 0 for all lanes of some edges
        speed_mps=number(element, "speed", 13.89),
        length_m=number(element, "length", 0),
        width_m=number(element, "width", 3.2),
        allow=None if allow is None else frozenset(allow.split()),
        disallow=frozenset(element.get("disallow", "").split()),
        shape_m=points(element.get("shape", "")),
    )


def _junction(element: ET.Element) -> NetJunction:
    requests = sorted(element.iter("request"), key=lambda one: number(one, "index", 0))
    return NetJunction(
        id=element.get("id", ""),
        type=element.get("type", ""),
        shape_m=points(element.get("shape", "")),
        inner_lanes=tuple(element.get("intLanes", "").split()),
        goes_first=tuple(_rows(one.get("response", "")) for one in requests),
        incoming=tuple(element.get("incLanes", "").split()),
        foes=tuple(_rows(one.get("foes", "")) for one in requests),
        name=_name(element),
    )


def _location(element: ET.Element) -> NetLocation:
    offset = points(element.get("netOffset", "0,0"))
    if len(offset) != 1:
        raise ValueError(f"netOffset of <location> is {element.get('netOffset')!r:.80}, not x,y")
    x, y, _ = offset[0].tolist()
    return NetLocation(offset_m=(x, y), projection=element.get("projParameter", "!").strip() or "!")


def _rows(bits: str) -> frozenset[int]:
    """The last letter is link 0."""
    return frozenset(row for row, letter in enumerate(reversed(bits)) if letter == "1")


def _link(element: ET.Element) -> NetLink:
    return NetLink(
        origin=f"{element.get('from')}_{element.get('fromLane')}",
        target=f"{element.get('to')}_{element.get('toLane')}",
        via=element.get("via", ""),
        light=element.get("tl", ""),
        index=int(number(element, "linkIndex", -1)),
        state=element.get("state", ""),
        direction=element.get("dir", ""),
    )


def going_first(net: NetFile) -> dict[str, tuple[str, ...]]:
    """Lanes inside a junction whose traffic goes first, by the lane inside that gives way.

    From the ``response`` of the junctions' ``<request>``. A connection that waits in the middle of
    the junction has several lanes, and each of them counts. Connections that give way to no other
    are left out. At lights this holds while both are green.
    """
    after = {link.origin: link.via for link in net.links if link.starts_inside}
    chains: dict[str, tuple[str, ...]] = {}
    for link in net.links:
        if link.via and not link.starts_inside:
            chain = [link.via]
            while after.get(chain[-1]) and after[chain[-1]] not in chain:
                chain.append(after[chain[-1]])
            chains |= dict.fromkeys(chain, tuple(chain))
    found: dict[str, tuple[str, ...]] = {}
    for junction in net.junctions:
        of_row = [chains.get(lane, ()) for lane in junction.inner_lanes]
        for mine, first in zip(of_row, junction.goes_first, strict=False):
            others = tuple(
                lane for row in sorted(first) if row < len(of_row) for lane in of_row[row]
            )
            if others:
                found |= dict.fromkeys(mine, others)
    return found


def meeting_ways(net: NetFile, ways: Iterable[Way]) -> frozenset[tuple[Way, Way]]:
    """Of the ways those pairs, in both orders, that come from two edges and cross or end on one.

    Judged by the lines along the middle of the lanes, for junctions without a rule (`unregulated`)
    have no ``<request>`` that would name foes. In a network without lanes inside its junctions the
    lines are straight. Paths without a connection in the network meet no other path.
    """
    links: dict[Way, list[NetLink]] = defaultdict(list)
    inside: dict[str, NetLink] = {}
    for link in net.links:
        if link.starts_inside:
            inside[link.origin] = link
        else:
            links[link.edges].append(link)
    at: dict[str, list[Way]] = defaultdict(list)
    lines = {}
    for way in sorted(set(ways)):
        if way in links:
            at[net.edges[way[0]].end].append(way)
            drawn = [_line(net, inside, link) for link in links[way]]
            lines[way] = shapely.MultiLineString([shapely.LineString(one) for one in drawn])
    candidates = [
        (one, two)
        for met in at.values()
        for one, two in itertools.combinations(met, 2)
        if one[0] != two[0]
    ]
    first, second = ([lines[pair[side]] for pair in candidates] for side in (0, 1))
    cross = shapely.intersects(np.array(first, object), np.array(second, object))
    return frozenset(
        both
        for (one, two), crosses in zip(candidates, cross, strict=True)
        if crosses or one[1] == two[1]
        for both in ((one, two), (two, one))
    )


def waiting_ways(net: NetFile) -> frozenset[Way]:
    """Movements that can wait inside the junction: on the first of two successive lanes there."""
    onward = {link.origin: link for link in net.links if link.starts_inside}
    return frozenset(
        link.edges
        for link in net.links
        if not link.starts_inside and link.via in onward and onward[link.via].via
    )


def junctions(net: NetFile) -> dict[str, str]:
    """The junction with several approaching edges at the end of each edge.

    An edge that ends elsewhere counts to such a junction at its start; other edges are left out.
    """
    approaches: dict[str, set[str]] = defaultdict(set)
    for link in (link for link in net.links if not link.starts_inside):
        approaches[net.edges[edge_of(link.origin)].end].add(edge_of(link.origin))
    return {
        edge.id: node
        for edge in net.edges.values()
        for node in (edge.start, edge.end)
        if not edge.function and len(approaches.get(node, ())) > 1
    }


def _line(net: NetFile, inside: dict[str, NetLink], link: NetLink) -> Floats:
    """(P, 2) from the end of the lane before the junction to the start of the lane after it."""
    parts = [_shape(net, link.origin)[-1:]]
    lane, seen = link.via, set[str]()
    while lane and lane not in seen:
        seen.add(lane)
        parts.append(_shape(net, lane))
        lane = inside[lane].via if lane in inside else ""
    parts.append(_shape(net, link.target)[:1])
    return np.concatenate(parts)


def _shape(net: NetFile, lane: str) -> Floats:
    return next(one.shape_m for one in net.edges[edge_of(lane)].lanes if one.id == lane)[:, :2]
