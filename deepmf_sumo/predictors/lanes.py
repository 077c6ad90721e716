"""Look-up of lanes: the nearest points of lanes to poses, and sequences of lanes ahead."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints, Lane, Polygon, RoadMap, SignalState
from deepmf_sumo.geometry import polylines
from deepmf_sumo.geometry.ground import ground_of, on_nearest_level

LANE_SPACING_M = 1.0
PIECE_POINTS = 10
PIECE_SPACING_M = 2.0
"""A lane piece, one polyline of VectorNet, is 18 m long."""

ROAD_CHANNELS = (
    "freeway", "street", "bike", "interpolating", "line", "edge", "crosswalk", "bump", "driveway",
)  # fmt: skip
"""Kinds of road points; stop signs are drawn with the speed bumps."""


class Foot(NamedTuple):
    """Where a pose stands on a lane; ``left_m`` is the signed offset, left of the lane positive."""

    lane: int
    along_m: float
    left_m: float
    distance_m: float
    turn_rad: float
    """Heading of the pose minus heading of the lane."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadIndex:
    """A road, prepared for fast queries. L lanes with at least two distinct points.

    Attributes:
        lane_ids: (L). points_m: (L) arrays (P, 2) at 1 m. length_m: (L). limit_mps: (L) 0 unknown.
        following: (L) rows of the lanes that follow. drivable: (L) False for bike lanes.
        segment_start_m, segment_direction: (S, 2). segment_length_m, segment_along_m: (S).
        segment_lane: (S) row of the lane. segment_z_m: (S) height of its beginning.
        has_levels: the road passes over itself somewhere.
        piece_m: (N, 10, 2). piece_kind: (N, 4) one-hot: freeway, street, bike or unknown,
            interpolating. piece_lane: (N) row of the lane.
        pixel_m: (Q, 2) points of everything drawn. pixel_channel: (Q) index in ROAD_CHANNELS.
    """

    lane_ids: tuple[str, ...]
    points_m: tuple[Floats, ...]
    length_m: Floats
    limit_mps: Floats
    following: tuple[tuple[int, ...], ...]
    drivable: Bools
    segment_start_m: Floats
    segment_direction: Floats
    segment_length_m: Floats
    segment_along_m: Floats
    segment_lane: Ints
    segment_z_m: Floats
    has_levels: bool
    piece_m: Floats
    piece_kind: Floats
    piece_lane: Ints
    pixel_m: Floats
    pixel_channel: Ints

    def feet(
        self,
        position_m: Floats,
        heading_rad: float,
        reach_m: float,
        turn_rad: float,
        z_m: float | None = None,
    ) -> list[Foot]:
        """The pose's foot on each drivable lane within reach and angle, nearest first.

        Where roads cross only lanes of the level nearest to its height, if that is given.
        """
        offset = position_m - self.segment_start_m
        direction = self.segment_direction
        share = np.clip((offset * direction).sum(-1), 0.0, self.segment_length_m)
        away = offset - share[:, None] * direction
        square = (away * away).sum(-1)
        aligned = direction @ np.array([np.cos(heading_rad), np.sin(heading_rad)])
        near = (square < reach_m**2) & (aligned > np.cos(turn_rad))
        rows = np.flatnonzero(near & self.drivable[self.segment_lane])
        if z_m is not None and self.has_levels:
            one = np.zeros(len(rows), np.int64)
            rows = rows[on_nearest_level(one, self.segment_z_m[rows], np.array(z_m))]
        rows = rows[np.argsort(square[rows], kind="stable")]
        lanes, first = np.unique(self.segment_lane[rows], return_index=True)
        feet = []
        for lane, row in zip(lanes, rows[first], strict=True):
            dx, dy = direction[row]
            lane_heading = np.arctan2(dy, dx)
            turn = (heading_rad - lane_heading + np.pi) % (2 * np.pi) - np.pi
            feet.append(
                Foot(
                    int(lane),
                    float(self.segment_along_m[row] + share[row]),
                    float(dx * offset[row, 1] - dy * offset[row, 0]),
                    float(np.sqrt(square[row])),
                    float(turn),
                )
            )
        return sorted(feet, key=lambda foot: foot.distance_m)


@lru_cache(maxsize=8)
def road_index(road: RoadMap) -> RoadIndex:
    """The index of a road; a road is compared by identity, and the last eight are kept."""
    lanes = {lane.id: lane for lane in road.lanes.values() if _length(lane.centre_m) > 0.1}
    ids = tuple(lanes)
    row_of = {lane_id: row for row, lane_id in enumerate(ids)}
    points = tuple(polylines.resample(lane.centre_m, LANE_SPACING_M) for lane in lanes.values())
    length = np.array([_length(line) for line in points])
    starts = [line[:-1] for line in points]
    steps = [np.diff(line, axis=0) for line in points]
    start = np.concatenate(starts) if starts else np.zeros((0, 2))
    step = np.concatenate(steps) if steps else np.zeros((0, 2))
    step_length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
    counts = np.array([len(line) - 1 for line in points], np.int64)
    pieces = [_pieces(line) for line in points]
    piece_counts = np.array([len(piece) for piece in pieces], np.int64)
    pixel, channel = _pixels(road, tuple(lanes.values()), points)
    return RoadIndex(
        lane_ids=ids,
        points_m=points,
        length_m=length,
        limit_mps=np.array([lane.speed_limit_mps or 0.0 for lane in lanes.values()]),
        following=tuple(
            tuple(row_of[after] for after in lane.next if after in row_of)
            for lane in lanes.values()
        ),
        drivable=np.array([lane.kind != "bike" for lane in lanes.values()], bool),
        segment_start_m=start,
        segment_direction=step / step_length[:, None],
        segment_length_m=step_length,
        segment_along_m=_restarting_sums(step_length, counts),
        segment_lane=np.repeat(np.arange(len(ids)), counts),
        segment_z_m=np.concatenate([np.zeros(0), *map(_heights, lanes.values(), counts)]),
        has_levels=ground_of(road).has_levels,
        piece_m=np.concatenate(pieces) if pieces else np.zeros((0, PIECE_POINTS, 2)),
        piece_kind=_kinds(tuple(lanes.values()), piece_counts),
        piece_lane=np.repeat(np.arange(len(ids)), piece_counts),
        pixel_m=pixel,
        pixel_channel=channel,
    )


