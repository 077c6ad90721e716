"""Coarse routes of many vehicles along the lane graph, and their relations: crossing, following.

`paths` prepares one vehicle's paths finely enough to drive on. Features of a vehicle's relations to
all others need the routes of many vehicles in a few milliseconds, to the metre.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.datatypes import Bools, Floats, Ints, RoadMap, SignalState, View
from deepmf_sumo.geometry import frames
from deepmf_sumo.geometry.ground import clear, on_nearest_level
from deepmf_sumo.geometry.lane_map import per_road
from deepmf_sumo.predictors.kinematics import Motion, pose_of
from deepmf_sumo.predictors.lanes import RoadIndex, first_signal, lane_sequences, road_index
from deepmf_sumo.predictors.paths import signal_colour

NODES: Final = 46
SPACING_M: Final = 4.0
"""Routes reach 180 m."""

_REACH_M = 5.0
_TURN_RAD = np.deg2rad(60.0)
_CELL_M = 8.0
_STARTS = 3
"""Start lanes of a vehicle, and continuations of each of them."""
_ROUTES_OF_START = (5, 2, 2)
_AHEAD_S, _AHEAD_M, _MOST_M = 8.0, 60.0, (NODES - 1) * SPACING_M
_ALONG = np.arange(NODES) * SPACING_M
_NO_STOP_M = 200.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Routes:
    """R routes, those of a vehicle together, the likeliest start lane first.

    Attributes:
        owner: (R) row of the vehicle in the arguments.
        rank: (R) 0 for the first route of each vehicle.
        node_m: (R, 46, 2) every 4 m along the lanes, straight on past the end of the graph.
        node_z_m: (R, 46) heights of the lanes there.
        direction: (R, 46, 2) unit vectors along the lanes.
        left_m, turn_rad: (R) the vehicle's offset from the start lane and its heading to it.
        end_m: (R) length of the lane graph, at most 180 m. limit_mps: (R) 0 where unknown.
        stop_m: (R) distance to the first signal, 200 without one.
        signal: (R, 4) one-hot red, yellow, green, unknown; zeros without a signal.
    """

    owner: Ints
    rank: Ints
    node_m: Floats
    node_z_m: Floats
    direction: Floats
    left_m: Floats
    turn_rad: Floats
    end_m: Floats
    limit_mps: Floats
    stop_m: Floats
    signal: Floats


class _Pairs(NamedTuple):
    """Vehicles and segments near them: along the segment, left of it, distance, turn to it."""

    vehicle: Ints
    segment: Ints
    along_m: Floats
    left_m: Floats
    apart_m: Floats
    turn_rad: Floats


class _Feet(NamedTuple):
    """Feet of vehicles on lanes, cheapest first within each vehicle."""

    vehicle: Ints
    segment: Ints
    lane: Ints
    along_m: Floats
    left_m: Floats
    turn_rad: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """Segments sorted by the 8 m cell of their start; ``key`` is that of the sorted ones."""

    key: Ints
    segment: Ints
    low_m: Floats
    rows: int


def lane_routes(
    road: RoadMap,
    position_m: Floats,
    heading_rad: Floats,
    speed_mps: Floats,
    signals: dict[str, SignalState],
    z_m: Floats | None = None,
) -> Routes:
    """Routes of V vehicles: positions (V, 2), headings (V), speeds (V). Off the lanes: none.

    Where roads cross they start on the level nearest to the vehicles' heights (V), if given.
    """
    index, grid = road_index(road), _grid(road)
    feet = _feet(index, grid, position_m, heading_rad, z_m)
    owner, rank, foot_of, chains = [], [], [], []
    taken: dict[int, int] = {}
    starts: dict[int, int] = {}
    for foot, vehicle in enumerate(feet.vehicle.tolist()):
        number = starts.get(vehicle, 0)
        if number == _STARTS:
            continue
        starts[vehicle] = number + 1
        depth = min(_AHEAD_S * float(speed_mps[vehicle]) + _AHEAD_M, _MOST_M)
        lane, along = int(feet.lane[foot]), float(feet.along_m[foot])
        for chain in lane_sequences(index, lane, along, depth, _ROUTES_OF_START[number]):
            owner.append(vehicle)
            rank.append(taken.get(vehicle, 0))
            taken[vehicle] = rank[-1] + 1
            foot_of.append(foot)
            chains.append(chain)
    picked = np.array(foot_of, np.int64)
    return Routes(
        owner=np.array(owner, np.int64),
        rank=np.array(rank, np.int64),
        left_m=feet.left_m[picked],
        turn_rad=feet.turn_rad[picked],
        limit_mps=index.limit_mps[feet.lane[picked]],
        **_geometry(index, feet, picked, chains),
        **_stops(index, feet, picked, chains, signals),
    )


@per_road
def _grid(road: RoadMap) -> _Grid:
    index = road_index(road)
    start = index.map.start_m
    low = start.min(0) - 2 * _CELL_M if len(start) else np.zeros(2)
    cell = np.floor((start - low) / _CELL_M).astype(np.int64)
    rows = int(cell[:, 1].max()) + 3 if len(cell) else 1
    key = cell[:, 0] * rows + cell[:, 1]
    segment = np.argsort(key, kind="stable")
    return _Grid(
        key=key[segment],
        segment=segment,
        low_m=low,
        rows=rows,
    )


def on_lanes(
    road: RoadMap,
    position_m: Floats,
    heading_rad: Floats,
    reach_m: float,
    turn_rad: float,
    z_m: Floats | None = None,
) -> Bools:
    """(V) within reach (at most 8 m) and angle of any drivable lane; z as in `lane_routes`."""
    pairs = _pairs(road_index(road), _grid(road), position_m, heading_rad, z_m)
    near = (pairs.apart_m < reach_m) & (np.abs(pairs.turn_rad) < turn_rad)
    found = np.zeros(len(position_m), bool)
    found[pairs.vehicle[near]] = True
    return found


def passes_over(
    road: RoadMap, position_m: Floats, heading_rad: Floats, speed_mps: Floats, z_m: Floats
) -> Bools:
    """(V - 1) vehicles whose routes cross those of the first vehicle only on another level."""
    others = len(position_m) - 1
    over, level = np.zeros((2, others), bool)
    if not road_index(road).has_levels:
        return over
    routes = lane_routes(road, position_m, heading_rad, speed_mps, {}, z_m)
    mine = routes.owner == 0
    node, height = routes.node_m[mine].reshape(-1, 2), routes.node_z_m[mine].reshape(-1)
    for row in np.flatnonzero(~mine):
        other = routes.owner[row] - 1
        apart = routes.node_m[row][:, None] - node
        near = (apart**2).sum(-1) < SPACING_M**2
        same = ~clear(routes.node_z_m[row][:, None], height)
        over[other] |= near.any()
        level[other] |= (near & same).any()
    return over & ~level


def _pairs(
    index: RoadIndex,
    grid: _Grid,
    position_m: Floats,
    heading_rad: Floats,
    z_m: Floats | None,
) -> _Pairs:
    """Vehicles and the drivable segments near them."""
    vehicle, segment = _near(grid, position_m)
    drivable = index.drivable[index.map.lane[segment]]
    vehicle, segment = vehicle[drivable], segment[drivable]
    if z_m is not None and index.has_levels:
        level = on_nearest_level(vehicle, index.map.z_m[segment], z_m[vehicle])
        vehicle, segment = vehicle[level], segment[level]
    direction = index.direction[segment]
    offset = position_m[vehicle] - index.map.start_m[segment]
    share = np.clip((offset * direction).sum(-1), 0.0, index.step_m[segment])
    away = offset - share[:, None] * direction
    ahead = frames.unit(heading_rad)[vehicle]
    cross = direction[:, 0] * ahead[:, 1] - direction[:, 1] * ahead[:, 0]
    return _Pairs(
        vehicle,
        segment,
        share,
        direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0],
        np.hypot(away[:, 0], away[:, 1]),
        np.arctan2(cross, (direction * ahead).sum(-1)),
    )


def _feet(
    index: RoadIndex,
    grid: _Grid,
    position_m: Floats,
    heading_rad: Floats,
    z_m: Floats | None,
) -> _Feet:
    """The foot of each vehicle on each lane within reach and angle."""
    pairs = _pairs(index, grid, position_m, heading_rad, z_m)
    kept = np.flatnonzero((pairs.apart_m < _REACH_M) & (np.abs(pairs.turn_rad) < _TURN_RAD))
    kept = kept[np.argsort(pairs.apart_m[kept], kind="stable")]
    lane = index.map.lane[pairs.segment[kept]]
    _, first = np.unique(pairs.vehicle[kept] * (len(index.lane_ids) + 1) + lane, return_index=True)
    kept = kept[first]
    cost = pairs.apart_m[kept] + 4 * np.abs(pairs.turn_rad[kept])
    kept = kept[np.lexsort((cost, pairs.vehicle[kept]))]
    segment = pairs.segment[kept]
    return _Feet(
        pairs.vehicle[kept],
        segment,
        index.map.lane[segment],
        index.along_m[segment] + pairs.along_m[kept],
        pairs.left_m[kept],
        pairs.turn_rad[kept],
    )


def _near(grid: _Grid, position_m: Floats) -> tuple[Ints, Ints]:
    """Pairs of a vehicle and a segment that starts in its cell or one of the eight around it.

    Not by `LaneMap.feet`: features depend on which segments choose the level, and on their order.
    """
    cell = np.floor((position_m - grid.low_m) / _CELL_M).astype(np.int64)
    inside = (cell[:, 1] >= 1) & (cell[:, 1] < grid.rows - 1)
    vehicle = np.repeat(np.flatnonzero(inside), 3)
    column = cell[inside, 0][:, None] + np.array([-1, 0, 1])
    low = (column * grid.rows + cell[inside, 1][:, None] - 1).reshape(-1)
    begin = np.searchsorted(grid.key, low)
    count = np.searchsorted(grid.key, low + 3) - begin
    place = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(vehicle, count), grid.segment[np.repeat(begin, count) + place]


def _geometry(
    index: RoadIndex, feet: _Feet, picked: Ints, chains: list[tuple[int, ...]]
) -> dict[str, Floats]:
    """Nodes, directions and ends of the routes."""
    node, direction = np.empty((2, len(chains), NODES, 2))
    height = np.empty((len(chains), NODES))
    end = np.empty(len(chains))
    first_of = index.map.first
    for row, (foot, lanes) in enumerate(zip(picked.tolist(), chains, strict=True)):
        spans = [np.arange(feet.segment[foot], first_of[lanes[0] + 1])]
        spans += [np.arange(first_of[lane], first_of[lane + 1]) for lane in lanes[1:]]
        segment = np.concatenate(spans)
        length = index.step_m[segment]
        before = np.cumsum(length) - length
        first = feet.along_m[foot] - index.along_m[feet.segment[foot]]
        at = np.maximum(np.searchsorted(before, _ALONG + first, side="right") - 1, 0)
        direction[row] = index.direction[segment[at]]
        height[row] = index.map.z_m[segment[at]]
        on = _ALONG + first - before[at]
        node[row] = index.map.start_m[segment[at]] + on[:, None] * direction[row]
        end[row] = before[-1] + length[-1] - first
    return {
        "node_m": node,
        "node_z_m": height,
        "direction": direction,
        "end_m": np.minimum(end, _MOST_M),
    }


def _stops(
    index: RoadIndex,
    feet: _Feet,
    picked: Ints,
    chains: list[tuple[int, ...]],
    signals: dict[str, SignalState],
) -> dict[str, Floats]:
    """Distance and colour of the first signal that is not behind."""
    stop, colour = np.full(len(chains), _NO_STOP_M), np.zeros((len(chains), 4))
    if not signals:
        return {"stop_m": stop, "signal": colour}
    for row, (foot, lanes) in enumerate(zip(picked.tolist(), chains, strict=True)):
        met = first_signal(index, lanes, float(feet.along_m[foot]), signals)
        if met is not None:
            stop[row] = min(met[0], _NO_STOP_M)
            colour[row, signal_colour(met[1])] = 1.0
    return {"stop_m": stop, "signal": colour}


LANES: Final = 50
"""Columns of `lane_columns`."""
PLACE: Final = 20
"""Column of the offset from the AV's nearest route."""
MEETING: Final = slice(32, 43)
"""Columns of the soonest meeting of two routes: least distance; distances of the vehicle and of the
AV to it; their times, and the difference; angle (cos, sin); met; whether each arrives in 8 s."""

