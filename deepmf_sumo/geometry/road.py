"""Whether points are on the road, and which way it runs there: lanes for cars around them."""

import functools
from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, RoadMap
from deepmf_sumo.geometry.ground import clear, ground_of

WIDTH_M = 3.7
"""Of a lane whose source says nothing."""
MARGIN_M = 0.5
"""A point is on the road half a lane's width and so much from a centre line."""
_AGAINST_RAD = 2 * np.pi / 3
_BLOCK = 44  # points tested together: neighbours in the list are neighbours on the road


def on_road(road: RoadMap, points_m: Floats, z_m: Floats | None = None) -> Bools:
    """(N) points (N, 2) within half a lane's width and 0.5 m of its centre line; no cycle lanes.

    Where roads cross the lane must be at the points' heights (N), if these are given: who has left
    a bridge over its side is on no road, though there is one below.
    """
    points = np.asarray(points_m, float)
    near = pieces_near(road, points)
    heights = None if z_m is None or not ground_of(road).has_levels else np.asarray(z_m, float)
    count = max(1, len(points) // _BLOCK)
    blocks = zip(
        np.array_split(points, count),
        [None] * count if heights is None else np.array_split(heights, count),
        strict=True,
    )
    return np.concatenate([_covered(_reaching(near, one), one, z) for one, z in blocks])


def _covered(pieces: "Pieces", points: Floats, z_m: Floats | None) -> Bools:
    on_it = covering(pieces, points)
    if z_m is not None:
        on_it &= at_height(pieces, points, z_m)
    covered: Bools = np.asarray(on_it.any(axis=1))
    return covered


def against_traffic(
    road: RoadMap, points_m: Floats, course_rad: Floats, z_m: Floats | None = None
) -> Bools:
    """(N) points on the road where all lanes run against the course (N), by more than 120 degrees.

    A point on no lane is not against any: False. Heights (N) as in `on_road`.
    """
    points = np.asarray(points_m, float)
    near = pieces_near(road, points)
    on_it = covering(near, points)
    if z_m is not None and ground_of(road).has_levels:
        on_it &= at_height(near, points, z_m)
    turn = np.cos(np.asarray(course_rad, float)[:, None] - near.heading_rad)
    along = on_it & (turn > np.cos(_AGAINST_RAD))
    against: Bools = on_it.any(axis=1) & ~along.any(axis=1)
    return against


class Pieces(NamedTuple):
    """Pieces of centre lines: start and vector (S, 2), reach and direction (S).

    ``z_m``, ``rise_m``: (S) height of the start, and of the end above it.
    """

    start_m: Floats
    vector_m: Floats
    reach_m: Floats
    heading_rad: Floats
    z_m: Floats
    rise_m: Floats


@functools.lru_cache(maxsize=4)
def _pieces(road: RoadMap) -> Pieces:
    """All pieces of a road's lanes for cars; kept, for several metrics ask about one road."""
    lanes = [one for one in road.lanes.values() if one.kind != "bike" and len(one.centre_m) > 1]
    start = np.concatenate([np.empty((0, 2)), *(one.centre_m[:-1] for one in lanes)])
    vector = np.concatenate([np.empty((0, 2)), *(np.diff(one.centre_m, axis=0) for one in lanes)])
    reach = [(one.width_m or WIDTH_M) / 2 + MARGIN_M for one in lanes]
    return Pieces(
        start_m=start,
        vector_m=vector,
        reach_m=np.repeat(reach, [len(one.centre_m) - 1 for one in lanes]),
        heading_rad=np.arctan2(vector[:, 1], vector[:, 0]),
        z_m=np.concatenate([np.empty(0), *(one.z_m[:-1] for one in lanes)]),
        rise_m=np.concatenate([np.empty(0), *(np.diff(one.z_m) for one in lanes)]),
    )


def pieces_near(road: RoadMap, points: Floats) -> Pieces:
    """The pieces that reach into the bounding box of points (N, 2)."""
    return _reaching(_pieces(road), points)


def _reaching(pieces: Pieces, points: Floats) -> Pieces:
    if len(points) == 0:
        return Pieces(*(part[:0] for part in pieces))
    end, reach = pieces.start_m + pieces.vector_m, pieces.reach_m[:, None]
    low, high = np.minimum(pieces.start_m, end) - reach, np.maximum(pieces.start_m, end) + reach
    meets = ((high >= points.min(axis=0)) & (low <= points.max(axis=0))).all(axis=1)
    return Pieces(*(part[meets] for part in pieces))


def covering(pieces: Pieces, points: Floats) -> Bools:
    """(N, S) whether a point lies within a piece's reach."""
    offset, share = _feet(pieces, points)
    away = offset - share[..., None] * pieces.vector_m
    covers: Bools = (away**2).sum(axis=-1) <= pieces.reach_m**2
    return covers


def at_height(pieces: Pieces, points: Floats, z_m: Floats) -> Bools:
    """(N, S) whether a piece is neither above nor below a point (N, 2) at a height (N)."""
    return ~clear(_heights(pieces, points), np.asarray(z_m, float)[:, None])


def _heights(pieces: Pieces, points: Floats) -> Floats:
    """(N, S) of pieces at the feet of points."""
    heights: Floats = pieces.z_m + _feet(pieces, points)[1] * pieces.rise_m
    return heights


def _feet(pieces: Pieces, points: Floats) -> tuple[Floats, Floats]:
    """(N, S, 2) from the pieces' starts to points, (N, S) shares of the pieces at their feet."""
    offset = points[:, None] - pieces.start_m
    vector = pieces.vector_m
    square = np.maximum((vector**2).sum(axis=1), 1e-12)
    return offset, np.clip((offset * vector).sum(axis=-1) / square, 0.0, 1.0)
