"""Which lanes lie inside junctions, and the ways through them.

A lane that only joins two others, or that crosses another near a split or a merge, becomes part of
a junction: SUMO knows right of way only between the lanes inside one. A *movement* is one way
through: from a lane of an edge, over lanes inside, to a lane of an edge.
"""

from collections import defaultdict
from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import Final

from deepmf_sumo.network.graph import LaneGraph

CROSSING_LANE_M: Final = 40.0
JOINING_LANE_M: Final = 30.0
SIGNAL_LANE_M: Final = 60.0
MOST_MOVEMENTS: Final = 3000


@dataclass(frozen=True, slots=True)
class Movement:
    """A way through a junction; ``path`` holds the lanes inside it, in driving order."""

    origin: str
    path: tuple[str, ...]
    target: str


def inner_lanes(
    graph: LaneGraph, crossing: Iterable[tuple[str, str]], signalled: Set[str]
) -> set[str]:
    """Lanes to begin with as the inside of junctions."""
    crosses = {lane_id for pair in crossing for lane_id in pair}
    approaches = {before for lane_id in signalled for before in graph.preceding.get(lane_id, ())}
    inside = set()
    for lane_id in graph.shapes:
        if not (graph.following[lane_id] and graph.preceding[lane_id]):
            continue
        # A light stands where its lane begins: what leads to it is an edge.
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


def movements(graph: LaneGraph, inside: Set[str]) -> list[Movement]:
    """All ways from edge lane to edge lane over lanes inside, in the scene's order."""
    found: list[Movement] = []
    for origin in graph.shapes:
        if origin in inside:
            continue
        todo = [((), after) for after in reversed(graph.following[origin])]
        stack: list[tuple[tuple[str, ...], str]] = list(todo)
        while stack:
            path, lane_id = stack.pop()
            if lane_id not in inside:
                found.append(Movement(origin, path, lane_id))
            elif lane_id not in path:
                stack += [((*path, lane_id), after) for after in reversed(graph.following[lane_id])]
    return found


def lanes_to_pin(graph: LaneGraph, inside: Set[str], found: list[Movement]) -> set[str]:
    """Lanes that have to be edges after all.

    They are on no movement; or on the second of two movements between the same two lanes, of which
    SUMO has but one; or so many movements lead over them that junctions would not end.
    """
    used = {lane_id for movement in found for lane_id in movement.path}
    pinned = {lane_id for lane_id in inside - used if not graph.is_point(lane_id)}
    by_ends: dict[tuple[str, str], list[Movement]] = defaultdict(list)
    for movement in found:
        by_ends[movement.origin, movement.target].append(movement)
    for same in by_ends.values():
        for other in same[1:]:
            only = set(other.path) ^ set(same[0].path)
            pinned |= _longest(graph, only)
    if len(found) > MOST_MOVEMENTS:
        count: dict[str, int] = defaultdict(int)
        for movement in found:
            for lane_id in movement.path:
                count[lane_id] += not graph.is_point(lane_id)
        pinned.add(max(count, key=lambda lane_id: count[lane_id]))
    return pinned


def _longest(graph: LaneGraph, lane_ids: set[str]) -> set[str]:
    """The longest of some lanes, the first by id among equals; none of none."""
    drivable = sorted(lane_id for lane_id in lane_ids if not graph.is_point(lane_id))
    return {max(drivable, key=lambda lane_id: graph.lengths_m[lane_id])} if drivable else set()
