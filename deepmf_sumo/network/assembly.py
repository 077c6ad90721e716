"""From the distributed lanes to the blueprint of the network."""

import re
from collections import defaultdict
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Lane
from deepmf_sumo.network import cutting
from deepmf_sumo.network.blueprint import EdgePlan, LanePlan, LaneRef, LinkKind, LinkPlan
from deepmf_sumo.network.graph import LaneGraph
from deepmf_sumo.network.layout import Group, Layout

JOINT_M: Final = 0.1
"""SUMO's shortest lane. A link between two lanes that touch is drawn on the end of the first."""
POINT_M: Final = 0.01
"""Lanes inside a junction that are shorter than this have no shape of their own."""
WIDTH_M: Final = 3.3
BIKE_WIDTH_M: Final = 1.5
SPEED_MPS: Final = {"freeway": 29.06, "street": 13.89, "unknown": 13.89, "bike": 8.33}
"""Where the limit is unknown: 65 mph, 50 km/h, 30 km/h."""
PRIORITY: Final = {"freeway": 10, "street": 5, "unknown": 5, "bike": 1}
EXTENSION_M: Final = 200.0
"""Beyond the recorded map a vehicle drives on for the longest episode, straight ahead."""


def sumo_id(prefix: str, lane_id: str) -> str:
    """A SUMO id made of a scene's lane id; characters that SUMO refuses become their code."""
    return prefix + re.sub(r"[^0-9A-Za-z]", lambda found: f"_{ord(found[0]):x}_", lane_id)


def lane_speed_mps(lane: Lane) -> float:
    """The lane's limit, or the usual one of its kind."""
    return lane.speed_limit_mps or SPEED_MPS[lane.kind]


def lane_width_m(lane: Lane) -> float:
    """The lane's width, or the usual one of its kind."""
    return lane.width_m or (BIKE_WIDTH_M if lane.kind == "bike" else WIDTH_M)


class Assembly:
    """Edges and links of the scene's lanes, and where each lane begins and ends in SUMO.

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
        """(2) of each junction: amid the lane ends that meet there."""
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
                    shape_m=cutting.part(shape, start * length, end * length),
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
        """Two edges in a row, for SUMO has none that returns to its junction."""
        first, second = sumo_id("e", group[0]), sumo_id("e", group[0]) + "_h"
        self._add_edge(first, (start, f"{first}_m"), self._lane_plans(group, 0.0, 0.5))
        self._add_edge(second, (f"{first}_m", end), self._lane_plans(group, 0.5, 1.0))
        for index in range(len(group)):
            self._add_link((first, index), (second, index), ())

    def _add_link(self, origin: LaneRef, target: LaneRef, path: tuple[str, ...]) -> None:
        """A link, unless there is one already: SUMO has one between two lanes."""
        if (origin, target) in self._linked:
            return
        self._linked.add((origin, target))
        before, after = self.lane(origin), self.lane(target)
        kind: LinkKind = "path"
        if not path and (before.scene_lane, after.scene_lane) in self.graph.gaps:
            kind, shape = "bridge", cutting.bridge(before.shape_m, after.shape_m)
        elif sum(self.graph.lengths_m[lane_id] for lane_id in path) < POINT_M:
            kind, shape = "joint", cutting.tail(before.shape_m, JOINT_M)
        else:
            shape = cutting.joined([self.graph.shapes[lane_id][:, :2] for lane_id in path])
        speed = min(before.speed_mps, after.speed_mps)
        if kind != "joint":
            speed = min(speed, cutting.bend_speed_mps(shape))
        self.links.append(
            LinkPlan(
                origin=origin, target=target, shape_m=shape, path=path, kind=kind, speed_mps=speed
            )
        )

    def _extend(self) -> None:
        """Straight edges behind the lanes at which the recorded map ends."""
        linked = {link.origin for link in self.links}
        for edge in list(self.edges.values()):
            loose = [index for index in range(len(edge.lanes)) if (edge.id, index) not in linked]
            if edge.bike or not loose:
                continue
            directions = [cutting.end_direction(edge.lanes[index].shape_m) for index in loose]
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
