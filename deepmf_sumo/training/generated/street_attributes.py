"""Attributes of the streets of a graph: lanes, limits, bends, right of way, turn lanes."""

import math
from collections import defaultdict
from itertools import combinations
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from deepmf_sumo.scene import Floats
from deepmf_sumo.training.generated.layout import Edge, GeneratedLayout, Node
from deepmf_sumo.training.generated.street_graph import StreetGraph

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

Street = tuple[str, str]


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


def _courses(graph: StreetGraph) -> list[list[Street]]:
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
    courses: dict[int, list[Street]] = defaultdict(list)
    for street, course in zip(
        graph.streets, connected_components(joins, directed=False)[1].tolist(), strict=True
    ):
        courses[course].append(street)
    return list(courses.values())


def _street(one: str, other: str) -> Street:
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


def _bent(graph: StreetGraph, street: Street, rng: np.random.Generator) -> Floats | None:
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