_FAR = 4.0
_MEET_M = 2.5
"""Routes whose centre lines come nearer than this meet."""
_NODES_OWN = 36
"""Nodes of other vehicles' routes that are compared: 140 m."""
_ELSEWHERE_M = 400.0
"""Distance of nodes of which one passes over the other: above the cap of all features."""
_TIME_CAP_S = 16.0
_LEAST_MPS = 4.0
"""Times of arrival are at this speed at least: a vehicle that stands may drive off."""


def lane_columns(view: View, rows: Ints, motion: Motion) -> Floats:
    """(V - 1, 50) of all but the AV, which is the first of the rows.

    Own lane (11), the AV's lane (9), position on the AV's routes (7), the AV's position on the own
    routes (5), soonest meeting of two routes (11), of the first routes (1), shares that meet (3),
    order on the lanes (3).
    """
    tracks = view.history
    routes = lane_routes(
        view.road,
        tracks.position_m[rows, -1],
        tracks.heading_rad[rows, -1],
        tracks.speed_mps[rows, -1],
        view.signals,
        tracks.z_m[rows, -1],
    )
    levels = road_index(view.road).has_levels
    height = routes.node_z_m if levels else np.zeros(routes.node_z_m.shape)
    pose = pose_of(view, tracks.ids[rows[0]])
    node, direction = pose.to_local(routes.node_m), pose.vectors(routes.direction)
    count = len(rows) - 1
    place = _place_on_ego(routes, node, direction, motion)
    own_place = _ego_on_own(routes, node, direction, count)
    return np.concatenate(
        [
            _own_lane(routes, count),
            np.broadcast_to(_own_lane_of(routes, 0)[:9], (count, 9)),
            place,
            own_place,
            _meetings(routes, node, direction, height, motion, count),
            _order(place, own_place),
        ],
        axis=1,
    )


