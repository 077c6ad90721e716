"""Whether points are on the road, and which way it runs there: lanes for cars around them."""

import functools
from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, RoadMap

WIDTH_M = 3.7
"""Of a lane whose source says nothing."""
MARGIN_M = 0.5
"""A point is on the road half a lane's width and so much from a centre line."""
_AGAINST_RAD = 2 * np.pi / 3
_BLOCK = 44  # points tested together: neighbours in the list are neighbours on the road


def on_road(road: RoadMap, points_m: Floats) -> Bools:
    """(N) points (N, 2) within half a lane's width and 0.5 m of its centre line; no cycle lanes."""
    points = np.asarray(points_m, float)
    near = pieces_near(road, points)
    blocks = np.array_split(points, max(1, len(points) // _BLOCK))
    return np.concatenate([covering(_reaching(near, one), one).any(axis=1) for one in blocks])


def against_traffic(road: RoadMap, points_m: Floats, course_rad: Floats) -> Bools:
    """(N) points on the road where all lanes run against the course (N), by more than 120 degrees.

    A point on no lane is not against any: False.
    """
    points = np.asarray(points_m, float)
    near = pieces_near(road, points)
    on_it = covering(near, points)
    turn = np.cos(np.asarray(course_rad, float)[:, None] - near.heading_rad)
    along = on_it & (turn > np.cos(_AGAINST_RAD))
    against: Bools = on_it.any(axis=1) & ~along.any(axis=1)
    return against


class Pieces(NamedTuple):
    """Pieces of centre lines: start and vector (S, 2), reach and direction (S)."""

    start_m: Floats
    vector_m: Floats
    reach_m: Floats
    heading_rad: Floats


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
    offset = points[:, None] - pieces.start_m
    vector = pieces.vector_m
    square = np.maximum((vector**2).sum(axis=1), 1e-12)
    share = np.clip((offset * vector).sum(axis=-1) / square, 0.0, 1.0)
    away = offset - share[..., None] * vector
    covers: Bools = (away**2).sum(axis=-1) <= pieces.reach_m**2
    return covers
