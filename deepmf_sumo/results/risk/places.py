"""The places of a SUMO network in the terms of traffic engineers.

Places are lanes, edges, junctions and movements. A movement is a path over a junction,
from one edge to another; SUMO's lanes inside the junction belong to it. Edges and movements
together cover the network, each spot once.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
import shapely

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.sumo.network.sumo_net import (
    TURNS,
    NetEdge,
    NetFile,
    NetJunction,
    NetLane,
    NetLink,
    elements,
    junction_of,
    read_once,
)

Kind = Literal["movement", "edge", "junction", "lane"]
KINDS: Final[tuple[Kind, ...]] = ("movement", "edge", "junction", "lane")
SITES: Final[tuple[Kind, ...]] = ("movement", "edge")
"""The kinds that cover the network: each run was decided at one of them."""

_RULES: Final = {"M": "priority", "m": "give way", "=": "right before left", "s": "stop"} | {
    "w": "all-way stop", "Z": "zipper merge",
}  # fmt: skip
_WINDS: Final = (
    "east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east",
)  # fmt: skip
_MOST_STREETS: Final = 3
"""A junction is named after at most this number of the streets that meet there."""
_WAY_M: Final = 30.0
"""Length of an edge at a junction that its compass direction is taken from."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Movement:
    """A path over a junction.

    Attributes:
        origin, target: edges.
        turn: straight, left, right, turnaround; empty where SUMO names none.
        rule: of right of way, or what the light shows: ``permissive`` is a green that has to
            give way. Several where its lanes differ.
        lanes: inside the junction, in driving order for each lane of the origin.
        driven: whether road vehicles may drive it: bicycles, trams and people are none.
    """

    id: str
    junction: str
    origin: str
    target: str
    turn: str
    rule: str
    lanes: tuple[str, ...]
    driven: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """Where on the network something is; what it is not on is empty.

    Attributes:
        lane: its id, those inside junctions too. edge: a normal one.
    """

    lane: str = ""
    edge: str = ""
    junction: str = ""
    movement: str = ""

    def of(self, kind: Kind) -> str:
        """Id of the place of that kind, or empty."""
        place: str = getattr(self, kind)
        return place


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """All places of a network.

    Attributes:
        movements: by id, ``JUNCTION: EDGE -> EDGE``.
        rings: ids of the junctions of roundabouts.
    """

    net: NetFile
    movements: dict[str, Movement]
    rings: frozenset[str] = frozenset()

    @cached_property
    def lanes(self) -> dict[str, NetLane]:
        """All lanes by id."""
        return {lane.id: lane for edge in self.net.edges.values() for lane in edge.lanes}

    @cached_property
    def junctions(self) -> dict[str, NetJunction]:
        """All junctions by id, those without an outline too."""
        return {junction.id: junction for junction in self.net.junctions}

    @cached_property
    def _of_inner_lane(self) -> dict[str, Movement]:
        return {lane: one for one in self.movements.values() for lane in one.lanes}

    @cached_property
    def _of_way_over(self) -> dict[str, Movement]:
        """By the names of ways over lights in networks without lanes inside (`NetLink.onto`)."""
        found = {}
        for link in self.net.links:
            one = self.movement(*link.edges)
            if one is not None and link.onto not in self.lanes:
                found[link.onto] = one
        return found

    @cached_property
    def _outlines(self) -> list[tuple[str, shapely.Polygon, float]]:
        """Of junctions: id, outline and mean height."""
        return [
            (one.id, shapely.Polygon(one.shape_m[:, :2]), float(one.shape_m[:, 2].mean()))
            for one in self.net.junctions
            if len(one.shape_m) > 2
        ]

    def spot(self, lane_id: str) -> Spot:
        """Where a lane is."""
        movement = self._of_inner_lane.get(lane_id) or self._of_way_over.get(lane_id)
        if movement:
            return Spot(lane=lane_id, junction=movement.junction, movement=movement.id)
        edge = self.lanes[lane_id].edge
        if inside := junction_of(edge):  # and of no connection
            return Spot(lane=lane_id, junction=inside)
        return Spot(lane=lane_id, edge=edge)

    def within(self, place_m: Floats, z_m: float) -> str:
        """The junction whose outline contains a position (2,), at its height; else empty."""
        point = shapely.Point(place_m)
        inside = (one for one in self._outlines if one[1].covers(point))
        return next((name for name, _, height in inside if not clear(height, z_m)), "")

    def in_junction(self, junction: str, movement: Movement | None) -> Spot:
        """Within a junction's outline, on no lane; with the movement, if it is of there."""
        over = movement is not None and movement.junction == junction
        return Spot(junction=junction, movement=movement.id if movement and over else "")

    def movement(self, origin: str, target: str) -> Movement | None:
        """The path from an edge to another."""
        edge = self.net.edges.get(origin)
        return self.movements.get(_name(edge.end, origin, target)) if edge else None

    def title(self, kind: Kind, place: str) -> str:
        """A readable name of a place, with its id, so that no two places share a title.

        E.g. ``centre: from north to east (left, permissive)``, ``main_3 (centre to bridge)``; where
        streets have names ``Mill Lane / High Street (j7): from Mill Lane (north) to High Street
        (east) (left, permissive)``, ``High Street, Mill Lane to Church Road (main_3)``.
        """
        if kind == "movement":
            one = self.movements[place]
            nature = ", ".join(part for part in (one.turn, one.rule) if part)
            named = f"{self.title('junction', one.junction)}: {self._arms(one)}"
            return named + (f" ({nature})" if nature else "")
        if kind == "lane":
            movement = self._of_inner_lane.get(place)
            if movement:
                return f"{self.title('movement', movement.id)}, lane {place}"
            lane = self.lanes[place]
            return f"{_called(self.net.edges[lane.edge].name, lane.edge)}, lane {lane.index}"
        if kind == "edge":
            edge = self.net.edges[place]
            ends = f"{self._end(edge.start, edge)} to {self._end(edge.end, edge)}"
            return f"{edge.name}, {ends} ({place})" if edge.name else f"{place} ({ends})"
        return _called(self._corner(place, but=""), place)

    def _arms(self, one: Movement) -> str:
        """Where a movement comes from and leads to, with the streets' names."""
        streets = [self.net.edges[edge].name for edge in (one.origin, one.target)]
        winds = [self._wind(one.origin, ahead=False), self._wind(one.target)]
        if streets[0] and streets[0] == streets[1]:
            return f"on {streets[0]} from {winds[0]} to {winds[1]}"
        origin, target = (
            f"{street} ({wind})" if street else wind
            for street, wind in zip(streets, winds, strict=True)
        )
        return f"from {origin} to {target}"

    def _end(self, junction: str, edge: NetEdge) -> str:
        """A junction as seen from an edge: the other streets there, else the junction's id."""
        return self._corner(junction, but=edge.name) or junction

    def _corner(self, junction: str, *, but: str) -> str:
        """The junction's own name, else its streets' without one of them; empty without any."""
        own = self.junctions[junction].name if junction in self.junctions else ""
        if own:
            return own
        streets = [street for street in self._streets.get(junction, ()) if street != but]
        more = ["..."] if len(streets) > _MOST_STREETS else []
        return " / ".join(streets[:_MOST_STREETS] + more)

    @cached_property
    def _streets(self) -> dict[str, list[str]]:
        """Names of the streets at each junction, in alphabetical order."""
        found: dict[str, set[str]] = defaultdict(set)
        for edge in self.net.edges.values():
            if edge.name and not edge.function:
                found[edge.start].add(edge.name)
                found[edge.end].add(edge.name)
        return {junction: sorted(names) for junction, names in found.items()}

    def site(self, spot: Spot) -> str:
        """Title of the movement or edge of a spot; empty where it is on neither."""
        titles = (self.title(kind, spot.of(kind)) for kind in SITES if spot.of(kind))
        return next(titles, "")

    def located(self, spot: Spot) -> tuple[Kind, str, str]:
        """Kind, id and title of the movement, edge, or else junction of a spot."""
        kinds: tuple[Kind, ...] = (*SITES, "junction")
        kind = next((one for one in kinds if spot.of(one)), kinds[-1])
        place = spot.of(kind)
        return kind, place, self.title(kind, place)

    @cached_property
    def driven(self) -> dict[Kind, tuple[str, ...]]:
        """Ids of the places of each kind that road vehicles may use, in the network's order."""
        movements = [one for one in self.movements.values() if one.driven]
        normal = [edge for edge in self.net.edges.values() if not edge.function]
        lanes = [lane for edge in normal for lane in edge.lanes if lane.road]
        inner = [name for one in movements for name in one.lanes if self.lanes[name].road]
        return {
            "movement": tuple(one.id for one in movements),
            "edge": tuple(dict.fromkeys(lane.edge for lane in lanes)),
            "junction": tuple(dict.fromkeys(one.junction for one in movements)),
            "lane": (*(lane.id for lane in lanes), *dict.fromkeys(inner)),
        }

    def count(self, kind: Kind) -> int:
        """How many places of a kind there are for road vehicles."""
        return len(self.driven[kind])

    def _wind(self, edge: str, *, ahead: bool = True) -> str:
        """On which side of the junction an edge lies: behind it, or before it if not ``ahead``."""
        shape = self.net.edges[edge].lanes[0].shape_m[:, :2]
        line = shapely.LineString(shape if ahead else shape[::-1])
        near, far = shapely.get_coordinates(
            shapely.line_interpolate_point(line, [0.0, min(_WAY_M, line.length)])
        )
        x, y = far - near
        return _WINDS[round(float(np.arctan2(y, x)) / (np.pi / 4)) % 8]

    def heading_rad(self, edge: str) -> float:
        """In which direction an edge comes to the junction at its end, over its last 30 m."""
        line = shapely.LineString(self.net.edges[edge].lanes[0].shape_m[::-1, :2])
        near, far = shapely.get_coordinates(
            shapely.line_interpolate_point(line, [0.0, min(_WAY_M, line.length)])
        )
        x, y = near - far
        return float(np.arctan2(y, x))


