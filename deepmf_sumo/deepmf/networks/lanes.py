"""The road as networks see it: lanes near poses, sequences of lanes ahead, paths from a pose.

A vehicle's paths are those that it can take: along the lane graph, and a fan off the lanes. Every
path begins at the pose with the pose's heading, joins its lane within three seconds of driving, and
is given at equal distances, so that a point at any distance is one look-up.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints, Lane, Polygon, RoadMap, SignalState
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import ground_of, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import LaneMap, per_road
from deepmf_sumo.scene.signals import Colour, colour

LANE_SPACING_M = 1.0
PIECE_POINTS = 10
PIECE_SPACING_M = 2.0
"""A lane piece, one polyline of VectorNet, is 18 m long."""

ROAD_CHANNELS = (
    "freeway", "street", "bike", "interpolating", "line", "edge", "crosswalk", "bump", "driveway",
)  # fmt: skip
"""Kinds of road points; stop signs are drawn with the speed bumps."""

_CELL_M = 8.0
_PASSED_M = 3.0
"""A signal counts until a vehicle is this far past it."""


class Foot(NamedTuple):
    """The nearest point of a lane to a pose; ``left_m`` is the pose's offset to the left."""

    lane: int
    along_m: float
    left_m: float
    distance_m: float
    turn_rad: float
    """Heading of the pose minus heading of the lane."""


