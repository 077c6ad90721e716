"""Assembly of a network from a layout: edges, connections, traffic lights, and the off-lane edge.

In parking lots and where the map lacks a lane, the AV drives off the lanes. SUMO can drive it only
on a lane, so its recorded path becomes a separate edge that joins no other (the ghost edge).
"""

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from deepmf_sumo.scene import Floats, Lane, RoadMap, Scene, StopSign
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network import lane_graph
from deepmf_sumo.sumo.network.lane_graph import LaneGraph
from deepmf_sumo.sumo.network.layout import Group, Layout
from deepmf_sumo.sumo.network.matching import ELSEWHERE, lane_index, match
from deepmf_sumo.sumo.network.plain_net import (
    EdgePlan,
    LanePlan,
    LaneRef,
    LinkKind,
    LinkPlan,
    NodeKind,
    NodePlan,
)

JOINT_M: Final = 0.1
"""SUMO's shortest lane. A link between two lanes that touch is drawn on the end of the first."""
POINT_M: Final = 0.01
"""Lanes inside a junction that are shorter than this have no separate shape."""
WIDTH_M: Final = 3.3
BIKE_WIDTH_M: Final = 1.5
DEFAULT_SPEED_MPS: Final = {"freeway": 29.06, "street": 13.89, "unknown": 13.89, "bike": 8.33}
"""For lanes without a limit: 65 mph, 50 km/h, 30 km/h."""
PRIORITY: Final = {"freeway": 10, "street": 5, "unknown": 5, "bike": 1}
EXTENSION_M: Final = 200.0
"""Beyond the recorded map vehicles drive straight on, far enough for the longest episode."""


def sumo_id(prefix: str, lane_id: str) -> str:
    """A SUMO id made of a scene's lane id; characters that SUMO refuses become their code."""
    return prefix + re.sub(r"[^0-9A-Za-z]", lambda found: f"_{ord(found[0]):x}_", lane_id)


def lane_speed_mps(lane: Lane) -> float:
    """The lane's limit, or the usual one of its kind."""
    return lane.speed_limit_mps or DEFAULT_SPEED_MPS[lane.kind]


def lane_width_m(lane: Lane) -> float:
    """The lane's width, or the usual one of its kind."""
    return lane.width_m or (BIKE_WIDTH_M if lane.kind == "bike" else WIDTH_M)


