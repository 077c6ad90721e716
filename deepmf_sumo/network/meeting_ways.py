"""Which ways through the junctions of a SUMO network meet."""

import itertools
from collections import defaultdict
from collections.abc import Iterable

import numpy as np
import shapely

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.network.net_file import NetFile, NetLink

Way = tuple[str, str]
"""The edge before a junction and the one behind it."""


def meeting_ways(net: NetFile, ways: Iterable[Way]) -> frozenset[tuple[Way, Way]]:
    """Of the ways those pairs, in both orders, that come from two edges and cross or end on one.

    Judged by the lines along the middle of the lanes, for junctions without a rule (`unregulated`)
    have no ``<request>`` that would name foes. In a network without lanes inside its junctions the
    lines are straight. Ways that the network has no connection for meet nobody.
    """
    links: dict[Way, list[NetLink]] = defaultdict(list)
    inside: dict[str, NetLink] = {}
    for link in net.links:
        if link.origin.startswith(":"):
            inside[link.origin] = link
        else:
            links[_edge(link.origin), _edge(link.target)].append(link)
    at: dict[str, list[Way]] = defaultdict(list)
    lines = {}
    for way in sorted(set(ways)):
        if way in links:
            at[net.edges[way[0]].end].append(way)
            drawn = [_line(net, inside, link) for link in links[way]]
            lines[way] = shapely.MultiLineString([shapely.LineString(one) for one in drawn])
    candidates = [
        (one, two)
        for met in at.values()
        for one, two in itertools.combinations(met, 2)
        if one[0] != two[0]
    ]
    first, second = ([lines[pair[side]] for pair in candidates] for side in (0, 1))
    cross = shapely.intersects(np.array(first, object), np.array(second, object))
    return frozenset(
        both
        for (one, two), crosses in zip(candidates, cross, strict=True)
        if crosses or one[1] == two[1]
        for both in ((one, two), (two, one))
    )


def waiting_ways(net: NetFile) -> frozenset[Way]:
    """Those with a place to wait inside the junction: two lanes there follow each other."""
    onward = {link.origin: link for link in net.links if link.origin.startswith(":")}
    return frozenset(
        (_edge(link.origin), _edge(link.target))
        for link in net.links
        if not link.origin.startswith(":") and link.via in onward and onward[link.via].via
    )


def junctions(net: NetFile) -> dict[str, str]:
    """Where vehicles of several edges come together, by the edges that lead there.

    An edge to another end counts to the junction that it comes from; left out is who does neither.
    """
    approaches: dict[str, set[str]] = defaultdict(set)
    for link in (link for link in net.links if not link.origin.startswith(":")):
        approaches[net.edges[_edge(link.origin)].end].add(_edge(link.origin))
    return {
        edge.id: node
        for edge in net.edges.values()
        for node in (edge.start, edge.end)
        if not edge.function and len(approaches.get(node, ())) > 1
    }


def _line(net: NetFile, inside: dict[str, NetLink], link: NetLink) -> Floats:
    """(P, 2) from the end of the lane before the junction to the beginning of the one behind."""
    parts = [_shape(net, link.origin)[-1:]]
    lane, seen = link.via, set[str]()
    while lane and lane not in seen:
        seen.add(lane)
        parts.append(_shape(net, lane))
        lane = inside[lane].via if lane in inside else ""
    parts.append(_shape(net, link.target)[:1])
    return np.concatenate(parts)


def _shape(net: NetFile, lane: str) -> Floats:
    return next(one.shape_m for one in net.edges[_edge(lane)].lanes if one.id == lane)[:, :2]


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]