def _own_lane_of(routes: Routes, owner: int) -> Floats:
    """(11) of the first route: offset, turn, length, limit, stop; number; there; signal (4)."""
    out = np.zeros(11)
    mine = np.flatnonzero(routes.owner == owner)
    if len(mine) == 0:
        return out
    row = mine[0]
    out[0:5] = (
        routes.left_m[row] / 3, routes.turn_rad[row] * 2, routes.end_m[row] / 100,
        routes.limit_mps[row] / 15, min(routes.stop_m[mine].min() / 50, _FAR),
    )  # fmt: skip
    out[5:7] = len(mine) / 5, 1.0
    stop = mine[routes.stop_m[mine].argmin()]
    out[7:11] = routes.signal[stop]
    return out


def _own_lane(routes: Routes, count: int) -> Floats:
    return np.stack([_own_lane_of(routes, owner) for owner in range(1, count + 1)])


def _place_on_ego(routes: Routes, node: Floats, direction: Floats, motion: Motion) -> Floats:
    """(V - 1, 7) of the AV's route nearest to each: offset, along, alignment, gaps; there."""
    position = motion.position_m[1:]
    out = np.zeros((len(position), 7))
    out[:, 0] = _FAR
    mine = np.flatnonzero(routes.owner == 0)
    if len(mine) == 0:
        return out
    along, left, cos, sin = _feet_on_routes(node[mine], direction[mine], position)  # (E, C)
    best = np.abs(left).argmin(0)
    each = np.arange(len(position))
    unit = frames.unit(motion.heading_rad[1:])
    along, left = along[best, each], left[best, each]
    out[:, 0] = np.minimum(np.abs(left) / 5, _FAR)
    out[:, 1] = np.clip(along / 50, -1, _FAR)
    out[:, 2] = cos[best, each] * unit[:, 0] + sin[best, each] * unit[:, 1]
    out[:, 3] = np.clip(left / 5, -_FAR, _FAR)
    out[:, 4] = np.clip(along / max(8 * float(motion.speed_mps[0]), 8.0), -1, _FAR)
    out[:, 5] = best == 0
    out[:, 6] = 1.0
    return out


