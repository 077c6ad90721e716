"""Polylines: arc length, points at arc lengths, projection, simplification."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Floats


class Projection(NamedTuple):
    """Foot of a point on a polyline; ``left_m`` is the signed offset, left positive."""

    along_m: Floats
    left_m: Floats
    distance_m: Floats
    heading_rad: Floats


def arc_lengths(points_m: Floats) -> Floats:
    """(P) distance along the polyline at each point; the first is 0."""
    steps = np.hypot(*np.diff(np.asarray(points_m, float), axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def points_at(points_m: Floats, along_m: Floats) -> tuple[Floats, Floats]:
    """Points (..., 2) and headings (...) at arc lengths (...); continued straight past both ends.

    The polyline (P, 2) needs P >= 2 distinct points.
    """
    points = np.asarray(points_m, float)
    length = arc_lengths(points)
    keep = np.concatenate([[True], np.diff(length) > 1e-9])
    points, length = points[keep], length[keep]
    along = np.asarray(along_m, float)
    segment = np.clip(np.searchsorted(length, along, side="right") - 1, 0, len(length) - 2)
    direction = np.diff(points, axis=0) / np.diff(length)[:, None]
    where = points[segment] + (along - length[segment])[..., None] * direction[segment]
    heading = np.arctan2(direction[segment, 1], direction[segment, 0])
    return where, heading


def project(points_m: Floats, query_m: Floats) -> Projection:
    """Nearest point of the polyline (P, 2), P >= 2, for each query (..., 2)."""
    points, query = np.asarray(points_m, float), np.asarray(query_m, float)
    start, delta = points[:-1], np.diff(points, axis=0)
    square = np.maximum((delta**2).sum(-1), 1e-12)
    offset = query[..., None, :] - start
    share = np.clip((offset * delta).sum(-1) / square, 0.0, 1.0)
    away = offset - share[..., None] * delta
    distance = np.hypot(away[..., 0], away[..., 1])
    best = distance.argmin(-1)
    pick = best[..., None]

    def at(values: Floats) -> Floats:
        chosen: Floats = np.take_along_axis(values, pick, -1)[..., 0]
        return chosen

    length = arc_lengths(points)
    heading = np.arctan2(delta[:, 1], delta[:, 0])[best]
    left = at(offset[..., 1]) * np.cos(heading) - at(offset[..., 0]) * np.sin(heading)
    return Projection(
        along_m=length[best] + at(share) * np.sqrt(square)[best],
        left_m=left,
        distance_m=at(distance),
        heading_rad=heading,
    )


def resample(points_m: Floats, spacing_m: float) -> Floats:
    """Points at equal distances of at most ``spacing_m``, both ends kept."""
    length = arc_lengths(points_m)[-1]
    count = max(2, int(np.ceil(length / spacing_m)) + 1)
    if length < 1e-9:
        return np.asarray(points_m, float)[[0, -1]]
    return points_at(points_m, np.linspace(0.0, length, count))[0]
