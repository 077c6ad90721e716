"""Lanes prepared for look-ups: which segments of their lines are near a point.

`LaneMap` is the one spatial index of lanes. A road has several, because its lanes are looked up
along different lines: as drawn (`scene.geometry.road`), every metre (`deepmf.networks.lanes`), with
few points (`deepmf.lane_assignment`), and simplified (`sumo.network.matching`). Each belongs to its
subject, which builds it with `per_road`.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import shapely

from deepmf_sumo.scene import Bools, Floats, Ints, Lane, RoadMap

_WIDTH_M: Final = 3.7
"""A freeway lane is 12 feet wide. The width that SUMO gets of such lanes is another."""
MARGIN_M: Final = 0.5
"""A point is on a lane up to half the lane's width and this margin from its line."""
_RUN: Final = 16
"""Segments of one entry of the index: a network may have a million segments."""
_SLACK_M: Final = 1e-6
"""Rounding must not hide a segment that is just within reach."""
_MOST_KEPT: Final = 8

T = TypeVar("T")


def width_m(lane: Lane) -> float:
    """Width of a lane; 3.7 m if the source does not state it."""
    return lane.width_m or _WIDTH_M


def reach_m(lane: Lane) -> float:
    """Distance from a lane's line up to which a point is on the lane."""
    return width_m(lane) / 2 + MARGIN_M


def per_road(prepare: Callable[[RoadMap], T]) -> Callable[[RoadMap], T]:
    """Decorator: prepare once for each road, and keep the result while the road lives.

    A road cannot hold what is derived of it: `RoadMap` is frozen, and knows nothing of
    what prepares it. At most eight results are kept, those used last, because a program
    may hold thousands of scenes. The result must not refer to the road, or both would stay.
    """
    kept: WeakKeyDictionary[RoadMap, T] = WeakKeyDictionary()

    @functools.wraps(prepare)
    def prepared(road: RoadMap) -> T:
        found = kept.pop(road, None)
        if found is None:
            found = prepare(road)
        kept[road] = found  # the last one used comes last
        if len(kept) > _MOST_KEPT:
            kept.pop(next(iter(kept)), None)
        return found

    return prepared


