"""What a network reads of a view: `Features`, arrays in the frame of one vehicle.

Arrays are in metres and seconds; the networks scale them. `Features` names the arrays, with shapes,
and a class for each array names its columns: these names are the interface of all networks.

An image looks ahead along +x of the pose: a quarter of it lies behind. Pixel (row, column) covers
x = (row - pixels/4) * metres and y = (column - pixels/2) * metres.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.config import AGENT_CLASSES, Preset
from deepmf_sumo.deepmf.networks.lanes import (
    NODE_SPACING_M,
    PathSet,
    RoadIndex,
    path_set,
    road_index,
    signal_colour,
)
from deepmf_sumo.scene import (
    HISTORY_STEPS,
    AgentId,
    Bools,
    Bytes,
    Floats,
    Ints,
    SignalState,
    Tracks,
    View,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import AgentFrame, pose_of

Column = TypeVar("Column", bound=IntEnum)


class AgentState(IntEnum):
    """Columns of ``agents``: an agent at a step of the history."""

    X, Y, COS, SIN, VX, VY, SEEN = range(7)


class AgentInfo(IntEnum):
    """Columns of ``agent_info``: size, what kind it is, whether it is the AV."""

    LENGTH, WIDTH, VEHICLE, PEDESTRIAN, CYCLIST, OTHER, AV, THERE = range(8)


class LaneInfo(IntEnum):
    """Columns of ``lane_info``: the kind of lane, its limit (0 unknown), its signal."""

    FREEWAY, STREET, BIKE, INTERPOLATING, LIMIT, RED, YELLOW, GREEN, UNKNOWN, THERE = range(10)


class PathAgent(IntEnum):
    """Columns of ``path_agents``: an agent in coordinates of a path, ALONG and LEFT."""

    ALONG, LEFT, SPEED_ALONG, SPEED_LEFT, COS, SIN, LENGTH, THERE = range(8)


class OwnMotion(IntEnum):
    """Columns of ``motion``: the vehicle itself, and who drives it.

    PLANNER: 0 no planner, 1 a planner, up to 2 where it has just taken over from a recording.
    """

    SPEED, ACCEL, YAW_RATE, LENGTH, WIDTH, AV, PLANNER = range(7)


def span(first: IntEnum, last: IntEnum) -> slice:
    """The columns from one to another, both included."""
    return slice(int(first), int(last) + 1)


POSITION: Final = span(AgentState.X, AgentState.Y)
DIRECTION: Final = span(AgentState.COS, AgentState.SIN)
VELOCITY: Final = span(AgentState.VX, AgentState.VY)
"""Columns of ``agents``, two each."""


def stacked(columns: type[Column], values: Mapping[Column, Any], *shape: int) -> Floats:
    """(*shape, C) the values of all columns. Raises KeyError where one is missing."""
    array = np.empty((*shape, len(columns)))
    for column in columns:
        array[..., column] = values[column]
    return array


NEIGHBOURS: Final = 24
AGENTS: Final = NEIGHBOURS + 1
LANES: Final = 48
PATH_AGENTS: Final = 8
FEATURES_VERSION: Final = 2
"""Version of the features' meaning: cached features of another version are not used."""
POSITION_SCALE_M: Final = 30.0
SPEED_SCALE_MPS: Final = 15.0
"""Networks divide positions and speeds of agents by these."""

Features = dict[str, NDArray[np.float32] | NDArray[np.uint8]]
"""Input of a trajectory network for one vehicle:

===========  ============== ====================================================================
agents       (25, 11, 7)    `AgentState` of each step; row 0 is the vehicle itself
agent_info   (25, 8)        `AgentInfo`
lanes        (48, 10, 2)    pieces of lanes, nearest first
lane_info    (48, 10)       `LaneInfo`
paths        (16, 121, 2)   see `PathSet`
path_info    (16, 14)       `PathInfo`
path_agents  (16, 8, 8)     `PathAgent`, of the vehicles nearest to each path
motion       (7)            `OwnMotion`
raster       (bytes)        bits of `draw`; not where the preset has no image
===========  ============== ====================================================================
"""

