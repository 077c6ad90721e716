"""A generated network: nodes, one-way edges, and their plain XML for netconvert."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.network import sumo_tools

NET_FILE: Final = "net.net.xml"
_OPTIONS: Final = (
    "--offset.disable-normalization",
    "--no-turnarounds",
    # limits are those of the street, as in recordings; drivers slow down for turns anyway
    *("--junctions.limit-turn-speed", "-1"),
    *("--junctions.internal-link-detail", "8"),
    *("--xml-validation", "never"),
    "--no-warnings",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """Where edges meet; ``kind`` as netconvert names node types."""

    position_m: tuple[float, float]
    kind: str = "priority"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """One direction of a street.

    Attributes:
        shape_m: (P, 2) from node to node, or None for the straight line.
        turn_lane_m: length of an additional left lane at its end; 0 for none.
    """

    origin: str
    target: str
    lanes: int
    speed_mps: float
    priority: int = 1
    shape_m: Floats | None = None
    turn_lane_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneConnection:
    """A connection of two lanes of successive edges; lanes count from the right."""

    origin: str
    target: str
    origin_lane: int
    target_lane: int


@dataclass(slots=True, kw_only=True, eq=False)
class GeneratedLayout:
    """A whole network.

    Attributes:
        connections: of edges whose connections netconvert must not guess.
        roundabouts: (nodes, edges) of each ring.
        options: further options of netconvert.
    """

    nodes: dict[str, Node] = field(default_factory=dict)
    edges: dict[str, Edge] = field(default_factory=dict)
    connections: list[LaneConnection] = field(default_factory=list)
    roundabouts: list[tuple[list[str], list[str]]] = field(default_factory=list)
    options: tuple[str, ...] = ()

    def shape_m(self, edge_id: str) -> Floats:
        """(P, 2) the line of an edge."""
        edge = self.edges[edge_id]
        if edge.shape_m is not None:
            return edge.shape_m
        ends = [self.nodes[end].position_m for end in (edge.origin, edge.target)]
        return np.array(ends, float)

    def length_m(self, edge_id: str) -> float:
        """Length of an edge from node to node."""
        return float(polylines.arc_lengths(self.shape_m(edge_id))[-1])


def build(layout: GeneratedLayout, folder: Path) -> Path:
    """Write the plain XML and run netconvert; returns the net's file.

    Raises ConversionError where netconvert refuses.
    """
    nodes, edges, links = (folder / f"plain.{kind}.xml" for kind in ("nod", "edg", "con"))
    nodes.write_text(_nodes(layout), "utf-8")
    edges.write_text(_edges(layout), "utf-8")
    links.write_text(_connections(layout), "utf-8")
    file = folder / NET_FILE
    sources = ("-n", str(nodes), "-e", str(edges), "-x", str(links))
    sumo_tools.run("netconvert", *sources, "-o", str(file), *_OPTIONS, *layout.options)
    return file


def _nodes(layout: GeneratedLayout) -> str:
    lines = [
        f'<node id={quoteattr(name)} x="{node.position_m[0]:.2f}" y="{node.position_m[1]:.2f}"'
        f' type="{node.kind}"/>'
        for name, node in layout.nodes.items()
    ]
    return "\n".join(["<nodes>", *lines, "</nodes>", ""])


def _edges(layout: GeneratedLayout) -> str:
    lines = []
    for name, edge in layout.edges.items():
        lanes = edge.lanes + (edge.turn_lane_m > 0)
        shape = "" if edge.shape_m is None else f' shape="{_points(edge.shape_m)}"'
        lines.append(
            f"<edge id={quoteattr(name)} from={quoteattr(edge.origin)} to={quoteattr(edge.target)}"
            f' numLanes="{lanes}" speed="{edge.speed_mps:.2f}" priority="{edge.priority}"{shape}>'
        )
        if edge.turn_lane_m > 0:
            lines.append(f'<split pos="0" lanes="{_numbers(edge.lanes)}"/>')
            lines.append(f'<split pos="-{edge.turn_lane_m:.2f}" lanes="{_numbers(lanes)}"/>')
        lines.append("</edge>")
    for nodes, edges in layout.roundabouts:
        lines.append(f'<roundabout nodes="{" ".join(nodes)}" edges="{" ".join(edges)}"/>')
    return "\n".join(["<edges>", *lines, "</edges>", ""])


def _connections(layout: GeneratedLayout) -> str:
    lines = [
        f"<connection from={quoteattr(one.origin)} to={quoteattr(one.target)}"
        f' fromLane="{one.origin_lane}" toLane="{one.target_lane}"/>'
        for one in layout.connections
    ]
    return "\n".join(["<connections>", *lines, "</connections>", ""])


def _points(shape_m: Floats) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in shape_m)


def _numbers(count: int) -> str:
    return " ".join(map(str, range(count)))
