"""Parallel lanes as the lanes of one edge."""

from collections.abc import Set
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.network.graph import LaneGraph

AHEAD_M: Final = 6.0
"""How far the ends of two lanes of an edge may be apart lengthways."""
BESIDE_M: Final = (1.5, 7.0)
"""How far they may be apart sideways."""
LENGTH_DIFFERENCE: Final = 0.1
LENGTH_DIFFERENCE_M: Final = 3.0


def parallel_groups(graph: LaneGraph, lane_ids: Set[str]) -> list[tuple[str, ...]]:
    """The given lanes in groups, each from right to left, in the scene's order."""
    offers = [
        (offset, lane_id, neighbour.lane_id)
        for lane_id in graph.shapes
        if lane_id in lane_ids
        for neighbour in graph.lanes[lane_id].right
        if neighbour.lane_id in lane_ids
        and (offset := _side_by_side(graph, lane_id, neighbour.lane_id)) is not None
    ]
    right_of: dict[str, str] = {}
    left_of: dict[str, str] = {}
    for _, lane_id, right in sorted(offers):
        if lane_id not in right_of and right not in left_of:
            right_of[lane_id], left_of[right] = right, lane_id
    groups = []
    for lane_id in graph.shapes:
        if lane_id in lane_ids and lane_id not in right_of:
            group = [lane_id]
            while group[-1] in left_of:
                group.append(left_of[group[-1]])
            groups.append(tuple(group))
    return groups


def _side_by_side(graph: LaneGraph, lane_id: str, right: str) -> float | None:
    """Mean sideways distance of two lanes that fit into one edge; None where they do not."""
    here, there = graph.lanes[lane_id], graph.lanes[right]
    if lane_id == right or (here.kind == "bike") != (there.kind == "bike"):
        return None
    longer = max(graph.lengths_m[lane_id], graph.lengths_m[right])
    unequal = abs(graph.lengths_m[lane_id] - graph.lengths_m[right])
    if unequal > max(LENGTH_DIFFERENCE_M, LENGTH_DIFFERENCE * longer):
        return None
    mine, other = graph.shapes[lane_id][:, :2], graph.shapes[right][:, :2]
    beside = []
    for end, inner in ((0, 1), (-1, -2)):
        direction = (mine[inner] - mine[end]) * (1 if end == 0 else -1)
        ahead, left = _in_frame(other[end] - mine[end], direction)
        if abs(ahead) > AHEAD_M or not BESIDE_M[0] <= -left <= BESIDE_M[1]:
            return None
        beside.append(-left)
    return float(np.mean(beside))


def _in_frame(offset: Floats, direction: Floats) -> tuple[float, float]:
    """An offset along a direction and to its left."""
    x, y = direction / max(float(np.hypot(*direction)), 1e-9)
    return float(offset[0] * x + offset[1] * y), float(offset[1] * x - offset[0] * y)