_BACK_STEPS = 5
"""Acceleration and yaw rate are those of the last half second."""
_KIND: Final = {
    "vehicle": AgentInfo.VEHICLE,
    "pedestrian": AgentInfo.PEDESTRIAN,
    "cyclist": AgentInfo.CYCLIST,
    "other": AgentInfo.OTHER,
}
_PATH_STRIDE = 2
"""Projection on paths looks at every other node: a chord of 4 m."""
_BOX = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 6), np.linspace(-0.5, 0.5, 3)), -1).reshape(
    -1, 2
)
"""Points of the unit box that are drawn: 1 m apart on a car."""

_SEVEN = {
    SignalState.ARROW_STOP: 0, SignalState.ARROW_CAUTION: 1, SignalState.ARROW_GO: 2,
    SignalState.STOP: 3, SignalState.CAUTION: 4, SignalState.GO: 5,
}  # fmt: skip


def half_second_ago(valid: Bools) -> Ints:
    """(V) first step of the last half second at which agents (V, H) were seen; else now.

    Not the sixth last step that was seen: across a gap that may be a second ago, and a change over
    a gap is not the present acceleration.
    """
    recent = valid.copy()
    recent[:, : valid.shape[1] - 1 - _BACK_STEPS] = False
    return recent.argmax(1)


def recent_change(tracks: Tracks, rows: Ints, dt_s: float) -> tuple[Floats, Floats]:
    """(V) acceleration in m/s2 and yaw rate in rad/s of agents over the last half second.

    0 for an agent that was not seen before now.
    """
    valid, each = tracks.valid[rows], np.arange(len(rows))
    back = half_second_ago(valid)
    seconds = np.maximum((valid.shape[1] - 1 - back) * dt_s, dt_s)
    speed, heading = tracks.speed_mps[rows], tracks.heading_rad[rows]
    turned = frames.difference(heading[:, -1], heading[each, back])
    return (speed[:, -1] - speed[each, back]) / seconds, turned / seconds


def features(
    view: View, agent_id: str, preset: Preset, *, planner: bool = False
) -> tuple[Features, PathSet]:
    """Features of one agent, and its paths. Raises KeyError for an agent that is not in view.

    ``planner``: an automated planner drives it, which reacts differently from people.
    """
    tracks = view.history
    row, pose = tracks.row(agent_id), pose_of(view, agent_id)
    near = nearest_agents(view, row, NEIGHBOURS)
    agents, agent_info = agent_arrays(view, near, AGENTS, pose)
    motion = own_motion(view, row, planner=planner)
    index, place = road_index(view.road), (pose.position_m, pose.heading_rad, pose.speed_mps)
    paths = path_set(index, *place, view.signals, float(tracks.z_m[row, -1]))
    path_agents = _path_agents(paths.points_m, paths.valid, agents, agent_info)
    lanes, lane_info = lane_arrays(view, index, LANES, pose)
    arrays: Features = {
        "agents": agents.astype(np.float32),
        "agent_info": agent_info.astype(np.float32),
        "lanes": lanes.astype(np.float32),
        "lane_info": lane_info.astype(np.float32),
        "paths": paths.points_m.astype(np.float32),
        "path_info": paths.info.astype(np.float32),
        "path_agents": path_agents.astype(np.float32),
        "motion": motion.astype(np.float32),
    }
    if preset.raster:
        arrays["raster"] = pack(draw(view, index, preset, pose))
    return arrays, paths


def own_motion(view: View, row: int, *, planner: bool) -> Floats:
    """(7) see `OwnMotion`."""
    tracks = view.history
    accel, yaw_rate = recent_change(tracks, np.array([row]), view.dt_s)
    length, width = tracks.size_m[row, :2]
    recorded = view.av_recorded_steps / (HISTORY_STEPS - 1)
    return stacked(
        OwnMotion,
        {
            OwnMotion.SPEED: tracks.speed_mps[row, -1],
            OwnMotion.ACCEL: accel[0],
            OwnMotion.YAW_RATE: yaw_rate[0],
            OwnMotion.LENGTH: length,
            OwnMotion.WIDTH: width,
            OwnMotion.AV: float(tracks.ids[row] == view.av_id),
            OwnMotion.PLANNER: 1.0 + recorded if planner else 0.0,
        },
    )