class Assembly:
    """Edges and connections of the scene's lanes, and the first and last SUMO lane of each.

    Attributes:
        edges: by id. links: in the order of the scene's lanes.
        begins, ends: first and last SUMO lane of each lane that lies on edges.
    """

    def __init__(self, graph: LaneGraph, plan: Layout) -> None:
        self.graph = graph
        self.edges: dict[str, EdgePlan] = {}
        self.links: list[LinkPlan] = []
        self.begins: dict[str, LaneRef] = {}
        self.ends: dict[str, LaneRef] = {}
        self._linked: set[tuple[LaneRef, LaneRef]] = set()
        for index, group in enumerate(plan.groups):
            nodes = (f"j{plan.starts[index]}", f"j{plan.ends[index]}")
            if group in plan.halved:
                self._add_halves(group, *nodes)
            else:
                self._add_edge(sumo_id("e", group[0]), nodes, self._lane_plans(group, 0.0, 1.0))
        for way in plan.movements:
            self._add_link(self.ends[way.origin], self.begins[way.target], way.path)
        self._extend()

    def lane(self, ref: LaneRef) -> LanePlan:
        """The plan of a lane."""
        return self.edges[ref[0]].lanes[ref[1]]

    def node_positions(self) -> dict[str, Floats]:
        """(2) position of each junction: the mean of the lane ends that meet there."""
        points: dict[str, list[Floats]] = defaultdict(list)
        for edge in self.edges.values():
            points[edge.start] += [lane.shape_m[0] for lane in edge.lanes]
            points[edge.end] += [lane.shape_m[-1] for lane in edge.lanes]
        return {node: np.mean(ends, axis=0) for node, ends in points.items()}

    def _lane_plans(self, group: Group, start: float, end: float) -> tuple[LanePlan, ...]:
        """The lanes of a group between two shares of their lengths."""
        plans = []
        for lane_id in group:
            lane, length = self.graph.lanes[lane_id], self.graph.lengths_m[lane_id]
            shape = self.graph.shapes[lane_id][:, :2]
            plans.append(
                LanePlan(
                    shape_m=lane_graph.part(shape, start * length, end * length),
                    speed_mps=lane_speed_mps(lane),
                    width_m=lane_width_m(lane),
                    scene_lane=lane_id,
                    start_m=start * length,
                )
            )
        return tuple(plans)

    def _add_edge(self, key: str, nodes: tuple[str, str], lanes: tuple[LanePlan, ...]) -> None:
        kinds = [self.graph.lanes[lane.scene_lane].kind for lane in lanes if lane.scene_lane]
        self.edges[key] = EdgePlan(
            id=key,
            start=nodes[0],
            end=nodes[1],
            lanes=lanes,
            bike="bike" in kinds,
            priority=max((PRIORITY[kind] for kind in kinds), default=PRIORITY["unknown"]),
        )
        for index, lane in enumerate(lanes):
            if lane.scene_lane:
                self.begins.setdefault(lane.scene_lane, (key, index))
                self.ends[lane.scene_lane] = (key, index)

    def _add_halves(self, group: Group, start: str, end: str) -> None:
        """Two successive edges, since SUMO has none that returns to its junction."""
        first, second = sumo_id("e", group[0]), sumo_id("e", group[0]) + "_h"
        self._add_edge(first, (start, f"{first}_m"), self._lane_plans(group, 0.0, 0.5))
        self._add_edge(second, (f"{first}_m", end), self._lane_plans(group, 0.5, 1.0))
        for index in range(len(group)):
            self._add_link((first, index), (second, index), ())

    def _add_link(self, origin: LaneRef, target: LaneRef, path: tuple[str, ...]) -> None:
        """Add a connection, unless the two lanes have one already: SUMO allows only one."""
        if (origin, target) in self._linked:
            return
        self._linked.add((origin, target))
        before, after = self.lane(origin), self.lane(target)
        kind: LinkKind = "path"
        if not path and (before.scene_lane, after.scene_lane) in self.graph.gaps:
            kind, shape = "bridge", lane_graph.bridge(before.shape_m, after.shape_m)
        elif sum(self.graph.lengths_m[lane_id] for lane_id in path) < POINT_M:
            kind, shape = "joint", lane_graph.tail(before.shape_m, JOINT_M)
        else:
            shape = lane_graph.joined([self.graph.shapes[lane_id][:, :2] for lane_id in path])
        speed = min(before.speed_mps, after.speed_mps)
        if kind != "joint":
            speed = min(speed, lane_graph.bend_speed_mps(shape))
        self.links.append(
            LinkPlan(
                origin=origin, target=target, shape_m=shape, path=path, kind=kind, speed_mps=speed
            )
        )

    def _extend(self) -> None:
        """Add straight edges after the lanes at which the recorded map ends."""
        linked = {link.origin for link in self.links}
        for edge in list(self.edges.values()):
            loose = [index for index in range(len(edge.lanes)) if (edge.id, index) not in linked]
            if edge.bike or not loose:
                continue
            directions = [lane_graph.end_direction(edge.lanes[index].shape_m) for index in loose]
            ahead = np.mean(directions, axis=0)
            ahead *= EXTENSION_M / max(float(np.hypot(*ahead)), 1e-9)
            lanes = []
            for index in loose:
                lane, end = edge.lanes[index], edge.lanes[index].shape_m[-1]
                shape = np.vstack([end, end + ahead])
                lanes.append(
                    LanePlan(shape_m=shape, speed_mps=lane.speed_mps, width_m=lane.width_m)
                )
            key = f"x{edge.id}"
            self._add_edge(key, (edge.end, f"{key}_m"), tuple(lanes))
            for place, index in enumerate(loose):
                self._add_link((edge.id, index), (key, place), ())


