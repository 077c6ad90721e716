"""Where traffic lights and stop signs stand, in terms of junctions and links."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from deepmf_sumo.datatypes import StopSign
from deepmf_sumo.network.assembly import Assembly
from deepmf_sumo.network.blueprint import LaneRef, LinkPlan, NodeKind

STOP_PRIORITY = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Kinds of the junctions that are not plain ones, and the links of each signalled lane.

    Attributes:
        kinds: by node id.
        signalled: scene lane -> (origin, target) of the links that carry its light.
        lost: signalled lane, why it has no link.
    """

    kinds: dict[str, NodeKind]
    signalled: dict[str, tuple[tuple[LaneRef, LaneRef], ...]]
    lost: tuple[tuple[str, str], ...]


def control(assembly: Assembly, signalled: Iterable[str], signs: Iterable[StopSign]) -> Control:
    """Junction kinds; edges before a stop sign lose their priority in ``assembly``."""
    kinds = _stop_kinds(assembly, _stop_edges(assembly, signs))
    links: dict[str, tuple[tuple[LaneRef, LaneRef], ...]] = {}
    lost = []
    for lane_id in dict.fromkeys(signalled):
        governed = _governed(assembly, lane_id)
        if governed:
            links[lane_id] = tuple((link.origin, link.target) for link in governed)
            for link in governed:
                kinds[assembly.edges[link.origin[0]].end] = "traffic_light"
        else:
            known = lane_id in assembly.graph.shapes
            reason = "nothing leads onto the lane" if known else "the lane is not in the map"
            lost.append((lane_id, reason))
    return Control(kinds=kinds, signalled=links, lost=tuple(lost))


def _governed(assembly: Assembly, lane_id: str) -> list[LinkPlan]:
    """Links onto a lane: a light stands at the first point of the lane it is recorded for."""
    begin = assembly.begins.get(lane_id)
    return [
        link
        for link in assembly.links
        if lane_id in link.path or (begin is not None and link.target == begin)
    ]


def _stop_edges(assembly: Assembly, signs: Iterable[StopSign]) -> set[str]:
    """Edges that end at a stop sign."""
    edges = set()
    for sign in signs:
        for lane_id in sign.lane_ids:
            if lane_id not in assembly.graph.shapes:
                continue
            shape = assembly.graph.shapes[lane_id][:, :2]
            to_start, to_end = np.hypot(*(shape[[0, -1]] - sign.position_m).T)
            if lane_id in assembly.ends and to_end <= to_start:
                edges.add(assembly.ends[lane_id][0])
            else:
                edges |= {link.origin[0] for link in _governed(assembly, lane_id)}
    return edges


def _stop_kinds(assembly: Assembly, stopping: set[str]) -> dict[str, NodeKind]:
    """All-way stops where every edge has a sign, else stops for those that have one."""
    arriving: dict[str, set[str]] = defaultdict(set)
    for link in assembly.links:
        arriving[assembly.edges[link.origin[0]].end].add(link.origin[0])
    kinds: dict[str, NodeKind] = {}
    for node, edges in arriving.items():
        if not edges & stopping:
            continue
        kinds[node] = "allway_stop" if edges <= stopping else "priority_stop"
        for key in edges & stopping:
            assembly.edges[key] = replace(assembly.edges[key], priority=STOP_PRIORITY)
    return kinds