def read(net_file: Path) -> Places:
    """The places of a .net.xml. Raises SimulationError where it is not one."""
    net = read_once(net_file)
    inner = {link.origin: link for link in net.links if link.origin.startswith(":")}
    greens, rings = _lights_and_rings(net_file)
    roads = {lane.id for edge in net.edges.values() for lane in edge.lanes if lane.road}
    kinds = {one.id: one.type for one in net.junctions}
    by_edges: dict[tuple[str, str], list[NetLink]] = defaultdict(list)
    for link in net.links:
        ends = link.origin.rpartition("_")[0], link.target.rpartition("_")[0]
        # pedestrians' links begin or end on walking areas
        if not any(edge.startswith(":") for edge in ends):
            by_edges[ends].append(link)
    movements = {}
    for (origin, target), links in by_edges.items():
        for edge in (origin, target):
            if edge not in net.edges:
                raise SimulationError(
                    f"'{net_file}' has a connection from edge '{origin}' to edge '{target}', but no"
                    f" edge '{edge}'; build the network again with netconvert."
                )
        junction = net.edges[origin].end
        name = _name(junction, origin, target)
        rules = (_rule(one, greens, kinds.get(junction, "")) for one in links)
        movements[name] = Movement(
            id=name,
            junction=junction,
            origin=origin,
            target=target,
            turn=TURNS.get(links[0].direction, ""),
            rule=" / ".join(dict.fromkeys(filter(None, rules))),
            lanes=tuple(lane for link in links for lane in _chain(link, inner)),
            driven=any(one.origin in roads and one.target in roads for one in links),
        )
    return Places(net=net, movements=movements, rings=rings)