class Feet(NamedTuple):
    """K pairs of a point and a segment near it, by point, then by segment.

    Attributes:
        point, segment: (K) rows.
        share: (K) of the segment before the foot, 0 to 1.
        offset_m, away_m: (K, 2) from the segment's start and from the foot to the point.
    """

    point: Ints
    segment: Ints
    share: Floats
    offset_m: Floats
    away_m: Floats

    def among(self, rows: Bools) -> "Feet":
        """Those of K pairs that are chosen (K)."""
        point, segment, share, offset, away = self
        return Feet(point[rows], segment[rows], share[rows], offset[rows], away[rows])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneMap:
    """L lanes with a line each, in all S segments, and a spatial index of them.

    Attributes:
        lanes: (L). row: of each lane by its id. line_m: (L) arrays (P, 2), P >= 0.
        reach_m: (L) distance from its line up to which a point is on a lane.
        lane: (S) row of the lane. first: (L + 1) row of each lane's first segment; then S.
        start_m, vector_m: (S, 2) from start to end.
        z_m, rise_m: (S) height of the start, and of the end above it.
    """

    lanes: tuple[Lane, ...]
    row: dict[str, int]
    line_m: tuple[Floats, ...]
    reach_m: Floats
    lane: Ints
    first: Ints
    start_m: Floats
    vector_m: Floats
    z_m: Floats
    rise_m: Floats
    _run_first: Ints
    _run_length: Ints
    _tree: shapely.STRtree

    @classmethod
    def of(
        cls,
        lanes: Sequence[Lane],
        lines_m: Sequence[Floats] | None = None,
        heights_m: Sequence[Floats] | None = None,
    ) -> Self:
        """A map of lanes (L), along lines (P, 2) with heights (P); by default as they are drawn."""
        lines = [lane.centre_m for lane in lanes] if lines_m is None else lines_m
        heights = [lane.z_m for lane in lanes] if heights_m is None else heights_m
        counts = np.array([max(len(line) - 1, 0) for line in lines], np.int64)
        start = np.concatenate([np.empty((0, 2)), *(line[:-1] for line in lines)])
        vector = np.concatenate([np.empty((0, 2)), *(np.diff(line, axis=0) for line in lines)])
        first = np.concatenate([[0], np.cumsum(counts)])
        run_first, run_length = _runs(first, counts)
        return cls(
            lanes=tuple(lanes),
            row={lane.id: row for row, lane in enumerate(lanes)},
            line_m=tuple(lines),
            reach_m=np.array([reach_m(lane) for lane in lanes]),
            lane=np.repeat(np.arange(len(counts)), counts),
            first=first,
            start_m=start,
            vector_m=vector,
            z_m=np.concatenate([np.empty(0), *(each[:-1] for each in heights)]),
            rise_m=np.concatenate([np.empty(0), *(np.diff(each) for each in heights)]),
            _run_first=run_first,
            _run_length=run_length,
            _tree=_tree(start, start + vector, run_first),
        )

    @property
    def widest_m(self) -> float:
        """The largest `reach_m`; 0 without lanes."""
        return float(self.reach_m.max(initial=0.0))

    def around(self, point_m: Floats, reach_m: float) -> Ints:
        """Rows of all segments within reach of a point (2), and of some more, in order."""
        x, y, reach = float(point_m[0]), float(point_m[1]), reach_m + _SLACK_M
        box = shapely.box(x - reach, y - reach, x + reach, y + reach)
        return self._segments(np.sort(self._tree.query(box)))[1]

    def feet(self, points_m: Floats, reach_m: float) -> Feet:
        """Feet of points (N, 2) on all segments within reach, and on some more."""
        points = np.asarray(points_m, float)
        low, high = points - reach_m - _SLACK_M, points + reach_m + _SLACK_M
        point, run = self._tree.query(shapely.box(*low.T, *high.T))
        order = np.lexsort((run, point))
        pair, segment = self._segments(run[order])
        point = point[order][pair]
        vector, offset = self.vector_m[segment], points[point] - self.start_m[segment]
        square = np.maximum((vector**2).sum(axis=1), 1e-12)
        share = np.clip((offset * vector).sum(axis=1) / square, 0.0, 1.0)
        return Feet(point, segment, share, offset, offset - share[:, None] * vector)

    def heights_m(self, feet: Feet) -> Floats:
        """(K) heights of the lanes at feet."""
        return self.z_m[feet.segment] + feet.share * self.rise_m[feet.segment]

    def _segments(self, runs: Ints) -> tuple[Ints, Ints]:
        """Row of the run in the argument, and row, of each segment of the runs."""
        count = self._run_length[runs]
        row = np.repeat(np.arange(len(runs)), count)
        begin = np.cumsum(count) - count
        return row, np.arange(len(row)) - begin[row] + self._run_first[runs][row]


def _runs(first: Ints, counts: Ints) -> tuple[Ints, Ints]:
    """First segment and number of segments of all runs; no run has segments of two lanes."""
    runs = -(-counts // _RUN)
    lane = np.repeat(np.arange(len(counts)), runs)
    number = np.arange(len(lane)) - (np.cumsum(runs) - runs)[lane]
    begin = first[lane] + _RUN * number
    return begin, np.minimum(begin + _RUN, first[lane + 1]) - begin


def _tree(start_m: Floats, end_m: Floats, run_first: Ints) -> shapely.STRtree:
    """A search tree of the bounding boxes of all runs."""
    if not len(run_first):
        return shapely.STRtree([])
    low = np.minimum.reduceat(np.minimum(start_m, end_m), run_first)
    high = np.maximum.reduceat(np.maximum(start_m, end_m), run_first)
    return shapely.STRtree(np.asarray(shapely.box(*low.T, *high.T)))
