"""The blueprint as netconvert's plain XML."""

from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.network.blueprint import Blueprint, EdgePlan, LanePlan, LinkPlan, NodePlan


def write(blueprint: Blueprint, folder: Path) -> tuple[Path, Path, Path]:
    """Write node, edge and connection files; return them in this order."""
    nodes, edges, links = (folder / f"plain.{kind}.xml" for kind in ("nod", "edg", "con"))
    nodes.write_text(_document("nodes", map(_node, blueprint.nodes)), encoding="utf-8")
    edges.write_text(_document("edges", map(_edge, blueprint.edges.values())), encoding="utf-8")
    linked = {link.origin[0] for link in blueprint.links}
    # An edge without successors has to be named, else netconvert makes some up.
    ends = (f'    <connection from="{key}"/>' for key in blueprint.edges if key not in linked)
    links.write_text(
        _document("connections", [*map(_link, blueprint.links), *ends]), encoding="utf-8"
    )
    return nodes, edges, links


def coordinates(points_m: Floats) -> str:
    """A polyline (P, 2) as SUMO writes it, to the millimetre."""
    # Adding 0.0 turns -0.0 into 0.0.
    rows = (points_m.round(3) + 0.0).tolist()
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in rows)


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
