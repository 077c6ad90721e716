"""Layout of the network to build: parallel lanes become one edge, their ends junctions.

A lane that only joins two others, or that crosses another near a split or a merge, becomes part of
a junction: SUMO knows right of way only between the lanes inside one. A *movement* leads
from a lane of an edge, over lanes inside, to a lane of an edge.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import Floats
from deepmf_sumo.sumo.network.lane_graph import LaneGraph, crossings


@dataclass(frozen=True, slots=True)
class JunctionMovement:
    """A movement through a junction; ``path``: the lanes inside it, in driving order."""

    origin: str
    path: tuple[str, ...]
    target: str


def inner_lanes(
    graph: LaneGraph, crossing: Iterable[tuple[str, str]], signalled: Set[str]
) -> set[str]:
    """First estimate of the lanes inside junctions."""
    crosses = {lane_id for pair in crossing for lane_id in pair}
    approaches = {before for lane_id in signalled for before in graph.preceding.get(lane_id, ())}
    inside = set()
    for lane_id in graph.shapes:
        if not (graph.following[lane_id] and graph.preceding[lane_id]):
            continue
        # A light stands at the start of its lane: the lane before it is an edge.
        joins = _joins(graph, lane_id, lane_id in crosses, lane_id in signalled)
        if graph.is_point(lane_id) or (joins and lane_id not in approaches):
            inside.add(lane_id)
    return inside


def _joins(graph: LaneGraph, lane_id: str, crosses: bool, signalled: bool) -> bool:
    length = graph.lengths_m[lane_id]
    splits = any(len(graph.following[before]) > 1 for before in graph.preceding[lane_id])
    merges = any(len(graph.preceding[after]) > 1 for after in graph.following[lane_id])
    return (
        graph.lanes[lane_id].interpolating
        or (crosses and (splits or merges or length < CROSSING_LANE_M))
        or ((splits or merges) and length < JOINING_LANE_M)
        or (signalled and length < SIGNAL_LANE_M)
    )


class TooManyMovementsError(Exception):
    """There are more than `MOST_MOVEMENTS`, or no end of them; without ``busiest`` are fewer."""

    def __init__(self, busiest: Set[str]) -> None:
        super().__init__(f"more than {MOST_MOVEMENTS} movements")
        self.busiest = busiest


def movements(graph: LaneGraph, inside: Set[str]) -> list[JunctionMovement]:
    """All movements from edge lane to edge lane over lanes inside, in the scene's order.

    Raises TooManyMovementsError. Their number can double with every other lane, so they are counted
    before they are listed; those that go round a circle are counted while they are.
    """
    counts = _counted(graph, inside)
    if counts.total > MOST_MOVEMENTS:
        raise TooManyMovementsError(_busiest(graph, counts.over))
    found: list[JunctionMovement] = []
    tried: dict[str, float] = defaultdict(float)
    left = MOST_STEPS
    for origin in _outside(graph, inside):
        stack: list[tuple[tuple[str, ...], str]] = [
            ((), after) for after in reversed(graph.following[origin])
        ]
        while stack:
            path, lane_id = stack.pop()
            left -= 1
            if lane_id not in inside:
                found.append(JunctionMovement(origin, path, lane_id))
            elif lane_id not in path:
                tried[lane_id] += 1
                stack += [((*path, lane_id), after) for after in reversed(graph.following[lane_id])]
            if len(found) > MOST_MOVEMENTS or not left:
                raise TooManyMovementsError(_busiest(graph, tried))
    return found


@dataclass(frozen=True, slots=True)
class _Counts:
    """Number of movements without circles, in all and ``over`` each lane inside."""

    total: float
    over: dict[str, float]


def _outside(graph: LaneGraph, inside: Set[str]) -> Iterator[str]:
    return (lane_id for lane_id in graph.shapes if lane_id not in inside)


def _counted(graph: LaneGraph, inside: Set[str]) -> _Counts:
    """The movements, counted without a list of them."""
    order = _driving_order(graph, inside)
    rank = {lane_id: number for number, lane_id in enumerate(order)}
    ahead = {
        lane_id: [
            after for after in graph.following[lane_id] if rank.get(after, -1) > rank[lane_id]
        ]
        for lane_id in order
    }
    out: dict[str, float] = {}
    for lane_id in reversed(order):
        at_once = sum(after not in inside for after in graph.following[lane_id])
        out[lane_id] = min(at_once + sum(out[after] for after in ahead[lane_id]), _MANY)
    entered: dict[str, float] = dict.fromkeys(order, 0.0)
    total = 0.0
    for origin in _outside(graph, inside):
        for after in graph.following[origin]:
            total += out.get(after, 1.0)
            if after in entered:
                entered[after] += 1
    for lane_id in order:
        for after in ahead[lane_id]:
            entered[after] = min(entered[after] + entered[lane_id], _MANY)
    return _Counts(total, {lane_id: entered[lane_id] * out[lane_id] for lane_id in order})


def _driving_order(graph: LaneGraph, inside: Set[str]) -> list[str]:
    """The lanes inside that can be reached, each before those that follow it, except in circles."""
    done: list[str] = []
    known: set[str] = set()
    for origin in _outside(graph, inside):
        stack = [(after, False) for after in reversed(graph.following[origin])]
        while stack:
            lane_id, is_done = stack.pop()
            if is_done:
                done.append(lane_id)
            elif lane_id in inside and lane_id not in known:
                known.add(lane_id)
                stack.append((lane_id, True))
                stack += [(after, False) for after in reversed(graph.following[lane_id])]
    return done[::-1]


def _busiest(graph: LaneGraph, count: Mapping[str, float]) -> set[str]:
    """The lane with most movements; of many lanes, the one in a hundred with most.

    Points are left out, since they cannot be edges.
    """
    lanes = [lane_id for lane_id in count if not graph.is_point(lane_id)]
    lanes.sort(key=lambda lane_id: -count[lane_id])
    return set(lanes[: 1 + len(lanes) // 100])


def lanes_to_pin(graph: LaneGraph, inside: Set[str], found: list[JunctionMovement]) -> set[str]:
    """Lanes inside junctions that have to be edges.

    They are on no movement; or on the second of two movements between the same two lanes, of which
    SUMO has only one.
    """
    used = {lane_id for movement in found for lane_id in movement.path}
    pinned = {lane_id for lane_id in inside - used if not graph.is_point(lane_id)}
    by_ends: dict[tuple[str, str], list[JunctionMovement]] = defaultdict(list)
    for movement in found:
        by_ends[movement.origin, movement.target].append(movement)
    for same in by_ends.values():
        for other in same[1:]:
            only = set(other.path) ^ set(same[0].path)
            pinned |= _longest(graph, only)
    return pinned


def _longest(graph: LaneGraph, lane_ids: set[str]) -> set[str]:
    """The longest of some lanes, the first by id among equals; none of none."""
    drivable = sorted(lane_id for lane_id in lane_ids if not graph.is_point(lane_id))
    return {max(drivable, key=lambda lane_id: graph.lengths_m[lane_id])} if drivable else set()


AHEAD_M: Final = 6.0
"""Largest longitudinal distance of the ends of two lanes of an edge."""
BESIDE_M: Final = (1.5, 7.0)
"""Range of their lateral distance."""
LENGTH_DIFFERENCE: Final = 0.1
LENGTH_DIFFERENCE_M: Final = 3.0
CROSSING_LANE_M: Final = 40.0
JOINING_LANE_M: Final = 30.0
SIGNAL_LANE_M: Final = 60.0
MOST_MOVEMENTS: Final = 3000
"""In all junctions of a scene; recorded scenes have about 450 at most."""
MOST_STEPS: Final = 300_000
"""Lanes that are looked at for them."""
_MANY: Final = 1e15
"""Counts end here, before they overflow."""


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
