"""Coarse routes of many vehicles along the lane graph.

`paths` prepares one vehicle's paths finely enough to drive on. Features of a vehicle's relations to
all others (`route_relations`) need the routes of many vehicles in a few milliseconds, to the metre.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.deepmf.networks.lanes import RoadIndex, first_signal, lane_sequences, road_index
from deepmf_sumo.deepmf.networks.paths import signal_colour
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, SignalState
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import clear, on_nearest_level
from deepmf_sumo.scene.geometry.lane_map import per_road

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