GHOST_EDGE: Final = "ghost_av"
OFF_LANE_M: Final = 3.0
"""At nearly a lane's width from any lane of its direction the AV has left the lanes. Lane changes
stay below it."""
OFF_STEPS: Final = 5
SPACING_M: Final = 1.0
BEHIND_M: Final = 20.0
AHEAD_M: Final = 200.0
OFF_LANE_SPEED_MPS: Final = 13.89


def leaves_lanes(scene: Scene) -> bool:
    """Whether the AV's recorded path, from the present on, leads off the lanes.

    It does if the AV is far from any lane for half a second, or continues on a lane that is neither
    a successor nor a neighbour of the lane before.
    """
    row = scene.tracks.row(scene.av_id)
    valid = scene.tracks.valid[row].copy()
    valid[: scene.now] = False
    tracks = scene.tracks
    poses = tracks.position_m[row], tracks.heading_rad[row], valid
    found = match(scene.road, *poses, tracks.z_m[row])
    off = found.distance_m[valid] > OFF_LANE_M
    runs = "".join("x" if far else " " for far in off).split()
    longest = max(map(len, runs), default=0)
    lanes = [lane for lane in found.lane_ids if lane]
    return longest >= OFF_STEPS or _jumps(scene.road, lanes)


def _jumps(road: RoadMap, lane_ids: Iterable[str]) -> bool:
    index = lane_index(road)
    return any(index.cost(one, two) >= ELSEWHERE for one, two in pairwise(lane_ids))


def ghost_edge(scene: Scene) -> tuple[EdgePlan, tuple[NodePlan, NodePlan]]:
    """The edge and its two nodes."""
    shape = ghost_path(scene)
    row = scene.tracks.row(scene.av_id)
    speed = max(
        OFF_LANE_SPEED_MPS, float(scene.tracks.speed_mps[row][scene.tracks.valid[row]].max())
    )
    nodes = tuple(
        NodePlan(id=f"{GHOST_EDGE}_{end}", position_m=point)
        for end, point in (("start", shape[0]), ("end", shape[-1]))
    )
    lane = LanePlan(shape_m=shape, speed_mps=speed, width_m=WIDTH_M)
    edge = EdgePlan(id=GHOST_EDGE, start=nodes[0].id, end=nodes[1].id, lanes=(lane,))
    return edge, (nodes[0], nodes[1])


def ghost_path(scene: Scene) -> Floats:
    """(P, 2) the AV's path, from behind its first pose, continued straight ahead."""
    row = scene.tracks.row(scene.av_id)
    valid = scene.tracks.valid[row]
    positions = scene.tracks.position_m[row][valid]
    headings = scene.tracks.heading_rad[row][valid]
    path = [positions[0]]
    for position in positions[1:]:
        if np.hypot(*(position - path[-1])) >= SPACING_M:
            path.append(position)
    before = path[0] - BEHIND_M * frames.unit(headings[0])
    line = np.array([before, *path])
    ahead = frames.unit(headings[-1]) if len(path) == 1 else lane_graph.end_direction(line)
    return np.vstack([line, line[-1] + AHEAD_M * ahead])


STOP_PRIORITY = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Types of junctions other than ``priority``, and the connections of each signalled lane.

    Attributes:
        kinds: by node id.
        signalled: scene lane -> (origin, target) of the links that carry its light.
        lost: signalled lane, why it has no link.
    """

    kinds: dict[str, NodeKind]
    signalled: dict[str, tuple[tuple[LaneRef, LaneRef], ...]]
    lost: tuple[tuple[str, str], ...]


def control(assembly: Assembly, signalled: Iterable[str], signs: Iterable[StopSign]) -> Control:
    """Types of junctions; edges before a stop sign lose their priority in ``assembly``."""
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
    """Connections to a lane: a light stands at the first point of its recorded lane."""
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
    """All-way stops if every edge has a sign, else stops for the edges that have one."""
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
