"""Features of vehicles by their routes and the AV's: position, crossing, merging, following."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.kinematics import Motion, pose_of
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.deepmf.networks.routes import SPACING_M, Routes, lane_routes
from deepmf_sumo.scene import Bools, Floats, Ints, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import clear

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
