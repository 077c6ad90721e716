"""Layout of the network to build: parallel lanes become one edge, their ends junctions."""

from collections.abc import Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import Floats
from deepmf_sumo.sumo.network.lane_graph import LaneGraph, crossings
from deepmf_sumo.sumo.network.movements import (
    JunctionMovement,
    TooManyMovementsError,
    inner_lanes,
    lanes_to_pin,
    movements,
)

AHEAD_M: Final = 6.0
"""Largest longitudinal distance of the ends of two lanes of an edge."""
BESIDE_M: Final = (1.5, 7.0)
"""Range of their lateral distance."""
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
    """Mean lateral distance of two lanes that fit into one edge; None if they do not."""
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


Group = tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """The plan of the network, before it has shapes.

    Attributes:
        groups: lanes of each edge, from right to left.
        movements: through junctions.
        starts, ends: junction at either end of each group.
        halved: groups that start and end at one junction: they become two successive edges, because
            SUMO has no edge from a junction to itself.
        inside: lanes inside junctions.
    """

    groups: list[Group]
    movements: list[JunctionMovement]
    starts: list[int]
    ends: list[int]
    halved: frozenset[Group]
    inside: frozenset[str]


def layout(graph: LaneGraph, signalled: Set[str]) -> Layout:
    """Assign the lanes to edges and junctions.

    An edge with both ends at one junction moves inside it, if possible; that may join further
    junctions, so this is repeated until nothing changes. It terminates: each round moves a lane
    inside for the first time, or pins one as an edge. Raises ConversionError if lanes of a single
    point alone make more movements than a junction may have.
    """
    crossing = crossings(graph.shapes)
    # A bridge across a gap is not in the scene: the lanes at its ends stay separate, as edges.
    pinned = {lane_id for pair in graph.gaps for lane_id in pair}
    inside = inner_lanes(graph, crossing, signalled) - pinned
    while True:
        try:
            found = movements(graph, inside)
            to_pin = lanes_to_pin(graph, inside, found) - pinned
        except TooManyMovementsError as error:
            to_pin = set(error.busiest)
            if not to_pin:  # points alone, which cannot be edges
                raise ConversionError(f"The junctions of the scene have {error}.") from None
        if to_pin:
            pinned |= to_pin
            inside -= to_pin
            continue
        outside = {key for key in graph.shapes if key not in inside and not graph.is_point(key)}
        groups = parallel_groups(graph, outside)
        found = [way for way in found if way.origin in outside and way.target in outside]
        starts, ends = _junctions(groups, found, crossing, inside)
        loops = [group for group, a, b in zip(groups, starts, ends, strict=True) if a == b]
        movable = {
            lane_id
            for group in loops
            for lane_id in group
            if lane_id not in pinned and graph.following[lane_id] and graph.preceding[lane_id]
        }
        if not movable:
            break
        inside |= movable
    return Layout(
        groups=groups,
        movements=found,
        starts=starts,
        ends=ends,
        halved=frozenset(loops),
        inside=frozenset(inside),
    )


def _junctions(
    groups: list[Group],
    found: list[JunctionMovement],
    crossing: list[tuple[str, str]],
    inside: Set[str],
) -> tuple[list[int], list[int]]:
    """Numbers of the junctions at the start and the end of each group, in the order of groups."""
    from scipy.sparse import coo_array  # 0.4 s that only conversion needs
    from scipy.sparse.csgraph import connected_components

    group_of = {lane_id: index for index, group in enumerate(groups) for lane_id in group}
    # Of group i the start is 2i and the end 2i + 1; lanes inside junctions follow.
    inner = {lane_id: number for number, lane_id in enumerate(inside, start=2 * len(groups))}
    meet = [(inner[one], inner[two]) for one, two in crossing if one in inside and two in inside]
    for way in found:
        end = 2 * group_of[way.origin] + 1
        meet += [(end, 2 * group_of[way.target]), *((end, inner[lane_id]) for lane_id in way.path)]
    one, two = np.array(meet, int).reshape(-1, 2).T
    size = 2 * len(groups) + len(inner)
    joins = coo_array((np.ones(len(one), bool), (one, two)), (size, size))
    _, junction = connected_components(joins, directed=False)
    order: dict[int, int] = {}
    numbers = [order.setdefault(key, len(order)) for key in junction[: 2 * len(groups)].tolist()]
    return numbers[::2], numbers[1::2]
