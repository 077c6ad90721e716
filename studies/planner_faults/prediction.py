"""Where others will be: along their lanes or straight on, at constant velocity, and when in a path.

A prediction is a row of a `Futures`; `Occupancy` lays the rows out on the AV's path.
"""

import functools
from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple, Self

import numpy as np
from scipy.spatial import cKDTree

from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap
from deepmf_sumo.scene.geometry import frames, polylines

TIMES_S: Final = np.arange(0.0, 4.01, 0.2)
"""At which the others are predicted."""
_SPACING_M: Final = 1.0
_LENGTH_M: Final = 160.0
"""Of a lane with the lanes that follow it: 4 s at 40 m/s."""
_BESIDE_M: Final = 1.2
_TURNED_RAD: Final = np.radians(20.0)
_LEAVES_MPS: Final = 0.5
_LEAVING_S: Final = 2.0
"""A vehicle that leaves its lane faster sideways is believed to go on with it for so long."""
_PARALLEL: Final = np.cos(np.pi / 4)


class Lanes:
    """All lanes of a road for cars, continued by the successors with the least turn."""

    def __init__(self, road: RoadMap) -> None:
        self._road = road
        self._ids = [
            lane.id
            for lane in road.lanes.values()
            if lane.kind != "bike" and polylines.arc_lengths(lane.centre_m)[-1] > _SPACING_M
        ]
        lines = [_spaced(road.lanes[name].centre_m) for name in self._ids]
        count = [len(line) for line in lines]
        self._lane = np.repeat(np.arange(len(lines)), count)
        self._place = np.concatenate([np.zeros(0, int), *map(np.arange, count)])
        self._points = np.concatenate([np.zeros((0, 2)), *lines])
        self._heading = np.concatenate([np.zeros(0), *map(_headings, lines)])
        self._tree = cKDTree(self._points) if lines else None
        self._ahead: dict[int, Floats] = {}

    def match(self, position_m: Floats, heading_rad: Floats) -> tuple[Ints, Ints]:
        """(N) the nearest lane with the direction of each vehicle or -1, (N) its nearest point."""
        if self._tree is None or not len(position_m):
            return np.full(len(position_m), -1), np.zeros(len(position_m), int)
        distance, point = self._tree.query(position_m, k=min(12, len(self._points)))
        distance, point = distance.reshape(len(position_m), -1), point.reshape(len(position_m), -1)
        turn = np.abs(frames.difference(self._heading[point], heading_rad[:, None]))
        cost = np.where((distance < _BESIDE_M) & (turn < _TURNED_RAD), distance + turn, np.inf)
        rows, best = np.arange(len(cost)), cost.argmin(axis=1)
        nearest = point[rows, best]
        matched = np.isfinite(cost[rows, best])
        return np.where(matched, self._lane[nearest], -1), self._place[nearest]

    def along(
        self, lane: Ints, place: Ints, start_m: Floats, moved_m: Floats
    ) -> tuple[Floats, Floats]:
        """(K, T, 2) positions and (K, T) headings after ``moved_m`` (K, T) along K lanes.

        ``place`` (K) and ``start_m`` (K, 2): the nearest point of each lane, and the position.
        """
        lines = [self._line(each) for each in lane.tolist()]
        first = np.cumsum([0, *(len(line) for line in lines[:-1])])[:, None]
        last = np.array([len(line) - 2 for line in lines])[:, None]
        points = np.concatenate(lines)
        near = np.minimum(place[:, None], last)
        step = np.clip(place[:, None] + moved_m.astype(int), 0, last)
        way = points[first + step + 1] - points[first + step]
        heading = np.arctan2(way[..., 1], way[..., 0])
        course = points[first + near + 1] - points[first + near]
        course = course / np.maximum(np.hypot(course[..., 0], course[..., 1]), 1e-6)[..., None]
        offset = (start_m - points[(first + near)[:, 0]])[:, None]
        on_line = (offset * course).sum(-1)
        left = (course[..., 0] * offset[..., 1] - course[..., 1] * offset[..., 0])[..., None]
        normal = np.stack([-np.sin(heading), np.cos(heading)], -1)
        share = (near + on_line + moved_m - step)[..., None]
        return points[first + step] + share * way + left * normal, heading

    def _line(self, lane: int) -> Floats:
        """(P, 2) the lane from its start, and its successors, a point each metre."""
        if lane not in self._ahead:
            self._ahead[lane] = self._continued(self._ids[lane])
        return self._ahead[lane]

    def _continued(self, name: str) -> Floats:
        line, seen = self._road.lanes[name].centre_m, {name}
        start_m = polylines.arc_lengths(line)[-1]
        while polylines.arc_lengths(line)[-1] < start_m + _LENGTH_M:
            following = [
                after
                for after in self._road.lanes[name].next
                if after in self._road.lanes and after not in seen
                and len(self._road.lanes[after].centre_m) > 1
            ]  # fmt: skip
            if not following:
                break
            name = min(following, key=lambda after: abs(_turn(self._road.lanes[after].centre_m)))
            seen.add(name)
            line = np.concatenate([line, self._road.lanes[name].centre_m])
        line = line[np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-3])]
        along = np.arange(0.0, start_m + _LENGTH_M, _SPACING_M)
        return polylines.points_at(line, along)[0]


