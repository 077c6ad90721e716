"""What the opponent network reads: the scene around the AV, and each candidate's relation to it."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, Ints, View
from deepmf_sumo.geometry import angles, frames
from deepmf_sumo.predictors import raster
from deepmf_sumo.predictors.features import (
    Features,
    agent_arrays,
    lane_arrays,
    nearest_agents,
    path_feet,
)
from deepmf_sumo.predictors.paths import path_set
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.predictors.road_index import RoadIndex, road_index

SCENE_AGENTS: Final = 64
RANGE_M: Final = 80.0
PAIR: Final = 36
"""Columns of ``pair``, see `_pairs`."""

_TIMES_S = np.arange(0.0, 8.01, 0.5)
_STILL_MPS = 0.5
_ON_LANE_M, _ALONG_LANE_RAD = 2.0, np.deg2rad(45.0)


def candidates(view: View) -> Ints:
    """Rows that may be the opponent: vehicles within 80 m, not the AV, not parked; nearest first.

    Parked is who has not moved in the history and stands off the lanes, or across them. Who waits
    on a lane may well attack.
    """
    tracks = view.history
    near = nearest_agents(view, tracks.row(view.av_id), SCENE_AGENTS - 1)[1:]
    apart = np.hypot(*(tracks.position_m[near, -1] - _now(view)[0]).T)
    index = road_index(view.road)
    keep = [
        tracks.kinds[row] == "vehicle" and distance <= RANGE_M and not _parked(view, index, row)
        for row, distance in zip(near.tolist(), apart, strict=True)
    ]
    return near[np.array(keep, bool)] if len(near) else near


def opponent_features(view: View, preset: Preset) -> tuple[Features, tuple[AgentId, ...]]:
    """Arrays around the AV, and the candidates' ids.

    Keys: agents (64, 11, 7), agent_info (64, 8), lanes (48, 10, 2), lane_info (48, 10), raster, as
    in `features.Features`; pair (64, 36) and candidate (64) 1 for agents that are candidates.
    """
    tracks, index = view.history, road_index(view.road)
    row = tracks.row(view.av_id)
    origin, heading = _now(view)
    speed = float(tracks.speed_mps[row, -1])
    near = nearest_agents(view, row, SCENE_AGENTS - 1)
    agents, info = agent_arrays(view, near, SCENE_AGENTS, origin, heading)
    lanes, lane_info = lane_arrays(view, index, origin, heading, speed, 48)
    chosen = candidates(view)
    slot = {int(agent): number for number, agent in enumerate(near)}
    slots = np.array([slot[int(agent)] for agent in chosen], np.int64)
    pair, candidate = np.zeros((SCENE_AGENTS, PAIR)), np.zeros(SCENE_AGENTS)
    if len(chosen):
        pair[slots] = _pairs(view, index, chosen, agents[slots], agents[0])
        candidate[slots] = 1.0
    image = raster.draw(view, index, row, preset, origin, heading)
    arrays: Features = {
        "agents": agents.astype(np.float32),
        "agent_info": info.astype(np.float32),
        "lanes": lanes.astype(np.float32),
        "lane_info": lane_info.astype(np.float32),
        "raster": raster.pack(image),
        "pair": pair.astype(np.float32),
        "candidate": candidate.astype(np.float32),
    }
    return arrays, tuple(tracks.ids[agent] for agent in near[np.sort(slots)])


def _now(view: View) -> tuple[Floats, float]:
    row = view.history.row(view.av_id)
    return view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])


def _parked(view: View, index: RoadIndex, row: int) -> bool:
    tracks = view.history
    seen = tracks.valid[row]
    moved = np.ptp(tracks.position_m[row, seen], axis=0).max() > 0.5
    if moved or tracks.speed_mps[row, -1] > _STILL_MPS:
        return False
    pose = tracks.position_m[row, -1], float(tracks.heading_rad[row, -1])
    return not index.feet(*pose, _ON_LANE_M, float(_ALONG_LANE_RAD))


def _pairs(view: View, index: RoadIndex, rows: Ints, states: Floats, av: Floats) -> Floats:
    """(C, 36): pose and motion (14), constant velocity (6), lanes (10), ranks (4), AV (2)."""
    tracks = view.history
    now, av_now = states[:, -1], av[-1]
    distance = np.hypot(now[:, 0], now[:, 1])
    speed = np.hypot(now[:, 4], now[:, 5])
    av_speed = np.hypot(av_now[4], av_now[5])
    toward = -(now[:, 0:2] * (now[:, 4:6] - av_now[4:6])).sum(-1) / np.maximum(distance, 1.0)
    first = tracks.valid[rows].argmax(1)
    start = tracks.position_m[rows, first]
    moved = np.hypot(*(tracks.position_m[rows, -1] - start).T)
    size = tracks.size_m[rows]
    kinematics = [
        now[:, 0] / 30, now[:, 1] / 30, np.abs(now[:, 1]) / 10, now[:, 2], now[:, 3],
        now[:, 4] / 15, now[:, 5] / 15, speed / 15, distance / 30, np.exp(-distance / 10),
        toward / 15, moved / 5, size[:, 0] / 5, (moved > 0.5) | (speed > _STILL_MPS),
    ]  # fmt: skip
    constant = _constant_velocity(now, av_now)
    lanes = _lanes(view, index, rows)
    moving = kinematics[-1].astype(float)
    ranks = [
        _rank(distance), _rank(distance + 1e3 * (moving < 1)), _rank(constant[:, 0]),
        _rank(lanes[:, 0]),
    ]  # fmt: skip
    av_columns = np.broadcast_to([av_speed / 15, len(rows) / 30], (len(rows), 2))
    return np.concatenate(
        [np.stack(kinematics, 1), constant, lanes, np.stack(ranks, 1), av_columns], axis=1
    )


def _rank(values: Floats) -> Floats:
    rank: Floats = np.log1p(values.argsort(kind="stable").argsort(kind="stable"))
    return rank


def _constant_velocity(now: Floats, av: Floats) -> Floats:
    """(C, 6) least distance at one time and when; least distance of the ways, and both times."""
    own = now[:, None, 0:2] + _TIMES_S[:, None] * now[:, None, 4:6]  # (C, 17, 2)
    ego = _TIMES_S[:, None] * av[None, 4:6]  # (17, 2)
    same = np.linalg.norm(own - ego, axis=-1)
    ways = np.linalg.norm(own[:, :, None] - ego, axis=-1).reshape(len(now), -1)
    when = ways.argmin(1)
    own_time, av_time = np.divmod(when, len(_TIMES_S))
    return np.stack(
        [
            np.minimum(same.min(1) / 10, 4), same.argmin(1) / 16, np.minimum(ways.min(1) / 10, 4),
            own_time / 16, av_time / 16, (own_time - av_time) / 16,
        ],
        axis=1,
    )  # fmt: skip


def _lanes(view: View, index: RoadIndex, rows: Ints) -> Floats:
    """(C, 10): to the AV's paths (offset, along, turn), the AV to theirs, where paths meet."""
    tracks = view.history
    origin, heading = _now(view)
    av_row = tracks.row(view.av_id)
    av_paths = path_set(index, origin, heading, tracks.speed_mps[av_row, -1], view.signals)
    own_lines = av_paths.points_m[: max(len(av_paths.lanes), 1)]
    here = frames.to_local(tracks.position_m[rows, -1], origin, heading)
    along, left, cos, sin = path_feet(own_lines, here)
    turn = angles.unit(tracks.heading_rad[rows, -1] - heading)
    best = np.abs(left).argmin(0)
    columns = np.arange(len(rows))
    nearest = np.abs(left[best, columns])
    parallel = cos[best, columns] * turn[:, 0] + sin[best, columns] * turn[:, 1]
    out = np.zeros((len(rows), 10))
    out[:, 0] = np.minimum(nearest / 10, 4)
    out[:, 1] = np.clip(along[best, columns] / 50, -1, 4)
    out[:, 2] = parallel
    for number, row in enumerate(rows):
        out[number, 3:] = _meeting(view, index, int(row), own_lines, here[number])
    return out