def _called(name: str, place: str) -> str:
    """The name with the id, or the id alone."""
    return f"{name} ({place})" if name else place


def _name(junction: str, origin: str, target: str) -> str:
    return f"{junction}: {origin} -> {target}"


def _chain(link: NetLink, inner: dict[str, NetLink]) -> list[str]:
    """Lanes of a connection inside the junction."""
    lanes: list[str] = []
    via = link.via
    while via and via not in lanes:
        lanes.append(via)
        via = inner[via].via if via in inner else ""
    return lanes


def _lights_and_rings(net_file: Path) -> tuple[dict[tuple[str, int], set[str]], frozenset[str]]:
    """What a link of a traffic light shows in its phases, and the junctions of roundabouts."""
    shown: dict[tuple[str, int], set[str]] = defaultdict(set)
    rings: set[str] = set()
    for element in elements(net_file, "net"):
        if element.tag == "roundabout":
            rings.update(element.get("nodes", "").split())
        if element.tag == "tlLogic":
            for phase in element.iter("phase"):
                for index, letter in enumerate(phase.get("state", "")):
                    shown[element.get("id", ""), index].add(letter)
    return shown, frozenset(rings)


def _rule(link: NetLink, greens: dict[tuple[str, int], set[str]], junction: str) -> str:
    if not link.light:
        left_first = link.state == "=" and junction == "left_before_right"
        return "left before right" if left_first else _RULES.get(link.state, "")
    shown = greens.get((link.light, link.index), set())
    if "g" in shown:
        return "protected and permissive" if "G" in shown else "permissive"
    return "protected" if "G" in shown else "signal"
