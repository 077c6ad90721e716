"""The AV's path: where its box is at an arc length, and where others are beside it."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from deepmf_sumo.datatypes import Floats, Ints, frozen
from deepmf_sumo.geometry import angles, frames, polylines

BEHIND_M = 100.0
AHEAD_M = 400.0
"""A path goes on straight so far behind its first and beyond its last point."""
_STEP_M = 1e-3
_FIRST_M = 3.0
_TURN_RAD = 0.1  # 6 cm of sagitta on a curve of 50 m


class State(NamedTuple):
    """Position (2) of the box centre, heading and speed of a vehicle at one step."""

    position_m: Floats
    heading_rad: float
    speed_mps: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """P poses by arc length, which is 0 at the first pose given and grows.

    Attributes:
        along_m: (P). position_m: (P, 2). heading_rad: (P) of the box, without jumps of 2 pi.
    """

    along_m: Floats
    position_m: Floats
    heading_rad: Floats

    @classmethod
    def through(cls, position_m: Floats, heading_rad: Floats, ahead_m: Floats) -> Self:
        """Path through poses (K, 2), (K), K >= 1, then the points (Q, 2), then straight on."""
        position = np.asarray(position_m, float)
        keep = np.concatenate([[0], 1 + _moving(position)])
        position, heading = position[keep], np.asarray(heading_rad, float)[keep]
        ahead = _in_front(np.asarray(ahead_m, float).reshape(-1, 2), position[-1], heading[-1])
        joined = np.concatenate([position[-1:], ahead])
        ahead = joined[np.concatenate([[0], 1 + _moving(joined)])]
        courses = np.arctan2(*np.diff(ahead, axis=0).T[::-1])
        headings = np.concatenate([heading, courses])
        whole = np.concatenate([position, ahead[1:]])
        first, last = angles.unit(headings[0]), angles.unit(headings[-1])
        whole = np.concatenate([whole[:1] - BEHIND_M * first, whole, whole[-1:] + AHEAD_M * last])
        headings = np.unwrap(np.concatenate([headings[:1], headings, headings[-1:]]))
        along = polylines.arc_lengths(whole) - BEHIND_M
        return cls(along_m=frozen(along), position_m=frozen(whole), heading_rad=frozen(headings))

    def at(self, along_m: Floats) -> tuple[Floats, Floats]:
        """Centres (..., 2) and headings (...) of the box at arc lengths (...)."""
        x = np.interp(along_m, self.along_m, self.position_m[:, 0])
        y = np.interp(along_m, self.along_m, self.position_m[:, 1])
        heading = np.interp(along_m, self.along_m, self.heading_rad)
        return np.stack([x, y], axis=-1), heading

    def project(self, points_m: Floats) -> polylines.Projection:
        """Feet of points (..., 2) on the path, simplified to centimetres."""
        turned = np.abs(np.diff(self.heading_rad)).cumsum() / _TURN_RAD
        keep = np.flatnonzero(np.diff(np.floor(turned)) > 0) + 1
        last = len(self.along_m) - 1
        ends = np.unique(np.concatenate([[0, 1], keep, [last - 1, last]]))
        foot = polylines.project(self.position_m[ends], points_m)
        scale = polylines.arc_lengths(self.position_m[ends])
        return foot._replace(along_m=np.interp(foot.along_m, scale, self.along_m[ends]))


def _in_front(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points from the first that a car at the origin can head for without turning on the spot."""
    if len(points_m) == 0:
        return points_m
    ahead = frames.to_local(points_m, origin_m, heading_rad)[:, 0] >= _FIRST_M
    return points_m[int(ahead.argmax()) :] if ahead.any() else points_m[:0]


def _moving(position_m: Floats) -> Ints:
    """Indices of the steps of a path (K, 2) that lead on, not counting standstill."""
    return np.flatnonzero(np.hypot(*np.diff(position_m, axis=0).T) > _STEP_M)