def _length(points_m: Floats) -> float:
    return float(polylines.arc_lengths(points_m)[-1]) if len(points_m) > 1 else 0.0


def _heights(lane: Lane, segments: int) -> Floats:
    """(segments) heights where segments of equal length begin."""
    along = polylines.arc_lengths(lane.centre_m)
    heights: Floats = np.interp(np.arange(segments) / max(segments, 1) * along[-1], along, lane.z_m)
    return heights


def _restarting_sums(lengths: Floats, counts: Ints) -> Floats:
    """Distance before each segment on its own lane."""
    parts = np.split(lengths, np.cumsum(counts)[:-1]) if len(counts) else []
    sums = [np.concatenate([[0.0], np.cumsum(part)[:-1]]) for part in parts]
    return np.concatenate(sums) if sums else np.zeros(0)


def _pieces(line_m: Floats) -> Floats:
    """(N, 10, 2) consecutive pieces of a lane; the last one is resampled to its own length."""
    total = _length(line_m)
    reach = (PIECE_POINTS - 1) * PIECE_SPACING_M
    starts = np.arange(0.0, max(total - 1.0, 1e-6), reach)
    stops = np.minimum(starts + reach, total)
    along = starts[:, None] + (stops - starts)[:, None] * np.linspace(0.0, 1.0, PIECE_POINTS)
    return polylines.points_at(line_m, along)[0]


def _kinds(lanes: tuple[Lane, ...], counts: Ints) -> Floats:
    kinds = np.zeros((len(lanes), 4))
    for row, lane in enumerate(lanes):
        kinds[row, {"freeway": 0, "street": 1}.get(lane.kind, 2)] = 1.0
        kinds[row, 3] = lane.interpolating
    return np.repeat(kinds, counts, axis=0)


def _pixels(
    road: RoadMap, lanes: tuple[Lane, ...], points: tuple[Floats, ...]
) -> tuple[Floats, Ints]:
    """Points of lanes, lines, edges, areas and stop signs, with their channels."""
    channel_of = {name: row for row, name in enumerate(ROAD_CHANNELS)}
    drawn: list[tuple[Floats, str]] = []
    for lane, line in zip(lanes, points, strict=True):
        drawn.append((line, lane.kind if lane.kind in channel_of else "street"))
        if lane.interpolating:
            drawn.append((line, "interpolating"))
    drawn += [(_dense(line.points_m), "line") for line in road.lines]
    drawn += [(_dense(line.points_m), "edge") for line in road.edges]
    drawn += [(_outline(area), area.kind.removeprefix("speed_")) for area in road.polygons]
    drawn += [(sign.position_m.reshape(1, 2), "bump") for sign in road.stop_signs]
    if not drawn:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    channel = np.concatenate([np.full(len(line), channel_of[name]) for line, name in drawn])
    return np.concatenate([line for line, _ in drawn]), channel


def _outline(area: Polygon) -> Floats:
    return _dense(np.concatenate([area.points_m, area.points_m[:1]]))


def _dense(points_m: Floats) -> Floats:
    return polylines.resample(points_m, LANE_SPACING_M) if len(points_m) > 1 else points_m


_PASSED_M = 3.0
"""A signal counts until a vehicle is this far past it."""


def lane_sequences(
    index: RoadIndex, lane: int, along_m: float, depth_m: float, most: int
) -> list[tuple[int, ...]]:
    """At most so many sequences of lanes from a place on a lane, each as deep as wanted."""
    found: list[tuple[int, ...]] = []
    stack: list[tuple[tuple[int, ...], float]] = [((lane,), float(index.length_m[lane]) - along_m)]
    while stack and len(found) < most:
        lanes, length = stack.pop()
        following = [each for each in index.following[lanes[-1]] if each not in lanes]
        if length >= depth_m or not following:
            found.append(lanes)
        else:
            stack += [((*lanes, each), length + index.length_m[each]) for each in following[::-1]]
    return found


def first_signal(
    index: RoadIndex, lanes: tuple[int, ...], along_m: float, signals: dict[str, SignalState]
) -> tuple[float, SignalState] | None:
    """Distance to the first signal that is not behind, and its state."""
    start = -along_m
    for lane in lanes:
        state = signals.get(index.lane_ids[lane])
        if state is not None and start > -_PASSED_M:
            return start, state
        start += float(index.length_m[lane])
    return None
