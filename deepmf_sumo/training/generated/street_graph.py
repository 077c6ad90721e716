"""Streets: graphs of netgenerate or single crossings, their attributes, and roundabouts.

Attributes are lanes, limits, bends, right of way and turn lanes.
"""

import math
import tempfile
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.training.generated.layout import Edge, GeneratedLayout, Node

Point = tuple[float, float]
_STRAIGHT_RAD: Final = 0.6
"""A street that bends less at a junction continues there, with the same lanes."""
_LANES: Final = (1, 1, 1, 1, 2, 2, 2, 3, 3)
_LIMITS_MPS: Final = {
    1: (8.9, 11.2, 13.4, 13.4, 15.6, 17.9),
    2: (11.2, 13.4, 15.6, 17.9, 17.9, 20.1),
    3: (15.6, 17.9, 20.1, 22.4, 24.6),
}
_BEND_SHARE: Final = 0.35
_TURN_LANE_SHARE: Final = 0.5

_Street = tuple[str, str]
_ARMS: Final = (3, 4, 5)
_LEAST_ARM_M: Final = 70.0
_SHARE: Final = 0.15
_LIMIT_MPS: Final = 11.0
_PRIORITY: Final = 20
"""Above every street's: traffic in the ring goes first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetGraph:
    """Nodes by name, and pairs of nodes with a street between them, each pair once."""

    places: dict[str, Point]
    streets: tuple[tuple[str, str], ...]

    def arms(self) -> dict[str, list[str]]:
        """The neighbours of each node."""
        arms: dict[str, list[str]] = defaultdict(list)
        for one, other in self.streets:
            arms[one].append(other)
            arms[other].append(one)
        return arms


def grid(rng: np.random.Generator) -> StreetGraph:
    """Blocks of 70 to 190 m, not quite rectangular; streets continue at the rim."""
    across, along = rng.uniform(70.0, 190.0, 2)
    columns, rows = rng.integers(2, 5, 2)
    graph = _netgenerate(
        rng,
        *("--grid", "--grid.x-number", str(columns), "--grid.y-number", str(rows)),
        *("--grid.x-length", f"{across:.1f}", "--grid.y-length", f"{along:.1f}"),
        *("--grid.attach-length", f"{rng.uniform(120, 200):.1f}"),
    )
    return _shaken(graph, rng, rng.uniform(0.0, 0.1) * min(across, along))


def spider(rng: np.random.Generator) -> StreetGraph:
    """Radial streets, and rings across them."""
    graph = _netgenerate(
        rng,
        *("--spider", "--spider.arm-number", str(rng.integers(3, 7))),
        *("--spider.circle-number", str(rng.integers(1, 4))),
        *("--spider.space-radius", f"{rng.uniform(80, 150):.1f}"),
        *("--spider.attach-length", f"{rng.uniform(120, 180):.1f}"),
    )
    return _shaken(graph, rng, rng.uniform(0.0, 8.0))


def random_net(rng: np.random.Generator) -> StreetGraph:
    """Streets that netgenerate grows at random."""
    return _netgenerate(
        rng,
        *("--rand", "--rand.iterations", str(rng.integers(12, 30))),
        *("--rand.min-distance", "80", "--rand.max-distance", f"{rng.uniform(140, 240):.1f}"),
        *("--rand.min-angle", "45", "--rand.connectivity", "0.95"),
    )


def crossing(rng: np.random.Generator) -> StreetGraph:
    """One junction of 3 to 5 arms, or two of them close to each other."""
    places: dict[str, Point] = {}
    streets: list[tuple[str, str]] = []
    first, axis = rng.uniform(0, 2 * np.pi, 2)
    centres: list[tuple[str, Floats, float | None]] = [("a", np.zeros(2), None)]
    if rng.random() < 0.4:
        apart = rng.uniform(60, 140) * np.array([np.cos(axis), np.sin(axis)])
        centres = [("a", np.zeros(2), axis), ("b", apart, axis + np.pi)]
        streets.append(("a", "b"))
    for name, centre, taken in centres:
        places[name] = (float(centre[0]), float(centre[1]))
        count = int(rng.choice([3, 4, 4, 4, 5]))
        start = first if taken is None else taken
        angles = start + np.arange(count) * 2 * np.pi / count
        angles += rng.uniform(-0.25, 0.25, count) * (np.arange(count) > 0)
        for number, angle in enumerate(angles):
            if taken is not None and number == 0:
                continue  # the arm to the other junction
            end = centre + rng.uniform(140, 240) * np.array([np.cos(angle), np.sin(angle)])
            places[f"{name}{number}"] = (float(end[0]), float(end[1]))
            streets.append((name, f"{name}{number}"))
    return StreetGraph(places=places, streets=tuple(streets))


def _shaken(graph: StreetGraph, rng: np.random.Generator, by_m: float) -> StreetGraph:
    """The graph, rotated by a random angle, with nodes shifted by about ``by_m``."""
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places = {}
    for name, position in graph.places.items():
        x, y = turn @ np.array(position) + rng.normal(0, by_m, 2)
        places[name] = (float(x), float(y))
    return StreetGraph(places=places, streets=graph.streets)


def _netgenerate(rng: np.random.Generator, *options: str) -> StreetGraph:
    seed = str(rng.integers(1, 2**31 - 1))
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        prefix = Path(folder) / "plain"
        sumo_tools.run(
            "netgenerate", *options, "--seed", seed, "--plain-output-prefix", str(prefix)
        )
        nodes = ET.parse(f"{prefix}.nod.xml").getroot()  # noqa: S314 (ours, of a moment ago)
        edges = ET.parse(f"{prefix}.edg.xml").getroot()  # noqa: S314
    places = {
        node.get("id", ""): (float(node.get("x", "")), float(node.get("y", "")))
        for node in nodes.iter("node")
    }
    pairs = [(edge.get("from", ""), edge.get("to", "")) for edge in edges.iter("edge")]
    streets = tuple(sorted({(min(pair), max(pair)) for pair in pairs}))
    if not streets:
        raise ConversionError(f"netgenerate made no street with {' '.join(options)}.")
    return StreetGraph(places=places, streets=streets)


def dress(graph: StreetGraph, rng: np.random.Generator) -> GeneratedLayout:
    """A network with random lanes, limits, bends and junctions on the given streets."""
    layout = GeneratedLayout(options=_options(rng))
    arms = graph.arms()
    lanes, limits = {}, {}
    for course in _courses(graph):
        count = int(rng.choice(_LANES))
        limit = float(rng.choice(_LIMITS_MPS[count]))
        for street in course:
            lanes[street], limits[street] = count, limit
    for place, position in graph.places.items():
        widths = [lanes[_street(place, other)] for other in arms[place]]
        kind = _junction(rng, widths) if len(widths) > 2 else "priority"
        layout.nodes[place] = Node(position_m=position, kind=kind)
    for street in graph.streets:
        shape = _bent(graph, street, rng)
        for origin, target in (street, street[::-1]):
            length = math.dist(graph.places[origin], graph.places[target])
            layout.edges[f"{origin}_{target}"] = Edge(
                origin=origin,
                target=target,
                lanes=lanes[street],
                speed_mps=limits[street],
                priority=2 * lanes[street] + (limits[street] > 12.0),
                shape_m=shape if shape is None or origin == street[0] else shape[::-1],
                turn_lane_m=_turn_lane(rng, length, len(arms[target]), lanes[street]),
            )
    return layout


def _options(rng: np.random.Generator) -> tuple[str, ...]:
    lights = str(rng.choice(["static", "static", "actuated"]))
    return (
        *("--default.junctions.radius", f"{rng.uniform(4, 11):.1f}"),
        *("--default.lanewidth", f"{rng.uniform(3.0, 3.7):.2f}"),
        *("--tls.default-type", lights, "--tls.cycle.time", str(rng.integers(36, 71))),
    )


def _courses(graph: StreetGraph) -> list[list[_Street]]:
    """Groups of streets that continue each other straight through junctions."""
    number = {street: index for index, street in enumerate(graph.streets)}
    straight: list[tuple[int, int]] = []
    for place, others in graph.arms().items():
        here = np.array(graph.places[place])
        ways = {other: np.array(graph.places[other]) - here for other in others}
        out = {other: float(np.arctan2(way[1], way[0])) for other, way in ways.items()}
        bends = sorted(
            (abs(abs((out[one] - out[other]) % (2 * np.pi)) - np.pi), one, other)
            for one, other in combinations(others, 2)
        )
        free = set(others)
        for bend, one, other in bends:
            if bend < _STRAIGHT_RAD and {one, other} <= free:
                free -= {one, other}
                straight.append((number[_street(place, one)], number[_street(place, other)]))
    one_of, other_of = np.array(straight, int).reshape(-1, 2).T
    joins = coo_array((np.ones(len(one_of), bool), (one_of, other_of)), 2 * (len(number),))
    courses: dict[int, list[_Street]] = defaultdict(list)
    for street, course in zip(
        graph.streets, connected_components(joins, directed=False)[1].tolist(), strict=True
    ):
        courses[course].append(street)
    return list(courses.values())


def _street(one: str, other: str) -> _Street:
    return (min(one, other), max(one, other))


def _junction(rng: np.random.Generator, widths: list[int]) -> str:
    """Type of a junction: lights if streets are wide, any type if they are narrow."""
    if max(widths) > 2:
        chances = {"traffic_light": 0.7, "traffic_light_right_on_red": 0.2, "priority": 0.1}
    elif max(widths) > 1:
        chances = {"traffic_light": 0.35, "traffic_light_right_on_red": 0.15, "priority": 0.2}
        chances |= {"priority_stop": 0.2, "allway_stop": 0.1}
    else:
        chances = {"priority": 0.25, "priority_stop": 0.2, "allway_stop": 0.25}
        chances |= {"right_before_left": 0.15, "traffic_light": 0.15}
    shares = np.array(list(chances.values()))
    return str(rng.choice(list(chances), p=shares / shares.sum()))


def _turn_lane(rng: np.random.Generator, length_m: float, arms: int, lanes: int) -> float:
    wanted = rng.random() < _TURN_LANE_SHARE
    turn_lane_m = rng.uniform(25, 60)
    fits = arms > 2 and lanes < 3 and length_m > turn_lane_m + 50
    return float(turn_lane_m) if wanted and fits else 0.0


def _bent(graph: StreetGraph, street: _Street, rng: np.random.Generator) -> Floats | None:
    """(P, 2) a bow or an S between the two nodes, straight at both ends; None: no bend."""
    start, end = (np.array(graph.places[name]) for name in street)
    size, snakes, bends = rng.uniform(-0.12, 0.12), rng.random() < 0.3, rng.random() < _BEND_SHARE
    if not bends:
        return None
    share = np.linspace(0.0, 1.0, 17)
    bow = np.sin(np.pi * share) ** 2 * (np.sin(2 * np.pi * share) if snakes else 1.0)
    left = np.array([start[1] - end[1], end[0] - start[0]])
    line: Floats = start + share[:, None] * (end - start) + size * bow[:, None] * left
    return line


def add_roundabouts(layout: GeneratedLayout, rng: np.random.Generator) -> None:
    """Turn junctions with enough room into roundabouts, each with the same probability."""
    for place in list(layout.nodes):
        out = [name for name, edge in layout.edges.items() if edge.origin == place]
        room = all(layout.length_m(name) > _LEAST_ARM_M for name in out)
        narrow = all(layout.edges[name].lanes < 3 for name in out)
        straight = all(layout.edges[name].shape_m is None for name in out)
        chance, radius_m = rng.random(), rng.uniform(13.0, 22.0)
        if len(out) in _ARMS and room and narrow and straight and chance < _SHARE:
            _ring(layout, place, radius_m, rng.uniform(6.5, 9.0))


def _ring(layout: GeneratedLayout, place: str, radius_m: float, speed_mps: float) -> None:
    centre = np.array(layout.nodes.pop(place).position_m)
    bearing = {}
    for edge in layout.edges.values():
        if edge.origin == place:
            away = np.array(layout.nodes[edge.target].position_m) - centre
            bearing[edge.target] = float(np.arctan2(away[1], away[0]))
    arms = sorted(bearing, key=lambda arm: bearing[arm])
    at = {arm: f"{place}.{arm}" for arm in arms}
    for arm in arms:
        x, y = centre + radius_m * frames.unit(bearing[arm])
        layout.nodes[at[arm]] = Node(position_m=(float(x), float(y)))
    wide = _shorten_arms(layout, place, at)
    ring = []
    for arm, onward in zip(arms, [*arms[1:], arms[0]], strict=True):
        turn = (bearing[onward] - bearing[arm]) % (2 * np.pi)
        ring.append(f"{at[arm]}_ring")
        layout.edges[ring[-1]] = Edge(
            origin=at[arm],
            target=at[onward],
            lanes=wide,
            speed_mps=speed_mps,
            priority=_PRIORITY,
            shape_m=centre + radius_m * frames.unit(bearing[arm] + np.linspace(0.0, turn, 9)),
        )
    layout.roundabouts.append(([at[arm] for arm in arms], ring))


def _shorten_arms(layout: GeneratedLayout, place: str, at: dict[str, str]) -> int:
    """Let the streets end at the ring's nodes; returns the number of lanes of the widest one."""
    wide = 1
    for name, edge in list(layout.edges.items()):
        if place not in (edge.origin, edge.target):
            continue
        wide = max(wide, edge.lanes)
        slow = min(edge.speed_mps, _LIMIT_MPS)
        if edge.origin == place:
            layout.edges[name] = replace(edge, origin=at[edge.target], speed_mps=slow)
        else:
            layout.edges[name] = replace(
                edge, target=at[edge.origin], speed_mps=slow, turn_lane_m=0.0
            )
    return wide
