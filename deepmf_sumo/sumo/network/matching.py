"""Matching of recorded motion to lanes, and of lanes to routes that SUMO accepts.

A route with a pair of edges that no connection joins ends the whole simulation, so every pair is
checked, and a route that breaks is cut there.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, SumoNet
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import ground_of, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road
from deepmf_sumo.sumo.network.lane_graph import simplified
from deepmf_sumo.sumo.network.sumo_net import NetFile, NetLink, Way, edge_of, read_once

NEAR_M: Final = 4.0
TURNED_RAD: Final = 1.0
HEADING_WEIGHT_M2: Final = 4.0
"""Cost of a radian squared beside metres squared."""
SPACING_M: Final = 0.5
"""Steps nearer than this to the one before are matched with it."""
STAY, ONWARD, TWICE_ONWARD, BESIDE, ELSEWHERE = 0.0, 0.3, 0.6, 4.0, 60.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """Lane of each step (None: no lane near) and the distance to its centre line (inf there)."""

    lane_ids: tuple[str | None, ...]
    distance_m: Floats


def lane_sequence(
    road: RoadMap,
    position_m: Floats,
    heading_rad: Floats,
    valid: Bools,
    z_m: Floats | None = None,
) -> list[str]:
    """Lanes in the order in which a track uses them, each once in a row.

    Lanes that the track crosses between two steps are filled in. Where the track leaves the lanes
    the sequence goes on with the next lane that it reaches: consecutive lanes need not join.

    Args:
        road: lanes with their joins and neighbours.
        position_m: (T, 2) box centres.
        heading_rad: (T).
        valid: (T) False where there is no pose.
        z_m: (T) heights: where roads cross lanes of the level nearest to them are taken.
    """
    found = [lane for lane in match(road, position_m, heading_rad, valid, z_m).lane_ids if lane]
    sequence = found[:1]
    for before, lane in pairwise(found):
        if lane != before:
            sequence += _between(road, before, lane)
            sequence.append(lane)
    return sequence


def match(
    road: RoadMap,
    position_m: Floats,
    heading_rad: Floats,
    valid: Bools,
    z_m: Floats | None = None,
) -> Match:
    """Lane of each step of a track (T, 2), (T), (T); steps that are not valid have none."""
    index = lane_index(road)
    steps = np.flatnonzero(valid)
    kept = steps[_moved(np.asarray(position_m, float)[steps])]
    heights = None if z_m is None else np.asarray(z_m, float)[kept]
    place, lanes, costs, distances = index.candidates(position_m[kept], heading_rad[kept], heights)
    chosen = index.cheapest(place, lanes, costs)
    lane_ids: list[str | None] = [None] * len(valid)
    distance_m = np.full(len(valid), np.inf)
    if len(kept):
        # A step that was left out has the lane of the last one kept.
        holder = np.searchsorted(kept, steps, side="right") - 1
        rows = np.array([chosen.get(int(item), -1) for item in range(len(kept))], dtype=int)
        for step, row in zip(steps, rows[holder], strict=True):
            if row >= 0:
                lane_ids[step] = index.lane_ids[lanes[row]]
                distance_m[step] = distances[row]
    return Match(lane_ids=tuple(lane_ids), distance_m=distance_m)


def _moved(position_m: Floats) -> Ints:
    """Indices of points (N, 2), each at least SPACING_M from the one before."""
    kept: list[int] = []
    last = (np.inf, np.inf)
    for index, point in enumerate(position_m.tolist()):
        if math.dist(point, last) >= SPACING_M:
            kept.append(index)
            last = point
    return np.array(kept, dtype=np.int64)


def _between(road: RoadMap, before: str, after: str) -> list[str]:
    """The lane that joins two lanes which do not join themselves, if there is one."""
    onward = road.lanes[before].next
    if after in onward:
        return []
    middle = (lane for lane in onward if lane in road.lanes and after in road.lanes[lane].next)
    first = next(middle, None)
    return [first] if first else []


@per_road
def lane_index(road: RoadMap) -> "LaneIndex":
    """The simplified lanes of a road."""
    return LaneIndex(road)


class LaneIndex:
    """The simplified lanes of a road, and the cost of going from lane to lane."""

    def __init__(self, road: RoadMap) -> None:
        shapes = {key: xyz for key, xyz in simplified(road).items() if len(xyz) > 1}
        self.lane_ids = list(shapes)
        self._lanes = road.lanes
        self._costs: dict[int, dict[int, float]] = {}
        self._map = LaneMap.of(
            [road.lanes[key] for key in shapes],
            [xyz[:, :2] for xyz in shapes.values()],
            [xyz[:, 2] for xyz in shapes.values()],
        )
        self._has_levels = ground_of(road).has_levels

    def candidates(
        self, position_m: Floats, heading_rad: Floats, z_m: Floats | None = None
    ) -> tuple[Ints, Ints, Floats, Floats]:
        """Lanes near points (N, 2) and headings (N): point, lane, cost, distance, by point."""
        feet = self._map.feet(position_m, NEAR_M)
        place, lane = feet.point, self._map.lane[feet.segment]
        distance = np.hypot(*feet.away_m.T)
        x, y = self._map.vector_m[feet.segment].T
        turn = np.abs(frames.difference(heading_rad[place], np.arctan2(y, x)))
        cost = distance**2 + HEADING_WEIGHT_M2 * turn**2
        order = np.lexsort((cost, lane, place))
        order = order[(turn[order] <= TURNED_RAD) & (distance[order] <= NEAR_M)]
        if z_m is not None and self._has_levels:
            heights = self._map.heights_m(feet)[order]
            order = order[on_nearest_level(place[order], heights, z_m[place[order]])]
        place, lane, cost, distance = place[order], lane[order], cost[order], distance[order]
        best = np.ones(len(order), dtype=bool)
        best[1:] = (np.diff(place) != 0) | (np.diff(lane) != 0)
        return place[best], lane[best], cost[best], distance[best]

    def cheapest(self, place: Ints, lane: Ints, cost: Floats) -> dict[int, int]:
        """The candidate of each point on the cheapest sequence through all points (Viterbi)."""
        places, begins = np.unique(place, return_index=True)
        if not len(places):
            return {}
        bounds = [*begins.tolist(), len(place)]
        total = cost[bounds[0] : bounds[1]]
        came_from: list[Ints] = []
        for (begin, middle), end in zip(pairwise(bounds[:-1]), bounds[2:], strict=True):
            change = self._changes(lane[begin:middle], lane[middle:end])
            ways = total[:, None] + change
            came_from.append(ways.argmin(axis=0))
            total = ways.min(axis=0) + cost[middle:end]
        row = int(total.argmin())
        chosen = {int(places[-1]): bounds[-2] + row}
        for number in range(len(came_from) - 1, -1, -1):
            row = int(came_from[number][row])
            chosen[int(places[number])] = bounds[number] + row
        return chosen

    def cost(self, before: str, after: str) -> float:
        """Cost of going from a lane to another."""
        row = self._map.row
        return self._costs_from(row[before]).get(row[after], ELSEWHERE)

    def _changes(self, before: Ints, after: Ints) -> Floats:
        """(B, A) cost of going from lane to lane."""
        rows = [self._costs_from(number) for number in before.tolist()]
        columns = after.tolist()
        return np.array([[row.get(number, ELSEWHERE) for number in columns] for row in rows])

    def _costs_from(self, number: int) -> dict[int, float]:
        """Cost of going from a lane to each lane that is near in the graph."""
        if number not in self._costs:
            lanes, row = self._lanes, self._map.row
            lane = lanes[self.lane_ids[number]]
            onward = [key for key in lane.next if key in lanes]
            beside = [item.lane_id for item in (*lane.left, *lane.right)]
            twice = [key for first in onward for key in lanes[first].next]
            costs: dict[int, float] = {}
            ways: Sequence[tuple[Sequence[str], float]] = (
                (beside, BESIDE),
                (twice, TWICE_ONWARD),
                (onward, ONWARD),
                ((lane.id,), STAY),
            )
            for keys, cost in ways:
                costs.update({row[key]: cost for key in keys if key in row})
            self._costs[number] = costs
        return self._costs[number]


MOST_EDGES: Final = 50
"""Length of an extension at most, so that circular ones end."""


def edge_route(net: SumoNet, lane_ids: Sequence[str], extend_m: float = 200.0) -> tuple[str, ...]:
    """SUMO edges along a sequence of scene lanes, and on from there.

    Args:
        net: a converted net.
        lane_ids: from `matching.lane_sequence`.
        extend_m: how far to go on behind the last edge, straight on where that is possible.

    Returns:
        Edges of which each pair is joined by a connection. Cut where the sequence breaks; empty
        where no lane of the sequence is in the net.
    """
    joins = _joins(net.file)
    stages = [_Stage(_edges_of(net, lane_id), _inner(net, lane_id)) for lane_id in lane_ids]
    route: list[str] = []
    whole = True
    for number, stage in enumerate(stages):
        if stage.edges:
            onward = joins.along(route, stage.edges)
        elif number and not stages[number - 1].edges and route:
            continue  # the path over the lane before was chosen to lead over this one, too
        else:
            onward = joins.across(route, stages[number:])
        if onward is None:
            whole = False
            break
        route += onward
    if route:
        last = _last_lane(net, lane_ids, route[-1]) if whole else None
        route += joins.extension(route[-1], last, extend_m)
    return tuple(route)


class _Stage(NamedTuple):
    """A lane of the sequence: its edges, and its lanes inside junctions."""

    edges: list[str]
    inner: list[str]


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
        self._around: dict[str, list[Way]] = defaultdict(list)
        self._after: dict[str, set[str]] = defaultdict(set)
        self._length_m = {
            edge.id: max(lane.length_m for lane in edge.lanes)
            for edge in net.edges.values()
            if edge.lanes
        }
        onward = {link.origin: link.via for link in net.links if link.starts_inside}
        for link in net.links:
            if link.starts_inside:
                continue
            before, after = link.edges
            self._after[before].add(after)
            self._links[before].append(link)
            via = link.via
            while via:
                self._around[via].append(link.edges)
                via = onward.get(via, "")

    def along(self, route: list[str], edges: list[str]) -> list[str] | None:
        """What a lane on edges adds to a route; None where it does not join on."""
        added = [edge for edge in edges if edge not in route[-1:]]
        fits = all(two in self._after[one] for one, two in pairwise([*route[-1:], *added]))
        return added if fits else None

    def across(self, route: list[str], stages: list[_Stage]) -> list[str] | None:
        """What a lane inside a junction adds: the edges before and behind it.

        Several paths may share the lane. The chosen one also leads over the lanes that follow in
        the sequence, and to the edge behind them.
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
        """Edges behind an edge, until they have the length or the net ends."""
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
