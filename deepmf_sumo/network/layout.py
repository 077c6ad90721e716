"""Which lanes are edges, which lie inside junctions, and which ends meet in which junction."""

from collections.abc import Hashable, Set
from dataclasses import dataclass

from deepmf_sumo.network.crossings import crossings
from deepmf_sumo.network.graph import LaneGraph
from deepmf_sumo.network.movements import Movement, inner_lanes, lanes_to_pin, movements
from deepmf_sumo.network.parallel import parallel_groups

Group = tuple[str, ...]


class Partition:
    """Disjoint sets that grow together."""

    def __init__(self) -> None:
        self._above: dict[Hashable, Hashable] = {}

    def find(self, item: Hashable) -> Hashable:
        """The representative of the item's set."""
        above = self._above
        above.setdefault(item, item)
        while above[item] != item:
            above[item] = above[above[item]]
            item = above[item]
        return item

    def join(self, one: Hashable, two: Hashable) -> None:
        """Make one set of two."""
        self._above[self.find(two)] = self.find(one)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """The plan of the network, before it has shapes.

    Attributes:
        groups: lanes of each edge, from right to left.
        movements: ways through junctions.
        starts, ends: junction at either end of each group.
        halved: groups that begin and end in one junction: they become two edges in a row, because
            SUMO has no edge from a junction to itself.
        inside: lanes inside junctions.
    """

    groups: list[Group]
    movements: list[Movement]
    starts: list[int]
    ends: list[int]
    halved: frozenset[Group]
    inside: frozenset[str]


def layout(graph: LaneGraph, signalled: Set[str]) -> Layout:
    """Distribute the lanes.

    An edge whose two ends fall into one junction goes inside it, if it can; that may join further
    junctions, so this is repeated until nothing changes. Each round moves a lane in for the first
    time, pins one as an edge, or halves a group: it ends.
    """
    crossing = crossings(graph.shapes)
    # The way across a gap is not the scene's: the lanes at its ends stay apart from it, as edges.
    pinned = {lane_id for pair in graph.gaps for lane_id in pair}
    inside = inner_lanes(graph, crossing, signalled) - pinned
    while True:
        found = movements(graph, inside)
        to_pin = lanes_to_pin(graph, inside, found) - pinned
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
    found: list[Movement],
    crossing: list[tuple[str, str]],
    inside: Set[str],
) -> tuple[list[int], list[int]]:
    """Numbers of the junctions at the start and the end of each group."""
    group_of = {lane_id: index for index, group in enumerate(groups) for lane_id in group}
    meet = Partition()
    for way in found:
        end = ("end", group_of[way.origin])
        meet.join(end, ("start", group_of[way.target]))
        for lane_id in way.path:
            meet.join(end, ("inside", lane_id))
    for one, two in crossing:
        if one in inside and two in inside:
            meet.join(("inside", one), ("inside", two))
    number: dict[Hashable, int] = {}
    starts: list[int] = []
    ends: list[int] = []
    for index in range(len(groups)):
        for side, numbers in (("start", starts), ("end", ends)):
            root = meet.find((side, index))
            numbers.append(number.setdefault(root, len(number)))
    return starts, ends