@functools.lru_cache(maxsize=8)
def lanes_of(road: RoadMap) -> Lanes:
    """The lanes of a road, which is compared by identity."""
    return Lanes(road)


def _spaced(line: Floats) -> Floats:
    along = np.arange(0.0, polylines.arc_lengths(line)[-1], _SPACING_M)
    return polylines.points_at(line, along)[0]


def _headings(line: Floats) -> Floats:
    courses = np.arctan2(*np.diff(line, axis=0).T[::-1])
    return np.append(courses, courses[-1])


def _turn(line: Floats) -> float:
    first, last = line[1] - line[0], line[-1] - line[-2]
    return float(frames.difference(np.arctan2(*last[::-1]), np.arctan2(*first[::-1])))


class Futures(NamedTuple):
    """M predictions of N agents.

    Attributes:
        agent: (M) which agent. position_m: (M, T, 2). heading_rad: (M, T).
        until_s: (M) for how long it is believed.
    """

    agent: Ints
    position_m: Floats
    heading_rad: Floats
    until_s: Floats


def predicted(
    road: RoadMap, position_m: Floats, heading_rad: Floats, velocity_mps: Floats, vehicle: Bools
) -> Futures:
    """Each of N agents along its lane at its distance from the centre, without a lane straight on.

    One that leaves its lane sideways is predicted straight on, too, for 2 s.

    Args:
        road: whose lanes are followed.
        position_m: (N, 2).
        heading_rad: (N).
        velocity_mps: (N, 2).
        vehicle: (N) whether it can follow a lane.
    """
    straight = position_m[:, None] + TIMES_S[:, None] * velocity_mps[:, None]
    facing = np.repeat(heading_rad[:, None], len(TIMES_S), axis=1)
    position, heading = straight.copy(), facing.copy()
    lanes = lanes_of(road)
    lane, place = lanes.match(position_m, heading_rad)
    speed = (velocity_mps * frames.unit(heading_rad)).sum(-1)
    aside = np.zeros(len(lane))
    rows = np.flatnonzero((lane >= 0) & (speed > 0) & vehicle)
    if len(rows):
        moved = TIMES_S * speed[rows, None]
        position[rows], heading[rows] = lanes.along(
            lane[rows], place[rows], position_m[rows], moved
        )
        aside[rows] = np.abs(speed[rows] * np.sin(heading_rad[rows] - heading[rows, 0]))
    agent = np.arange(len(position_m))
    leaves = np.flatnonzero(aside > _LEAVES_MPS)
    return Futures(
        np.concatenate([agent, leaves]),
        np.concatenate([position, straight[leaves]]),
        np.concatenate([heading, facing[leaves]]),
        np.concatenate([np.full(len(agent), np.inf), np.full(len(leaves), _LEAVING_S)]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Occupancy:
    """M predictions on the AV's path at T times.

    Attributes:
        agent: (M).
        clearance_m: (M, T) between the box and what the AV sweeps, negative inside; inf where the
            prediction is not believed any more.
        rear_m, front_m: (M, T) ends of the box along the path, of which 0 is the AV's centre now.
        parallel: (M, T) within 45 degrees of the path's direction.
    """

    agent: Ints
    clearance_m: Floats
    rear_m: Floats
    front_m: Floats
    parallel: Bools

    @classmethod
    def of(cls, path: AvPath, futures: Futures, size_m: Floats, av_width_m: float) -> Self:
        """On the path of an AV of a width; ``size_m``: (N, 2) of the agents."""
        foot = path.project(futures.position_m)
        turn = frames.difference(futures.heading_rad, foot.heading_rad)
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        length, width = size_m[futures.agent].T[..., None]
        half_along = (length * cos + width * sin) / 2
        reach = (length * sin + width * cos + av_width_m) / 2
        believed = futures.until_s[:, None] + 1e-9 >= TIMES_S
        return cls(
            agent=futures.agent,
            clearance_m=np.where(believed, np.abs(foot.left_m) - reach, np.inf),
            rear_m=foot.along_m - half_along,
            front_m=foot.along_m + half_along,
            parallel=np.cos(turn) > _PARALLEL,
        )

    def joined(self, more: Self) -> Self:
        """These predictions, then others."""
        parts = {
            part.name: np.concatenate([getattr(self, part.name), getattr(more, part.name)])
            for part in fields(self)
        }
        return replace(self, **parts)
