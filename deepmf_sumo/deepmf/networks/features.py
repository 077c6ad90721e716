"""Vector features around one vehicle: all positions, headings and velocities in its frame.

Arrays are in metres and seconds; the networks scale them. `Features` names them, with shapes.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks import raster
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.kinematics import Pose, pose_of, recent_change
from deepmf_sumo.deepmf.networks.lanes import RoadIndex, road_index
from deepmf_sumo.deepmf.networks.paths import NODE_SPACING_M, PathSet, path_set, signal_colour
from deepmf_sumo.scene import HISTORY_STEPS, Floats, Ints, View
from deepmf_sumo.scene.geometry import frames

NEIGHBOURS: Final = 24
AGENTS: Final = NEIGHBOURS + 1
LANES: Final = 48
PATH_AGENTS: Final = 8
MEANING: Final = 2
"""Version of the features' meaning: cached features of another version are not used."""

Features = dict[str, NDArray[np.float32] | NDArray[np.uint8]]
"""Input of a trajectory network for one vehicle:

===========  ============== ====================================================================
agents       (25, 11, 7)    x, y, cos, sin, vx, vy, valid; row 0 is the vehicle itself
agent_info   (25, 8)        length, width, one-hot vehicle, pedestrian, cyclist, other, AV, there
lanes        (48, 10, 2)    pieces of lanes, nearest first
lane_info    (48, 10)       freeway, street, bike, interpolating, limit, red..unknown, there
paths        (16, 121, 2)   see `paths.PathSet`
path_info    (16, 14)       see `paths.PathSet`
path_agents  (16, 8, 8)     s, d, vs, vd, cos, sin, length, there, of the vehicles nearest to each
motion       (7)            speed, acceleration, yaw rate, length, width, is AV, planner drives:
                            0 no, 1 yes, up to 2 where it has just taken over from a recording
raster       (bytes)        bits of `raster.draw`; not where the preset has no image
===========  ============== ====================================================================
"""

_KIND = {"vehicle": 0, "pedestrian": 1, "cyclist": 2, "other": 3}
_PATH_STRIDE = 2
"""Projection on paths looks at every other node: a chord of 4 m."""


def features(
    view: View, agent_id: str, preset: Preset, *, planner: bool = False
) -> tuple[Features, PathSet]:
    """Features of one agent, and its paths. Raises KeyError for an agent that is not in view.

    ``planner``: an automated planner drives it, which reacts differently from people.
    """
    index = road_index(view.road)
    tracks = view.history
    row, pose = tracks.row(agent_id), pose_of(view, agent_id)
    near = nearest_agents(view, row, NEIGHBOURS)
    agents, agent_info = agent_arrays(view, near, AGENTS, pose)
    lanes, lane_info = lane_arrays(view, index, LANES, pose)
    z_m = float(tracks.z_m[row, -1])
    place = pose.position_m, pose.heading_rad, pose.speed_mps
    paths = path_set(index, *place, view.signals, z_m)
    driver = 1.0 + view.av_recorded_steps / (HISTORY_STEPS - 1) if planner else 0.0
    motion = np.append(_motion(view, row), driver)
    arrays: Features = {
        "agents": agents.astype(np.float32),
        "agent_info": agent_info.astype(np.float32),
        "lanes": lanes.astype(np.float32),
        "lane_info": lane_info.astype(np.float32),
        "paths": paths.points_m.astype(np.float32),
        "path_info": paths.info.astype(np.float32),
        "path_agents": _path_agents(paths, agents, agent_info).astype(np.float32),
        "motion": motion.astype(np.float32),
    }
    if preset.raster:
        arrays["raster"] = raster.pack(raster.draw(view, index, preset, pose))
    return arrays, paths


def nearest_agents(view: View, row: int, count: int) -> Ints:
    """Rows: the agent itself, then up to ``count`` others by distance now."""
    position = view.history.position_m[:, -1]
    square = ((position - position[row]) ** 2).sum(-1)
    square[row] = -1.0
    return np.argsort(square, kind="stable")[: count + 1]


def agent_arrays(view: View, rows: Ints, size: int, pose: Pose) -> tuple[Floats, Floats]:
    """(size, 11, 7) and (size, 8), see `Features`; rows beyond the agents are zero."""
    tracks = view.history
    states = np.zeros((size, HISTORY_STEPS, 7))
    info = np.zeros((size, 8))
    count = len(rows)
    valid = tracks.valid[rows][..., None]
    states[:count, :, 0:2] = pose.to_local(tracks.position_m[rows])
    states[:count, :, 2:4] = frames.unit(pose.turn_rad(tracks.heading_rad[rows]))
    states[:count, :, 4:6] = pose.vectors(tracks.velocity_mps[rows])
    states[:count] *= valid
    states[:count, :, 6] = valid[..., 0]
    info[:count, 0:2] = tracks.size_m[rows, :2]
    info[np.arange(count), [2 + _KIND[tracks.kinds[row]] for row in rows]] = 1.0
    info[:count, 6] = [tracks.ids[row] == view.av_id for row in rows]
    info[:count, 7] = 1.0
    return states, info


