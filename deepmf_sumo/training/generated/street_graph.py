"""Street graphs: drawn by SUMO's netgenerate, or single crossings drawn here."""

import tempfile
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import Floats
from deepmf_sumo.sumo.network import sumo_tools

Point = tuple[float, float]


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
