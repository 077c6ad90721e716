"""Trajectories without a network: what a predictor has to beat."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, Floats
from deepmf_sumo.geometry import angles, frames, polylines
from deepmf_sumo.predictors.lanes import road_index
from deepmf_sumo.predictors.paths import path_set
from deepmf_sumo.training import clusters
from deepmf_sumo.training.clusters import Clusters
from deepmf_sumo.training.evaluation.targets import Target

_TIMES_S: Final[Floats] = np.asarray(np.arange(1, FUTURE_STEPS + 1) * DT_S, float)
_TURN_STEPS: Final = 5
"""The yaw rate is that of the last half second, as in `features.Features`."""


def constant_velocity(target: Target) -> Floats:
    """(1, 80, 2) straight on at the speed and in the direction of now."""
    tracks = target.view.history
    start, velocity = tracks.position_m[target.row, -1], tracks.velocity_mps[target.row, -1]
    return np.asarray((start + _TIMES_S[:, None] * velocity)[None], float)


def lane_following(target: Target) -> Floats:
    """(1, 80, 2) along the nearest lane path at the speed of now; straight on where is no lane."""
    tracks = target.view.history
    start = tracks.position_m[target.row, -1]
    heading = float(tracks.heading_rad[target.row, -1])
    paths = path_set(
        road_index(target.view.road),
        start,
        heading,
        target.speed_mps,
        target.view.signals,
        float(tracks.z_m[target.row, -1]),
    )
    place, _ = polylines.points_at(paths.points_m[0], target.speed_mps * _TIMES_S)
    return frames.to_scene(place, start, heading)[None]


def map_blind(fitted: Clusters, target: Target, modes: int) -> Floats:
    """(M, 80, 2) clusters of how others went on from this speed and yaw rate."""
    tracks = target.view.history
    start = tracks.position_m[target.row, -1]
    heading = float(tracks.heading_rad[target.row, -1])
    went = clusters.predict(fitted, target.speed_mps, _yaw_rate(target), modes)
    return frames.to_scene(went, start, heading)


def _yaw_rate(target: Target) -> float:
    tracks = target.view.history
    seen = np.flatnonzero(tracks.valid[target.row])
    back = int(seen[max(-_TURN_STEPS - 1, -len(seen))])
    heading = tracks.heading_rad[target.row]
    seconds = max((tracks.steps - 1 - back) * target.view.dt_s, target.view.dt_s)
    return float(angles.difference(heading[-1], heading[back])) / seconds