def nearest_agents(view: View, row: int, count: int) -> Ints:
    """Rows: the agent itself, then up to ``count`` others by distance now."""
    position = view.history.position_m[:, -1]
    square = ((position - position[row]) ** 2).sum(-1)
    square[row] = -1.0
    return np.argsort(square, kind="stable")[: count + 1]


def agent_arrays(view: View, rows: Ints, size: int, pose: AgentFrame) -> tuple[Floats, Floats]:
    """(size, 11) of `AgentState` and (size) of `AgentInfo`; rows beyond the agents are zero."""
    tracks = view.history
    states = np.zeros((size, HISTORY_STEPS, len(AgentState)))
    info = np.zeros((size, len(AgentInfo)))
    count = len(rows)
    valid = tracks.valid[rows]
    states[:count, :, POSITION] = pose.to_local(tracks.position_m[rows])
    states[:count, :, DIRECTION] = frames.unit(pose.turn_rad(tracks.heading_rad[rows]))
    states[:count, :, VELOCITY] = pose.vectors(tracks.velocity_mps[rows])
    states[:count] *= valid[..., None]
    states[:count, :, AgentState.SEEN] = valid
    info[:count, span(AgentInfo.LENGTH, AgentInfo.WIDTH)] = tracks.size_m[rows, :2]
    info[np.arange(count), [_KIND[tracks.kinds[row]] for row in rows]] = 1.0
    info[:count, AgentInfo.AV] = [tracks.ids[row] == view.av_id for row in rows]
    info[:count, AgentInfo.THERE] = 1.0
    return states, info


def lane_arrays(view: View, index: RoadIndex, size: int, pose: AgentFrame) -> tuple[Floats, Floats]:
    """(size, 10, 2) and (size) of `LaneInfo`: pieces nearest to a point two seconds ahead."""
    pieces, info = np.zeros((size, 10, 2)), np.zeros((size, len(LaneInfo)))
    focus = pose.position_m + 2 * pose.speed_mps * frames.unit(pose.heading_rad)
    square = ((index.piece_m[:, 5] - focus) ** 2).sum(-1)
    farthest = np.partition(square, size)[size] if len(square) > size else np.inf
    near = np.flatnonzero(square <= farthest)  # a city has many pieces to sort
    rows = near[np.argsort(square[near], kind="stable")[:size]]
    count = len(rows)
    pieces[:count] = pose.to_local(index.piece_m[rows])
    info[:count, span(LaneInfo.FREEWAY, LaneInfo.INTERPOLATING)] = index.piece_kind[rows]
    info[:count, LaneInfo.LIMIT] = index.limit_mps[index.piece_lane[rows]]
    info[:count, LaneInfo.THERE] = 1.0
    if view.signals:
        for number, lane in enumerate(index.piece_lane[rows]):
            state = view.signals.get(index.lane_ids[lane])
            if state is not None:
                info[number, LaneInfo.RED + signal_colour(state)] = 1.0
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


def _path_agents(points_m: Floats, valid: Bools, agents: Floats, info: Floats) -> Floats:
    """(16, 8) of `PathAgent`: the eight agents nearest to each path, of those that exist (16)."""
    out = np.zeros((len(points_m), PATH_AGENTS, len(PathAgent)))
    there = np.flatnonzero(info[1:, AgentInfo.THERE]) + 1
    rows = np.flatnonzero(valid)
    if len(there) == 0:
        return out
    now = agents[there, -1]
    along, left, cos, sin = path_feet(points_m[rows], now[:, POSITION])
    cost = np.abs(left) + 0.05 * np.abs(along) + 10.0 * (along < -5.0)
    order = np.argsort(cost, axis=1, kind="stable")[:, :PATH_AGENTS]
    vx, vy = now[:, AgentState.VX], now[:, AgentState.VY]
    hx, hy = now[:, AgentState.COS], now[:, AgentState.SIN]
    columns = {
        PathAgent.ALONG: along,
        PathAgent.LEFT: left,
        PathAgent.SPEED_ALONG: vx * cos + vy * sin,
        PathAgent.SPEED_LEFT: vy * cos - vx * sin,
        PathAgent.COS: hx * cos + hy * sin,
        PathAgent.SIN: hy * cos - hx * sin,
        PathAgent.LENGTH: info[there, AgentInfo.LENGTH],
        PathAgent.THERE: 1.0,
    }
    every = stacked(PathAgent, columns, *along.shape)
    picked = np.take_along_axis(every, order[..., None], 1)
    out[rows, : picked.shape[1]] = picked
    return out