def _ego_on_own(routes: Routes, node: Floats, direction: Floats, count: int) -> Floats:
    """(V - 1, 5) the AV on the nearest own route: offset, along, alignment, first; there."""
    out = np.zeros((count, 5))
    out[:, 0] = _FAR
    others = np.flatnonzero(routes.owner > 0)
    if len(others) == 0:
        return out
    along, left, cos, _ = _feet_on_routes(node[others], direction[others], np.zeros((1, 2)))
    owner = routes.owner[others]
    order = np.lexsort((np.abs(left[:, 0]), owner))
    owner, first = np.unique(owner[order], return_index=True)
    pick = order[first]
    out[owner - 1] = np.stack(
        [
            np.minimum(np.abs(left[pick, 0]) / 5, _FAR), np.clip(along[pick, 0] / 50, -1, _FAR),
            cos[pick, 0], routes.rank[others[pick]] == 0, np.ones(len(pick)),
        ],
        axis=1,
    )  # fmt: skip
    return out


def _feet_on_routes(
    node: Floats, direction: Floats, query: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Queries (Q, 2) on routes (R, N, 2): along, left (R, Q) and the route's direction there.

    Behind the first node and past the last the route goes on straight.
    """
    offset = query[None, :, None] - node[:, None]
    best = (offset * offset).sum(-1).argmin(-1)
    row = np.arange(len(node))[:, None]
    way = direction[row, best]
    away = query[None] - node[row, best]
    along = best * SPACING_M + (away * way).sum(-1)
    left = way[..., 0] * away[..., 1] - way[..., 1] * away[..., 0]
    return along, left, way[..., 0], way[..., 1]


class _Met(NamedTuple):
    """First meetings of pairs of routes: columns (R, E, 11) of `MEETING`, met, seconds until then.

    Of pairs that do not meet it is the point of least distance; their ``late`` is 40 and this
    distance, later than all that meet.
    """

    columns: Floats
    met: Bools
    late: Floats


def _meetings(
    routes: Routes, node: Floats, direction: Floats, height: Floats, motion: Motion, count: int
) -> Floats:
    """(V - 1, 15) the soonest meeting (11); distance of the first routes; shares that meet (3)."""
    out = np.zeros((count, 15))
    out[:, 0:2], out[:, 2:8] = _FAR, 2.0
    mine, others = np.flatnonzero(routes.owner == 0), np.flatnonzero(routes.owner > 0)
    if len(mine) == 0 or len(others) == 0:
        return out
    owner = routes.owner[others]
    found = _first_meetings(
        node[others], direction[others], node[mine], direction[mine],
        _passing(height[others], height[mine]) if height.any() else None,
        np.maximum(motion.speed_mps[owner], _LEAST_MPS)[:, None],
        max(float(motion.speed_mps[0]), _LEAST_MPS),
    )  # fmt: skip
    soon = found.met & (found.late < 8)
    for other in np.unique(owner):
        part = np.flatnonzero(owner == other)
        row, column = np.divmod(int(found.late[part].argmin()), len(mine))
        out[other - 1, :11] = found.columns[part[row], column]
        out[other - 1, 11] = found.columns[part[0], 0, 0]
        out[other - 1, 12:14] = found.met[part].mean(), soon[part].mean()
        out[other - 1, 14] = soon[part[0], 0]
    return out


def _first_meetings(
    own: Floats,
    own_direction: Floats,
    ego: Floats,
    ego_direction: Floats,
    passing_over: Bools | None,
    own_mps: Floats,
    ego_mps: float,
) -> _Met:
    """First meetings of routes (R, N, 2) and the AV's (E, N, 2); speeds (R, 1) and the AV's."""
    apart = _apart(own[:, :_NODES_OWN], ego)  # (R, 36, E, 46)
    if passing_over is not None:
        apart[passing_over] = _ELSEWHERE_M**2
    nearest = apart.argmin(3)
    square = np.take_along_axis(apart, nearest[..., None], 3)[..., 0]
    least = np.sqrt(square)  # (R, 36, E)
    meets = least < _MEET_M
    met: Bools = np.asarray(meets.any(1))
    first = np.where(met, meets.argmax(1), least.argmin(1))  # (R, E) own node
    ego_node = np.take_along_axis(nearest, first[:, None], 1)[:, 0]
    own_m, ego_m = first * SPACING_M, ego_node * SPACING_M
    own_s = np.minimum(own_m / own_mps, _TIME_CAP_S)
    ego_s = np.minimum(ego_m / ego_mps, _TIME_CAP_S)
    way = own_direction[np.arange(len(own))[:, None], first]
    ego_way = ego_direction[np.arange(len(ego))[None], ego_node]
    columns = np.stack(
        [
            np.minimum(least.min(1), 40.0) / 10, np.minimum(own_m / 50, _FAR),
            np.minimum(ego_m / 50, _FAR), own_s / 8, ego_s / 8, (own_s - ego_s) / 8,
            (way * ego_way).sum(-1), ego_way[..., 0] * way[..., 1] - ego_way[..., 1] * way[..., 0],
            met, own_m < 8 * own_mps, ego_m < 8 * ego_mps,
        ],
        axis=-1,
    )  # fmt: skip
    late = np.where(met, np.maximum(own_s, ego_s), 40.0 + least.min(1))
    return _Met(columns, met, late)


def _passing(own_z_m: Floats, ego_z_m: Floats) -> Bools:
    """(R, 36, E, 46) nodes of which one passes over the other."""
    return clear(own_z_m[:, :_NODES_OWN, None, None], ego_z_m)


def _apart(own: Floats, ego: Floats) -> NDArray[np.float32]:
    """(R, N, E, M) squared distances of nodes (R, N, 2) and (E, M, 2)."""
    first = own.reshape(-1, 2, 1).astype(np.float32)
    second = ego.reshape(-1, 2).T.astype(np.float32)
    square = first[:, 0] - second[0]
    square *= square
    across = first[:, 1] - second[1]
    across *= across
    square += across
    apart: NDArray[np.float32] = square.reshape(*own.shape[:2], *ego.shape[:2])
    return apart


def _order(place: Floats, own_place: Floats) -> Floats:
    """(V - 1, 3) 1 / rank ahead on the AV's route; the same behind the AV; is behind."""
    on_route = (place[:, 0] < 0.4) & (place[:, 2] > 0.5)
    ahead = on_route & (place[:, 1] > 0)
    behind = (own_place[:, 0] < 0.4) & (own_place[:, 2] > 0.5) & (own_place[:, 1] > 0)
    out = np.zeros((len(place), 3))
    for column, (there, gap) in enumerate(((ahead, place[:, 1]), (behind, own_place[:, 1]))):
        rows = np.flatnonzero(there)
        out[rows, column] = 1 / (1 + gap[rows].argsort(kind="stable").argsort(kind="stable"))
    out[:, 2] = behind
    return out
