"""Links between lanes for formats without them: successors and neighbours, from the geometry.

Lanes that the checks refuse for their points get none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import shapely

from deepmf_sumo.scene import Floats, Ints, Lane, Neighbour
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.readers.raw.repair import is_placed

HEIGHT_GAP_M: Final = 1.5
END_GAP_M: Final = 0.3
SUCCESSOR_TURN_RAD: Final = 0.8
DIRECTION_OVER_M: Final = 1.0
"""Length over which a lane's direction at its end is taken: single segments can be noise."""
NEAREST_M: Final = 2.0
FARTHEST_M: Final = 5.5
"""Between the centre lines of two lanes side by side; lanes are 2.5 to 4.5 m wide."""
AHEAD_M: Final = 1.0
"""How far ahead or behind the nearest point of the other lane may lie: lanes overlap lengthwise."""
NEIGHBOUR_TURN_RAD: Final = 0.25
SHORTEST_M: Final = 8.0
"""Shorter parallel pieces are the ends of lanes that diverge or merge,"""
MOST_OF_A_LANE: Final = 0.8
"""unless they are at least this share of one of the two lanes."""
GAP_POINTS: Final = 6
"""Pieces that are interrupted by fewer points of noise are one."""


@dataclass(frozen=True)
class Beside:
    """Neighbours by lane id."""

    left: dict[str, list[Neighbour]] = field(default_factory=dict)
    right: dict[str, list[Neighbour]] = field(default_factory=dict)


@dataclass(frozen=True)
class _LanePoints:
    """All points of all lanes, (N) each: position, heading, lane, index on it, its last index."""

    xy: Floats
    z: Floats
    heading: Floats
    lane: Ints
    index: Ints
    last: Ints


def linked(lanes: Sequence[Lane]) -> dict[str, Lane]:
    """The lanes by id, with inferred ``next``, ``previous``, ``left`` and ``right``."""
    follows: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    precedes: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    for before, after in connections(lanes):
        follows[before].append(after)
        precedes[after].append(before)
    beside = neighbours(lanes)
    return {
        lane.id: replace(
            lane,
            next=tuple(follows[lane.id]),
            previous=tuple(precedes[lane.id]),
            left=tuple(beside.left.get(lane.id, ())),
            right=tuple(beside.right.get(lane.id, ())),
        )
        for lane in lanes
    }


def connections(lanes: Sequence[Lane]) -> list[tuple[str, str]]:
    """Pairs (lane, lane that follows), in the order of ``lanes``.

    A lane follows another if it starts at most 0.3 m from the other's end, at most 1.5 m higher or
    lower, in a direction that differs by less than 0.8 rad. Bike lanes follow bike lanes only. A
    lane with a single point has no direction and matches any.
    """
    usable = [lane for lane in lanes if len(lane.centre_m) and is_placed(lane)]
    if not usable:
        return []
    start = np.array([lane.centre_m[0] for lane in usable])
    end = np.array([lane.centre_m[-1] for lane in usable])
    rise = np.array([lane.z_m[0] for lane in usable]) - np.array(
        [[lane.z_m[-1]] for lane in usable]
    )
    away = start[None] - end[:, None]
    heading_in = np.array([_heading(lane.centre_m, at_end=True) for lane in usable])
    heading_out = np.array([_heading(lane.centre_m, at_end=False) for lane in usable])
    turn = frames.difference(heading_out[None], heading_in[:, None])
    bike = np.array([lane.kind == "bike" for lane in usable])
    follows = (
        (np.hypot(away[..., 0], away[..., 1]) <= END_GAP_M)
        & (np.abs(rise) <= HEIGHT_GAP_M)
        & ~(np.abs(turn) >= SUCCESSOR_TURN_RAD)
        & (bike[:, None] == bike[None])
        & ~np.eye(len(usable), dtype=bool)
    )
    return [(usable[row].id, usable[column].id) for row, column in np.argwhere(follows)]


def _heading(points_m: Floats, *, at_end: bool) -> float:
    """Direction over the last (or first) metre; NaN if all points coincide."""
    points = points_m[::-1] if at_end else points_m
    distance = np.hypot(*(points - points[0]).T)
    far = np.flatnonzero(distance >= DIRECTION_OVER_M)
    other = int(far[0]) if len(far) else int(distance.argmax())
    if distance[other] < 1e-3:
        return float("nan")
    step = points[0] - points[other] if at_end else points[other] - points[0]
    return float(np.arctan2(step[1], step[0]))