def draw(view: View, index: RoadIndex, preset: Preset, pose: AgentFrame) -> Bytes:
    """(C, pixels, pixels) of 0 and 1 around the pose of an agent of the view."""
    side = preset.raster_pixels
    image = np.zeros((preset.raster_channels, side, side), np.uint8)
    tracks = view.history
    groups = _classes(tracks, pose.agent_id, view.av_id)
    for number, step in enumerate(preset.raster_frames):
        seen = np.flatnonzero(tracks.valid[:, step])
        points = _box_points(tracks, seen, step)
        local = pose.to_local(points)
        channel = groups[seen] * len(preset.raster_frames) + number
        _set(image, local.reshape(-1, 2), np.repeat(channel, len(_BOX)), preset)
    base = len(AGENT_CLASSES) * len(preset.raster_frames)
    _set(image, pose.to_local(index.pixel_m), base + index.pixel_channel, preset)
    _signals(image, view, index, preset, pose)
    return image


def pack(image: Bytes) -> Bytes:
    """The image as bits, for the cache of features."""
    return np.packbits(image.reshape(-1))


def unpacked(bits: Bytes, preset: Preset) -> NDArray[np.float32]:
    """(C, pixels, pixels) of what `pack` made."""
    shape = preset.raster_channels, preset.raster_pixels, preset.raster_pixels
    return np.unpackbits(bits, count=math.prod(shape)).reshape(shape).astype(np.float32)


def _classes(tracks: Tracks, target_id: AgentId, av_id: AgentId) -> Ints:
    """(A) 0 the target, 1 vehicles, 2 all other agents, 3 the AV."""
    groups = np.array([1 if kind == "vehicle" else 2 for kind in tracks.kinds], np.int64)
    groups[tracks.row(av_id)] = 3
    groups[tracks.row(target_id)] = 0
    return groups


def _box_points(tracks: Tracks, rows: Ints, step: int) -> Floats:
    """(R, 18, 2) points inside the boxes, in the scene's frame."""
    heading = tracks.heading_rad[rows, step][:, None]
    local = _BOX * tracks.size_m[rows, None, :2]
    cos, sin = np.cos(heading), np.sin(heading)
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y], -1) + tracks.position_m[rows, step][:, None]


def _set(image: Bytes, local_m: Floats, channel: Ints, preset: Preset) -> None:
    """Set the pixels under points; those outside are left out."""
    side = preset.raster_pixels
    pixel = np.floor(local_m / preset.raster_m).astype(np.int64) + np.array((side // 4, side // 2))
    inside = ((pixel >= 0) & (pixel < side)).all(-1)
    image[channel[inside], pixel[inside, 0], pixel[inside, 1]] = 1


def _signals(image: Bytes, view: View, index: RoadIndex, preset: Preset, pose: AgentFrame) -> None:
    """The first metres of each lane with a signal, in the channel of its state."""
    base = preset.raster_channels - preset.raster_signals
    for lane_id, state in view.signals.items():
        if lane_id not in index.map.row:
            continue
        number = _SEVEN.get(state, 6) if preset.raster_signals == 7 else signal_colour(state)
        if number < preset.raster_signals:
            line = index.map.line_m[index.map.row[lane_id]]
            local = pose.to_local(line[:6])
            _set(image, local, np.full(len(local), base + number), preset)