def lane_arrays(view: View, index: RoadIndex, size: int, pose: Pose) -> tuple[Floats, Floats]:
    """(size, 10, 2) and (size, 10): the pieces nearest to a point two seconds ahead."""
    pieces, info = np.zeros((size, 10, 2)), np.zeros((size, 10))
    focus = pose.position_m + 2 * pose.speed_mps * frames.unit(pose.heading_rad)
    square = ((index.piece_m[:, 5] - focus) ** 2).sum(-1)
    farthest = np.partition(square, size)[size] if len(square) > size else np.inf
    near = np.flatnonzero(square <= farthest)  # a city has many pieces to sort
    rows = near[np.argsort(square[near], kind="stable")[:size]]
    count = len(rows)
    pieces[:count] = pose.to_local(index.piece_m[rows])
    info[:count, 0:4] = index.piece_kind[rows]
    info[:count, 4] = index.limit_mps[index.piece_lane[rows]]
    info[:count, 9] = 1.0
    if view.signals:
        for number, lane in enumerate(index.piece_lane[rows]):
            state = view.signals.get(index.lane_ids[lane])
            if state is not None:
                info[number, 5 + signal_colour(state)] = 1.0
    return pieces, info


def path_feet(points_m: Floats, query_m: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Queries (Q, 2) on paths (R, 121, 2): along, left (R, Q) m and the paths' tangents there."""
    x, y = np.ascontiguousarray(np.moveaxis(points_m[:, ::_PATH_STRIDE], -1, 0))  # (R, 61) each
    query_x, query_y = query_m.T
    square = (query_x[:, None] - x[:, None]) ** 2 + (query_y[:, None] - y[:, None]) ** 2
    best = square.argmin(-1)  # (R, Q)
    row = np.arange(len(x))[:, None]
    start = np.minimum(best, x.shape[1] - 2)
    step_x, step_y = x[row, start + 1] - x[row, start], y[row, start + 1] - y[row, start]
    length = np.maximum(np.sqrt(step_x**2 + step_y**2), 1e-9)
    cos, sin = step_x / length, step_y / length
    away_x, away_y = query_x - x[row, best], query_y - y[row, best]
    along = best * (NODE_SPACING_M * _PATH_STRIDE) + away_x * cos + away_y * sin
    return along, cos * away_y - sin * away_x, cos, sin


def _path_agents(paths: PathSet, agents: Floats, info: Floats) -> Floats:
    """(16, 8, 8) the eight agents nearest to each path, in path coordinates."""
    out = np.zeros((len(paths.points_m), PATH_AGENTS, 8))
    there = np.flatnonzero(info[1:, 7]) + 1
    rows = np.flatnonzero(paths.valid)
    if len(there) == 0:
        return out
    now = agents[there, -1]
    along, left, cos, sin = path_feet(paths.points_m[rows], now[:, 0:2])
    cost = np.abs(left) + 0.05 * np.abs(along) + 10.0 * (along < -5.0)
    order = np.argsort(cost, axis=1, kind="stable")[:, :PATH_AGENTS]

    def pick(values: Floats) -> Floats:
        return np.take_along_axis(values, order, 1)

    vx, vy, hx, hy = now[:, 4], now[:, 5], now[:, 2], now[:, 3]
    columns = [
        along, left, vx * cos + vy * sin, vy * cos - vx * sin,
        hx * cos + hy * sin, hy * cos - hx * sin,
        np.broadcast_to(info[there, 0], along.shape), np.ones_like(along),
    ]  # fmt: skip
    picked = np.stack([pick(column) for column in columns], axis=-1)
    out[rows, : picked.shape[1]] = picked
    return out


def _motion(view: View, row: int) -> Floats:
    """(6) speed, acceleration and yaw rate over the last half second, size, is AV."""
    tracks = view.history
    gain, yaw = recent_change(tracks, np.array([row]), view.dt_s)
    is_av = float(tracks.ids[row] == view.av_id)
    speed = tracks.speed_mps[row, -1]
    return np.array([speed, gain[0], yaw[0], *tracks.size_m[row, :2], is_av])
