"""From lanes to SUMO routes that SUMO accepts.

A route with a pair of edges that no connection joins ends the whole simulation, so every pair is
checked, and a route that breaks is cut there.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from deepmf_sumo.datatypes import SumoNet
from deepmf_sumo.network.net_file import NetFile, NetLink, read_once

MOST_EDGES: Final = 50
"""An extension that goes round in circles ends here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeRoute:
    """A route, and where the lane sequence could not be followed.

    Attributes:
        edges: SUMO edges; empty where no lane of the sequence is in the net.
        broken_at: the first lane of the sequence that the route does not reach, or None.
    """

    edges: tuple[str, ...]
    broken_at: str | None = None


def edge_route(net: SumoNet, lane_ids: Sequence[str], extend_m: float = 200.0) -> tuple[str, ...]:
    """SUMO edges along a sequence of scene lanes, and on from there.

    Args:
        net: a converted net.
        lane_ids: from `matching.lane_sequence`.
        extend_m: how far to go on behind the last edge, straight on where that is possible.

    Returns:
        Edges of which each pair is joined by a connection. Cut where the sequence breaks (see
        `checked_route`); empty where no lane of the sequence is in the net.
    """
    return checked_route(net, lane_ids, extend_m).edges


def checked_route(net: SumoNet, lane_ids: Sequence[str], extend_m: float = 200.0) -> EdgeRoute:
    """As `edge_route`, and where the sequence had to be cut."""
    joins = _joins(net.file)
    stages = [
        _Stage(_edges_of(net, lane_id), _inner(net, lane_id), lane_id) for lane_id in lane_ids
    ]
    route: list[str] = []
    broken_at = None
    for number, stage in enumerate(stages):
        if stage.edges:
            onward = joins.along(route, stage.edges)
        elif number and not stages[number - 1].edges and route:
            continue  # the way over the lane before was chosen to lead over this one too
        else:
            onward = joins.across(route, stages[number:])
        if onward is None:
            broken_at = stage.lane_id
            break
        route += onward
    if route:
        last = None if broken_at else _last_lane(net, lane_ids, route[-1])
        route += joins.extension(route[-1], last, extend_m)
    return EdgeRoute(edges=tuple(route), broken_at=broken_at)


def start_lane(net: SumoNet, lane_ids: Sequence[str]) -> str | None:
    """SUMO lane on which a vehicle with this sequence begins; None where it begins on none."""
    pieces = net.pieces.get(lane_ids[0], ()) if lane_ids else ()
    return pieces[0].sumo_lane if pieces else None


def edge_of(sumo_lane: str) -> str:
    """The edge of a SUMO lane."""
    return sumo_lane.rpartition("_")[0]


class _Stage(NamedTuple):
    """A lane of the sequence: its edges, and its lanes inside junctions."""

    edges: list[str]
    inner: list[str]
    lane_id: str


def _edges_of(net: SumoNet, lane_id: str) -> list[str]:
    """Normal edges of a lane, in driving order."""
    lanes = [piece.sumo_lane for piece in net.pieces.get(lane_id, ())]
    return list(dict.fromkeys(edge_of(lane) for lane in lanes if not lane.startswith(":")))


def _inner(net: SumoNet, lane_id: str) -> list[str]:
    """Lanes inside junctions that a scene's lane is part of."""
    pieces = net.pieces.get(lane_id, ())
    return [piece.sumo_lane for piece in pieces if piece.sumo_lane.startswith(":")]


def _last_lane(net: SumoNet, lane_ids: Sequence[str], edge: str) -> str | None:
    """The lane of an edge on which the sequence ends, if it does."""
    pieces = net.pieces.get(lane_ids[-1], ())
    return next((piece.sumo_lane for piece in pieces if edge_of(piece.sumo_lane) == edge), None)


class _Joins:
    """How a net's edges follow each other."""

    def __init__(self, net: NetFile) -> None:
        self._links: dict[str, list[NetLink]] = defaultdict(list)
        self._around: dict[str, list[tuple[str, str]]] = defaultdict(list)
        self._after: dict[str, set[str]] = defaultdict(set)
        self._length_m = {
            edge.id: max(lane.length_m for lane in edge.lanes)
            for edge in net.edges.values()
            if edge.lanes
        }
        onward = {link.origin: link.via for link in net.links if link.origin.startswith(":")}
        for link in net.links:
            if link.origin.startswith(":"):
                continue
            ends = edge_of(link.origin), edge_of(link.target)
            self._after[ends[0]].add(ends[1])
            self._links[ends[0]].append(link)
            via = link.via
            while via:
                self._around[via].append(ends)
                via = onward.get(via, "")

    def along(self, route: list[str], edges: list[str]) -> list[str] | None:
        """What a lane on edges adds to a route; None where it does not join on."""
        added = [edge for edge in edges if edge not in route[-1:]]
        fits = all(two in self._after[one] for one, two in pairwise([*route[-1:], *added]))
        return added if fits else None

    def across(self, route: list[str], stages: list[_Stage]) -> list[str] | None:
        """What a lane inside a junction adds: the edges before and behind it.

        Several ways may share the lane. Taken is one that leads over the lanes which follow in the
        sequence too, and to the edge behind them.
        """
        ways = [way for lane in stages[0].inner for way in self._around[lane]]
        if route:
            ways = [way for way in ways if way[0] == route[-1]]
        for stage in stages[1:]:
            if stage.edges:
                ways = [way for way in ways if way[1] == stage.edges[0]] or ways
                break
            over = {way for lane in stage.inner for way in self._around[lane]}
            ways = [way for way in ways if way in over] or ways
        if not ways:
            return None
        return [edge for edge in ways[0] if edge not in route[-1:]]

    def extension(self, edge: str, lane: str | None, length_m: float) -> list[str]:
        """Edges behind an edge, until they are as long as asked or the net ends."""
        added: list[str] = []
        seen = {edge}
        while length_m > 0 and len(added) < MOST_EDGES:
            links = [link for link in self._links[edge] if lane in (None, link.origin)]
            links = [link for link in links if edge_of(link.target) not in seen]
            if not links:
                break
            straight = [link for link in links if link.direction == "s"]
            link = (straight or links)[0]
            edge, lane = edge_of(link.target), link.target
            seen.add(edge)
            added.append(edge)
            length_m -= self._length_m[edge]
        return added


def _joins(file: Path) -> _Joins:
    return _joins_of(read_once(file))


@lru_cache(maxsize=4)
def _joins_of(net: NetFile) -> _Joins:
    return _Joins(net)
