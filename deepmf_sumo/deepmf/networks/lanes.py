"""Lanes as features need them: nearest points to a pose, sequences of lanes ahead, drawn points."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, Lane, Polygon, RoadMap, SignalState
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.scene.geometry.ground import ground_of, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road

LANE_SPACING_M = 1.0
PIECE_POINTS = 10
PIECE_SPACING_M = 2.0
"""A lane piece, one polyline of VectorNet, is 18 m long."""

ROAD_CHANNELS = (
    "freeway", "street", "bike", "interpolating", "line", "edge", "crosswalk", "bump", "driveway",
)  # fmt: skip
"""Kinds of road points; stop signs are drawn with the speed bumps."""


class Foot(NamedTuple):
    """The nearest point of a lane to a pose; ``left_m`` is the pose's offset to the left."""

    lane: int
    along_m: float
    left_m: float
    distance_m: float
    turn_rad: float
    """Heading of the pose minus heading of the lane."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadIndex:
    """A road, prepared for features. L lanes that are longer than 0.1 m.

    Attributes:
        map: of the lanes, with a point every metre.
        lane_ids: (L). length_m: (L). limit_mps: (L) 0 where unknown.
        following: (L) rows of the lanes that follow. drivable: (L) False for bike lanes.
        direction: (S, 2) unit vectors of the map's segments. step_m: (S) their lengths.
        along_m: (S) how far along its lane each of them starts.
        has_levels: the road passes over itself somewhere.
        piece_m: (N, 10, 2). piece_kind: (N, 4) one-hot: freeway, street, bike or unknown,
            interpolating. piece_lane: (N) row of the lane.
        pixel_m: (Q, 2) points of everything drawn. pixel_channel: (Q) index in ROAD_CHANNELS.
    """

    map: LaneMap
    lane_ids: tuple[str, ...]
    length_m: Floats
    limit_mps: Floats
    following: tuple[tuple[int, ...], ...]
    drivable: Bools
    direction: Floats
    step_m: Floats
    along_m: Floats
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

        Where roads cross: only on lanes of the level nearest to its height, if that is given.
        """
        rows = self.map.around(position_m, reach_m)
        rows = rows[self.drivable[self.map.lane[rows]]]
        # Not the formula of `LaneMap.feet`: features depend on the last digit where a foot is on
        # the point between two segments.
        direction = self.direction[rows]
        offset = position_m - self.map.start_m[rows]
        share = np.clip((offset * direction).sum(-1), 0.0, self.step_m[rows])
        away = offset - share[:, None] * direction
        square = (away * away).sum(-1)
        aligned = direction @ np.array([np.cos(heading_rad), np.sin(heading_rad)])
        near = np.flatnonzero((square < reach_m**2) & (aligned > np.cos(turn_rad)))
        if z_m is not None and self.has_levels:
            one = np.zeros(len(near), np.int64)
            near = near[on_nearest_level(one, self.map.z_m[rows[near]], np.array(z_m))]
        near = near[np.argsort(square[near], kind="stable")]
        lanes, first = np.unique(self.map.lane[rows[near]], return_index=True)
        feet = []
        for lane, row in zip(lanes, near[first], strict=True):
            dx, dy = direction[row]
            turn = (heading_rad - np.arctan2(dy, dx) + np.pi) % (2 * np.pi) - np.pi
            feet.append(
                Foot(
                    int(lane),
                    float(self.along_m[rows[row]] + share[row]),
                    float(dx * offset[row, 1] - dy * offset[row, 0]),
                    float(np.sqrt(square[row])),
                    float(turn),
                )
            )
        return sorted(feet, key=lambda foot: foot.distance_m)


@per_road
def road_index(road: RoadMap) -> RoadIndex:
    """The index of a road."""
    lanes = tuple(lane for lane in road.lanes.values() if _length(lane.centre_m) > 0.1)
    lines = tuple(polylines.resample(lane.centre_m, LANE_SPACING_M) for lane in lanes)
    heights = [_heights(*each) for each in zip(lanes, lines, strict=True)]
    lane_map = LaneMap.of(lanes, lines, heights)
    step = np.maximum(np.hypot(*lane_map.vector_m.T), 1e-9)
    pieces = [_pieces(line) for line in lines]
    counts = np.array([len(piece) for piece in pieces], np.int64)
    pixel, channel = _pixels(road, lanes, lines)
    return RoadIndex(
        map=lane_map,
        lane_ids=tuple(lane.id for lane in lanes),
        length_m=np.array([_length(line) for line in lines]),
        limit_mps=np.array([lane.speed_limit_mps or 0.0 for lane in lanes]),
        following=tuple(
            tuple(lane_map.row[after] for after in lane.next if after in lane_map.row)
            for lane in lanes
        ),
        drivable=np.array([lane.kind != "bike" for lane in lanes], bool),
        direction=lane_map.vector_m / step[:, None],
        step_m=step,
        along_m=_restarting_sums(step, np.diff(lane_map.first)),
        has_levels=ground_of(road).has_levels,
        piece_m=np.concatenate([np.zeros((0, PIECE_POINTS, 2)), *pieces]),
        piece_kind=_kinds(lanes, counts),
        piece_lane=np.repeat(np.arange(len(lanes)), counts),
        pixel_m=pixel,
        pixel_channel=channel,
    )


def _length(points_m: Floats) -> float:
    return float(polylines.arc_lengths(points_m)[-1]) if len(points_m) > 1 else 0.0


def _heights(lane: Lane, line_m: Floats) -> Floats:
    """(P) heights of a lane at the points (P, 2) of its line, which are equally far apart."""
    along, last = polylines.arc_lengths(lane.centre_m), len(line_m) - 1
    return np.interp(np.arange(last + 1) / last * along[-1], along, lane.z_m)


def _restarting_sums(lengths: Floats, counts: Ints) -> Floats:
    """Distance before each segment on its own lane."""
    parts = np.split(lengths, np.cumsum(counts)[:-1]) if len(counts) else []
    sums = [np.concatenate([[0.0], np.cumsum(part)[:-1]]) for part in parts]
    return np.concatenate([np.zeros(0), *sums])


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
    """At most ``most`` sequences of lanes from a point of a lane, ``depth_m`` long if possible."""
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
    """Distance to the first signal that is not behind the vehicle, and its state."""
    start = -along_m
    for lane in lanes:
        state = signals.get(index.lane_ids[lane])
        if state is not None and start > -_PASSED_M:
            return start, state
        start += float(index.length_m[lane])
    return None