def neighbours(lanes: Sequence[Lane]) -> Beside:
    """Neighbours in the same direction.

    A point lies beside another lane if that lane's nearest point is 2 to 5.5 m to its side, has the
    same heading within 0.25 rad, is at most 1.5 m higher or lower, and no other lane lies between.
    Pieces of at least 8 m count, and shorter ones that are most of a lane. Bike lanes are
    neighbours of bike lanes only.
    """
    usable = [lane for lane in lanes if len(lane.centre_m) > 1 and is_placed(lane)]
    found = Beside()
    if len(usable) < 2:
        return found
    points = _points(usable)
    own, other, left_m = _pairs(points, [lane.kind == "bike" for lane in usable])
    for side, listed in ((1.0, found.left), (-1.0, found.right)):
        chosen = _nearest_on_side(points, own, other, left_m * side)
        for row, column, start, end in _pieces(points, own[chosen], other[chosen]):
            lane, neighbour = usable[points.lane[row]], usable[points.lane[column]]
            listed.setdefault(lane.id, []).append(
                Neighbour(
                    lane_id=neighbour.id,
                    self_start=int(points.index[row]),
                    self_end=int(points.index[start]),
                    other_start=int(points.index[column]),
                    other_end=int(points.index[end]),
                )
            )
    return found


def _points(lanes: list[Lane]) -> _LanePoints:
    counts = [len(lane.centre_m) for lane in lanes]
    headings = []
    for lane in lanes:
        step = np.gradient(lane.centre_m, axis=0)
        headings.append(np.arctan2(step[:, 1], step[:, 0]))
    return _LanePoints(
        xy=np.concatenate([lane.centre_m for lane in lanes]),
        z=np.concatenate([lane.z_m for lane in lanes]),
        heading=np.concatenate(headings),
        lane=np.repeat(np.arange(len(lanes)), counts),
        index=np.concatenate([np.arange(count) for count in counts]),
        last=np.repeat(np.array(counts) - 1, counts),
    )


def _pairs(points: _LanePoints, bike: list[bool]) -> tuple[Ints, Ints, Floats]:
    """Pairs of a point and the nearest point of each other lane, and how far left that is."""
    geometry = np.asarray(shapely.points(points.xy))
    own, other = shapely.STRtree(geometry).query(geometry, predicate="dwithin", distance=FARTHEST_M)
    is_bike = np.array(bike)
    turn = frames.difference(points.heading[own], points.heading[other])
    fits = (
        (points.lane[own] != points.lane[other])
        & (is_bike[points.lane[own]] == is_bike[points.lane[other]])
        & (np.abs(points.z[own] - points.z[other]) <= HEIGHT_GAP_M)
        & (np.abs(turn) <= NEIGHBOUR_TURN_RAD)
    )
    own, other = own[fits], other[fits]
    away = points.xy[other] - points.xy[own]
    ahead = frames.unit(points.heading[own])
    along = np.abs((away * ahead).sum(-1))
    left = ahead[:, 0] * away[:, 1] - ahead[:, 1] * away[:, 0]
    order = np.lexsort((along, points.lane[other], own))
    own, other, along, left = own[order], other[order], along[order], left[order]
    first = np.ones(len(own), bool)
    first[1:] = (np.diff(own) != 0) | (np.diff(points.lane[other]) != 0)
    keep = first & (along <= AHEAD_M)
    return own[keep], other[keep], left[keep]


def _nearest_on_side(points: _LanePoints, own: Ints, other: Ints, side_m: Floats) -> Ints:
    """Pairs whose lane is the first one on this side of the point."""
    beside = np.flatnonzero((side_m >= NEAREST_M) & (side_m <= FARTHEST_M))
    order = beside[np.lexsort((side_m[beside], own[beside]))]
    nearest = order[np.concatenate([[True], np.diff(own[order]) != 0])] if len(order) else order
    # By lane, other lane and position along the lane: the order in which pieces are cut.
    sort = np.lexsort(
        (points.index[own[nearest]], points.lane[other[nearest]], points.lane[own[nearest]])
    )
    chosen: Ints = nearest[sort]
    return chosen


def _pieces(points: _LanePoints, own: Ints, other: Ints) -> list[tuple[int, int, int, int]]:
    """Pieces without gaps: (first point, its neighbour, last point, its neighbour)."""
    if not len(own):
        return []
    cut = (
        (np.diff(points.lane[own]) != 0)
        | (np.diff(points.lane[other]) != 0)
        | (np.diff(points.index[own]) > GAP_POINTS)
    )
    starts = np.concatenate([[0], np.flatnonzero(cut) + 1])
    ends = np.concatenate([starts[1:] - 1, [len(own) - 1]])
    return [
        (int(own[start]), int(other[start]), int(own[end]), int(other[end]))
        for start, end in zip(starts, ends, strict=True)
        if _is_long(points, int(own[start]), int(own[end]), int(other[start]), int(other[end]))
    ]


def _is_long(points: _LanePoints, start: int, end: int, other_start: int, other_end: int) -> bool:
    """Whether a piece is long enough and has the same direction on both lanes."""
    if points.index[other_end] <= points.index[other_start]:
        return False
    share = max(
        (points.index[last] - points.index[first]) / points.last[first]
        for first, last in ((start, end), (other_start, other_end))
    )
    length = np.hypot(*(points.xy[end] - points.xy[start]))
    return bool(length >= SHORTEST_M or share >= MOST_OF_A_LANE)
