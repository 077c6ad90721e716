"""The network to build in SUMO's terms (nodes, edges with lanes, connections), as plain XML.

netconvert changes its shapes; `conversion` restores them.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

from deepmf_sumo.scene import Floats

NodeKind = Literal["priority", "priority_stop", "allway_stop", "traffic_light"]
LinkKind = Literal["path", "joint", "bridge"]
LaneRef = tuple[str, int]
"""A SUMO edge and the index of the lane in it, counted from the right."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodePlan:
    """A junction; ``position_m`` (2)."""

    id: str
    position_m: Floats
    kind: NodeKind = "priority"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LanePlan:
    """A lane of an edge; ``scene_lane`` is None for lanes that the scene does not have.

    Attributes:
        shape_m: (P, 2).
        start_m: arc length of its start on the scene's lane.
    """

    shape_m: Floats
    speed_mps: float
    width_m: float
    scene_lane: str | None = None
    start_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgePlan:
    """An edge between two nodes; its lanes from right to left."""

    id: str
    start: str
    end: str
    lanes: tuple[LanePlan, ...]
    bike: bool = False
    priority: int = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkPlan:
    """A connection of two lanes.

    Attributes:
        shape_m: (P, 2).
        path: the scene's lanes that the shape consists of.
        kind: ``path``: made of the path's lanes; ``joint``: two lanes that touch, drawn on the end
            of the first; ``bridge``: over a gap in the scene's map.
        speed_mps: lower bound of its speed limit.
    """

    origin: LaneRef
    target: LaneRef
    shape_m: Floats
    path: tuple[str, ...] = ()
    kind: LinkKind = "path"
    speed_mps: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blueprint:
    """The whole network.

    Attributes:
        edges: by id.
        signalled: scene lane -> (origin, target) of the connections that carry its light.
    """

    nodes: tuple[NodePlan, ...]
    edges: dict[str, EdgePlan]
    links: tuple[LinkPlan, ...]
    signalled: dict[str, tuple[tuple[LaneRef, LaneRef], ...]] = field(default_factory=dict)
    ghost_edge: str | None = None

    def lane(self, ref: LaneRef) -> LanePlan:
        """The plan of a lane."""
        return self.edges[ref[0]].lanes[ref[1]]


def write(blueprint: Blueprint, folder: Path) -> tuple[Path, Path, Path]:
    """Write node, edge and connection files; return them in this order."""
    nodes, edges, links = (folder / f"plain.{kind}.xml" for kind in ("nod", "edg", "con"))
    nodes.write_text(_document("nodes", map(_node, blueprint.nodes)), encoding="utf-8")
    edges.write_text(_document("edges", map(_edge, blueprint.edges.values())), encoding="utf-8")
    linked = {link.origin[0] for link in blueprint.links}
    # An edge without successors has to be named, else netconvert guesses some.
    ends = (f'    <connection from="{key}"/>' for key in blueprint.edges if key not in linked)
    links.write_text(
        _document("connections", [*map(_link, blueprint.links), *ends]), encoding="utf-8"
    )
    return nodes, edges, links


def coordinates(points_m: Floats) -> str:
    """A polyline (P, 2) or (P, 3) as SUMO writes it, to the millimetre."""
    # Adding 0.0 turns -0.0 into 0.0.
    rows = (points_m.round(3) + 0.0).tolist()
    return " ".join(",".join(f"{one:.3f}" for one in row) for row in rows)


def _document(root: str, lines: Iterable[str]) -> str:
    body = "\n".join(lines)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{root}>\n{body}\n</{root}>\n'


def _node(node: NodePlan) -> str:
    x, y = node.position_m
    return f'    <node id="{node.id}" x="{x:.3f}" y="{y:.3f}" type="{node.kind}" radius="0"/>'


def _edge(edge: EdgePlan) -> str:
    middle = edge.lanes[len(edge.lanes) // 2]
    allow = ' allow="bicycle"' if edge.bike else ""
    lanes = "\n".join(_lane(index, lane, allow) for index, lane in enumerate(edge.lanes))
    return (
        f'    <edge id="{edge.id}" from="{edge.start}" to="{edge.end}" priority="{edge.priority}" '
        f'numLanes="{len(edge.lanes)}" speed="{middle.speed_mps:.2f}" spreadType="center"{allow} '
        f'shape="{coordinates(middle.shape_m)}">\n{lanes}\n    </edge>'
    )


def _lane(index: int, lane: LanePlan, allow: str) -> str:
    head = (
        f'        <lane index="{index}" speed="{lane.speed_mps:.2f}" width="{lane.width_m:.2f}"'
        f'{allow} shape="{coordinates(lane.shape_m)}"'
    )
    if lane.scene_lane is None:
        return f"{head}/>"
    return (
        f'{head}>\n            <param key="scene_lane" value={quoteattr(lane.scene_lane)}/>\n'
        "        </lane>"
    )


def _link(link: LinkPlan) -> str:
    return (
        f'    <connection from="{link.origin[0]}" to="{link.target[0]}" '
        f'fromLane="{link.origin[1]}" toLane="{link.target[1]}" keepClear="0" '
        f'shape="{coordinates(link.shape_m)}"/>'
    )