class Near(NamedTuple):
    """Pairs of a pose and a drivable segment near it.

    Distance along the segment, offset to its left, distance from it, turn from its direction.
    """

    pose: Ints
    segment: Ints
    along_m: Floats
    left_m: Floats
    apart_m: Floats
    turn_rad: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Segments sorted by the 8 m cell of their start; ``key`` is that of the sorted segments."""

    key: Ints
    segment: Ints
    low_m: Floats
    rows: int

    @classmethod
    def of(cls, start_m: Floats) -> "Cells":
        """The cells of segments that start at points (S, 2)."""
        low = start_m.min(0) - 2 * _CELL_M if len(start_m) else np.zeros(2)
        cell = np.floor((start_m - low) / _CELL_M).astype(np.int64)
        rows = int(cell[:, 1].max()) + 3 if len(cell) else 1
        key = cell[:, 0] * rows + cell[:, 1]
        segment = np.argsort(key, kind="stable")
        return cls(key=key[segment], segment=segment, low_m=low, rows=rows)

    def around(self, position_m: Floats) -> tuple[Ints, Ints]:
        """Pairs of a position (V, 2) and a segment that starts in its cell or the eight around it.

        Not by `LaneMap.feet`: features depend on which segments choose the level, and their order.
        """
        cell = np.floor((position_m - self.low_m) / _CELL_M).astype(np.int64)
        inside = (cell[:, 1] >= 1) & (cell[:, 1] < self.rows - 1)
        pose = np.repeat(np.flatnonzero(inside), 3)
        column = cell[inside, 0][:, None] + np.array([-1, 0, 1])
        low = (column * self.rows + cell[inside, 1][:, None] - 1).reshape(-1)
        begin = np.searchsorted(self.key, low)
        count = np.searchsorted(self.key, low + 3) - begin
        place = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        return np.repeat(pose, count), self.segment[np.repeat(begin, count) + place]


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
        cells: where segments start.
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
    cells: Cells

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

    def near(self, position_m: Floats, heading_rad: Floats, z_m: Floats | None) -> Near:
        """Poses (V) and the drivable segments within about 8 m; levels as in `feet`."""
        pose, segment = self.cells.around(position_m)
        drivable = self.drivable[self.map.lane[segment]]
        pose, segment = pose[drivable], segment[drivable]
        if z_m is not None and self.has_levels:
            level = on_nearest_level(pose, self.map.z_m[segment], z_m[pose])
            pose, segment = pose[level], segment[level]
        direction = self.direction[segment]
        offset = position_m[pose] - self.map.start_m[segment]
        share = np.clip((offset * direction).sum(-1), 0.0, self.step_m[segment])
        away = offset - share[:, None] * direction
        ahead = frames.unit(heading_rad)[pose]
        cross = direction[:, 0] * ahead[:, 1] - direction[:, 1] * ahead[:, 0]
        return Near(
            pose,
            segment,
            share,
            direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0],
            np.hypot(away[:, 0], away[:, 1]),
            np.arctan2(cross, (direction * ahead).sum(-1)),
        )

    def on_lanes(
        self,
        position_m: Floats,
        heading_rad: Floats,
        reach_m: float,
        turn_rad: float,
        z_m: Floats | None = None,
    ) -> Bools:
        """(V) poses within reach (at most 8 m) and angle of any drivable lane."""
        pairs = self.near(position_m, heading_rad, z_m)
        close = (pairs.apart_m < reach_m) & (np.abs(pairs.turn_rad) < turn_rad)
        found = np.zeros(len(position_m), bool)
        found[pairs.pose[close]] = True
        return found


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
        cells=Cells.of(lane_map.start_m),
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


def signal_colour(signal: SignalState) -> int:
    """0 red, 1 yellow, 2 green, 3 unknown."""
    found = colour(signal)
    return len(_COLOURS) if found is None else _COLOURS.index(found)


LANE_PATHS: Final = 11
FAN_TURNS_RAD: Final = (0.0, 0.5, -0.5, 1.3, -1.3)
PATHS: Final = LANE_PATHS + len(FAN_TURNS_RAD)
NODES: Final = 121
NODE_SPACING_M: Final = 2.0

_REACH_M = 6.5
_TURN_RAD = np.deg2rad(52.0)
_MAX_ROUTES = 48
_DUPLICATE_M = 1.2
_NO_STOP_M = 200.0
_COLOURS: Final[tuple[Colour, ...]] = ("red", "yellow", "green")
_ALONG = np.arange(NODES) * NODE_SPACING_M


class PathInfo(IntEnum):
    """Columns of ``path_info``.

    OFFSET and TURN of the pose to the start lane; END of the lane graph along the path; the LIMIT,
    0 where it is unknown; the STOP line ahead, 200 m where there is none, and its signal; DISTANCE
    to the start lane; the number of LANES.
    """

    THERE, FAN, OFFSET, TURN, END, LIMIT, STOP = range(7)
    NO_SIGNAL, RED, YELLOW, GREEN, UNKNOWN, DISTANCE, LANES = range(7, 14)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathSet:
    """Up to 16 paths in the vehicle's frame; those that are there first, lane paths before the fan.

    Attributes:
        points_m: (16, 121, 2) every 2 m, straight on past the end of the lane graph.
        info: (16) of `PathInfo`.
        lanes: rows of the lanes of each lane path.
    """

    points_m: Floats
    info: Floats
    lanes: tuple[tuple[int, ...], ...]

    @property
    def valid(self) -> Bools:
        """(16)."""
        return self.info[:, PathInfo.THERE] > 0


def path_set(
    index: RoadIndex,
    position_m: Floats,
    heading_rad: float,
    speed_mps: float,
    signals: dict[str, SignalState],
    z_m: float | None = None,
) -> PathSet:
    """The paths of a vehicle at a pose; see `RoadIndex.feet` for its height."""
    depth = min(8 * speed_mps + 60.0, 230.0)
    merge = max(3 * speed_mps, 10.0)
    routes = _routes(index, position_m, heading_rad, depth, z_m)
    points = np.zeros((PATHS, NODES, 2))
    info = np.zeros((PATHS, len(PathInfo)))
    lanes: list[tuple[int, ...]] = []
    if routes:
        lines, ends = _lines(index, routes)
        lines = _joined(lines, routes, merge)
        kept = _distinct(lines, int(depth / NODE_SPACING_M))[:LANE_PATHS]
        local = frames.to_local(lines[kept], position_m, heading_rad)
        points[: len(kept)] = local
        for row, pick in enumerate(kept):
            info[row] = _describe(index, routes[pick], ends[pick], signals)
            lanes.append(routes[pick][1])
    count = len(lanes)
    fan = slice(count, count + len(FAN_TURNS_RAD))
    points[fan] = _fan(merge)
    info[fan, [PathInfo.THERE, PathInfo.FAN, PathInfo.NO_SIGNAL]] = 1.0
    info[fan, PathInfo.STOP] = _NO_STOP_M
    return PathSet(points_m=points, info=info, lanes=tuple(lanes))


Route = tuple[Foot, tuple[int, ...]]


def _routes(
    index: RoadIndex, position_m: Floats, heading_rad: float, depth: float, z_m: float | None
) -> list[Route]:
    """Lane sequences from all start lanes, cheapest start first."""
    feet = index.feet(position_m, heading_rad, _REACH_M, float(_TURN_RAD), z_m)
    feet.sort(key=lambda foot: foot.distance_m + 4 * abs(foot.turn_rad))
    routes: list[Route] = []
    for foot in feet:
        most = _MAX_ROUTES - len(routes)
        found = lane_sequences(index, foot.lane, foot.along_m, depth, most)
        routes += [(foot, lanes) for lanes in found]
    return routes


def _lines(index: RoadIndex, routes: list[Route]) -> tuple[Floats, Floats]:
    """(R, 121, 2) centre lines from the foot on, and (R) where the lane graph ends."""
    lines = np.empty((len(routes), NODES, 2))
    ends = np.empty(len(routes))
    for row, (foot, lanes) in enumerate(routes):
        first, *rest = (index.map.line_m[lane] for lane in lanes)
        spacing = index.length_m[lanes[0]] / (len(first) - 1)
        at = min(foot.along_m / spacing, len(first) - 1 - 1e-6)
        base = int(at)
        start = first[base] + (at - base) * (first[base + 1] - first[base])
        points = np.concatenate([start[None], first[base + 1 :], *(line[1:] for line in rest)])
        step = np.diff(points, axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        keep = length > 1e-6
        direction = step[keep][-1] / length[keep][-1] if keep.any() else np.array([1.0, 0.0])
        along = np.concatenate([[0.0], np.cumsum(length)])
        ends[row] = along[-1]
        points = np.concatenate([points, points[-1:] + 400.0 * direction])
        along = np.append(along, along[-1] + 400.0)
        lines[row, :, 0] = np.interp(_ALONG, along, points[:, 0])
        lines[row, :, 1] = np.interp(_ALONG, along, points[:, 1])
    return lines, ends


def _joined(lines: Floats, routes: list[Route], merge_m: float) -> Floats:
    """The lines, shifted sideways so that they begin at the pose, with its heading (Hermite)."""
    left = np.array([foot.left_m for foot, _ in routes])[:, None]
    slope = np.tan(np.clip([foot.turn_rad for foot, _ in routes], -0.9, 0.9))[:, None]
    share = np.minimum(_ALONG / merge_m, 1.0)
    offset = left * (1 + 2 * share) * (1 - share) ** 2
    offset = offset + merge_m * slope * share * (1 - share) ** 2
    tangent = np.gradient(lines, axis=1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    return lines + offset[..., None] * normal


def _distinct(lines: Floats, nodes: int) -> list[int]:
    """Rows of lines that are somewhere more than 1.2 m from all rows kept before."""
    sampled = lines[:, : max(nodes, 2) : 3]
    kept: list[int] = []
    for row in range(len(lines)):
        apart = np.abs(sampled[kept] - sampled[row]).max(axis=(1, 2))
        if not kept or apart.min() > _DUPLICATE_M:
            kept.append(row)
        if len(kept) == LANE_PATHS:
            break
    return kept


def _describe(
    index: RoadIndex, route: Route, end_m: float, signals: dict[str, SignalState]
) -> Floats:
    """(14) see `PathInfo`."""
    foot, lanes = route
    info = np.zeros(len(PathInfo))
    info[PathInfo.THERE] = 1.0
    info[PathInfo.OFFSET], info[PathInfo.TURN] = foot.left_m, foot.turn_rad
    info[PathInfo.END] = min(end_m, _ALONG[-1])
    info[PathInfo.LIMIT] = index.limit_mps[lanes[0]]
    info[PathInfo.DISTANCE], info[PathInfo.LANES] = foot.distance_m, len(lanes)
    stop, signal = _NO_STOP_M, PathInfo.NO_SIGNAL
    met = first_signal(index, lanes, foot.along_m, signals)
    if met is not None:
        stop, signal = min(met[0], _NO_STOP_M), PathInfo(PathInfo.RED + signal_colour(met[1]))
    info[PathInfo.STOP], info[signal] = stop, 1.0
    return info


def _fan(merge_m: float) -> Floats:
    """(5, 121, 2) straight on, and arcs that turn by the fan's angles, then go straight."""
    reach = max(1.5 * merge_m, 18.0)
    turns = np.array(FAN_TURNS_RAD)[:, None]
    heading = turns * np.minimum((_ALONG[:-1] + NODE_SPACING_M / 2) / reach, 1.0)
    steps = NODE_SPACING_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    points = np.zeros((len(turns), NODES, 2))
    points[:, 1:] = np.cumsum(steps, axis=1)
    return points