def _meeting(view: View, index: RoadIndex, row: int, own_lines: Floats, here_m: Floats) -> Floats:
    """(7) offset and along of the AV on the candidate's paths; where both paths are nearest."""
    tracks = view.history
    origin, heading = _now(view)
    position, turn = tracks.position_m[row, -1], float(tracks.heading_rad[row, -1])
    speed = float(tracks.speed_mps[row, -1])
    paths = path_set(index, position, turn, speed, view.signals)
    count = max(len(paths.lanes), 1)
    lines = frames.to_scene(paths.points_m[:count], position, turn)
    lines = frames.to_local(lines, origin, heading)
    along, left, _, _ = path_feet(lines, np.zeros((1, 2)))
    best = int(np.abs(left[:, 0]).argmin())
    reach = slice(0, 61, 2)  # 120 m every 4 m
    apart = own_lines[:, None, reach, None] - lines[None, :, None, reach]
    square = (apart * apart).sum(-1).min(axis=(0, 1))
    av_node, own_node = np.divmod(int(square.argmin()), square.shape[1])
    met = np.sqrt(square.min())
    on_lane: Bools = np.array(len(paths.lanes) > 0)
    return np.array(
        [
            min(abs(left[best, 0]) / 10, 4), np.clip(along[best, 0] / 50, -2, 4),
            min(met / 10, 4), av_node / 30, own_node / 30, float(np.hypot(*here_m) < 12), on_lane,
        ]
    )  # fmt: skip


def candidate_mask(arrays: Features) -> Bools:
    """(64) which agent slots are candidates."""
    mask: Bools = arrays["candidate"] > 0
    return mask
