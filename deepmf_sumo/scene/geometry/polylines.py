"""Polylines: arc length, points at arc lengths, projection, simplification."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.scene import Floats


class Projection(NamedTuple):
    """Foot of a point on a polyline; ``left_m`` is the signed offset, left positive."""

    along_m: Floats
    left_m: Floats
    distance_m: Floats
    heading_rad: Floats


def arc_lengths(points_m: Floats) -> Floats:
    """(P) distance along the polyline at each point; the first is 0, also of an empty one."""
    x, y = np.asarray(points_m, float).T
    length = np.zeros(max(len(x), 1))
    np.cumsum(np.hypot(x[1:] - x[:-1], y[1:] - y[:-1]), out=length[1:])
    return length


class Measured:
    """A polyline (P, 2), P >= 2 distinct points, prepared for many look-ups.

    Attributes:
        along_m: (P) distance along the polyline at each point; the first is 0.
    """

    def __init__(self, points_m: Floats) -> None:
        points = np.asarray(points_m, float)
        length = arc_lengths(points)
        keep = np.concatenate([[True], np.diff(length) > 1e-9])
        self._points, self.along_m = points[keep], length[keep]
        self._direction = np.diff(self._points, axis=0) / np.diff(self.along_m)[:, None]
        self._heading = np.arctan2(self._direction[:, 1], self._direction[:, 0])

    def at(self, along_m: Floats) -> tuple[Floats, Floats]:
        """See `points_at`."""
        along, length = np.asarray(along_m, float), self.along_m
        segment = np.clip(np.searchsorted(length, along, side="right") - 1, 0, len(length) - 2)
        ahead = (along - length[segment])[..., None] * self._direction[segment]
        return self._points[segment] + ahead, self._heading[segment]


def points_at(points_m: Floats, along_m: Floats) -> tuple[Floats, Floats]:
    """Points (..., 2) and headings (...) at arc lengths (...); continued straight past both ends.

    The polyline (P, 2) needs P >= 2 distinct points.
    """
    return Measured(points_m).at(along_m)


def project(points_m: Floats, query_m: Floats) -> Projection:
    """Nearest point of the polyline (P, 2), P >= 2, for each query (..., 2)."""
    points, query = np.asarray(points_m, float), np.asarray(query_m, float)
    # Each axis by itself, with one flat look-up each: this runs for every box at every step of a
    # simulation, and numpy is slow at sums over an axis of length two.
    step_x, step_y = (points[1:] - points[:-1]).T
    square = np.maximum(step_x**2 + step_y**2, 1e-12)
    off_x, off_y = (query[..., axis, None] - points[:-1, axis] for axis in range(2))
    share = np.clip((off_x * step_x + off_y * step_y) / square, 0.0, 1.0)
    distance = np.hypot(off_x - share * step_x, off_y - share * step_y)
    best = distance.argmin(-1)
    place = np.arange(best.size) * len(square) + best.ravel()
    share, left_x, left_y, nearest = (
        values.ravel()[place].reshape(best.shape) for values in (share, off_x, off_y, distance)
    )
    heading = np.arctan2(step_y[best], step_x[best])
    return Projection(
        along_m=arc_lengths(points)[best] + share * np.sqrt(square)[best],
        left_m=left_y * np.cos(heading) - left_x * np.sin(heading),
        distance_m=nearest,
        heading_rad=heading,
    )


def heights_at(points_m: Floats, z_m: Floats, query_m: Floats) -> Floats:
    """(...) heights of a polyline (P, 2), (P), P >= 2, where it is nearest to queries (..., 2)."""
    along = project(points_m, query_m).along_m
    return np.asarray(np.interp(along, arc_lengths(points_m), z_m), float)


def resample(points_m: Floats, spacing_m: float) -> Floats:
    """Points at equal distances of at most ``spacing_m``, both ends kept."""
    length = arc_lengths(points_m)[-1]
    count = max(2, int(np.ceil(length / spacing_m)) + 1)
    if length < 1e-9:
        return np.asarray(points_m, float)[[0, -1]]
    return points_at(points_m, np.linspace(0.0, length, count))[0]
