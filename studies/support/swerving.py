"""A planner that takes ways out: it brakes or swerves as gently as it can, and looks where to.

The planners of the package follow their lane. This one predicts everybody at constant velocity for
3 s, keeps its motion while that touches nobody, and else chooses the gentlest of the manoeuvres of
`judge.avoidability.manoeuvres` that touches nobody and stays on the road.
"""

from typing import Final

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.judge.avoidability import manoeuvres
from deepmf_sumo.judge.avoidability.av_path import AvPath, stays_on_road
from deepmf_sumo.scene import Bools, Case, Command, Floats, VehicleModel, View
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear

_AHEAD: Final = 30
"""Steps that it looks ahead."""
_ACCEL_MPS2: Final = 1.5
_MARGIN_M: Final = 0.4
_KEPT: Final = 10
"""A motion with fewer steps left is chosen anew."""


class Settings(plugins.Settings):
    """It has none."""


class Swerving:
    """Follows its chosen motion, poses (K, 4) x, y, heading, speed, as long as that is free."""

    model: VehicleModel | None = None
    Settings = Settings

    def __init__(self) -> None:
        self._motion = np.empty((0, 4))
        self._wanted_mps = 0.0

    @classmethod
    def build(cls, settings: Settings) -> "Swerving":
        """The planner."""
        return cls()

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Forget the last episode."""
        self._motion, self._wanted_mps = np.empty((0, 4)), 0.0

    def act(self, view: View) -> Command:
        """The next pose."""
        left = len(self._motion)
        if left < _KEPT or _first_touch(view, self._motion[None, :, :3])[0] < left:
            self._motion = self._chosen(view)
        pose, self._motion = self._motion[0], self._motion[1:]
        x, y, heading, speed = pose.tolist()
        return Command(kind="pose", x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)

    def _chosen(self, view: View) -> Floats:
        """The gentlest motion that is free, or the one that is free for longest."""
        row, tracks = view.history.row(view.av_id), view.history
        position, heading = tracks.position_m[row, -1], float(tracks.heading_rad[row, -1])
        speed = float(tracks.speed_mps[row, -1])
        self._wanted_mps = max(self._wanted_mps, speed)
        speeds = np.minimum(speed + _ACCEL_MPS2 * view.dt_s * np.arange(1, 41), self._wanted_mps)
        along = np.concatenate([[0.0], np.cumsum(speeds) * view.dt_s])
        path = AvPath.through(position[None], np.array([heading]), _beside(view, position))
        driven = manoeuvres.drive(path, along, view.dt_s)
        poses = np.concatenate([driven.centre_m, driven.heading_rad[..., None]], axis=-1)[:, 1:]
        first = _first_touch(view, poses[:, :_AHEAD])
        half_width, z_m = float(tracks.size_m[row, 1]) / 2, float(tracks.z_m[row, -1])
        kept = stays_on_road(view.road, path, driven.along_m, driven.left_m, half_width, z_m)
        best = int(np.lexsort((_effort(), -np.where(kept & driven.holds, first, -1)))[0])
        moved = np.diff(driven.centre_m[best], axis=0)
        return np.column_stack([poses[best], np.hypot(*moved.T) / view.dt_s])


def _effort() -> Floats:
    """(M) how hard each manoeuvre is for those inside; least for what drives on."""
    grid = manoeuvres.GRID
    return (
        np.hypot(grid.braking_mps2, grid.lateral_mps2)
        + np.abs(grid.offset_m) / 10
        + (~grid.as_driven & (grid.braking_mps2 == 0))
    )


def _beside(view: View, position_m: Floats) -> Floats:
    """The path ahead, moved beside itself to where the AV is."""
    path = view.av_path_m
    if path is None or len(path) < 2:
        return np.empty((0, 2))
    foot = polylines.project(path, position_m)
    normal = frames.unit(np.asarray(foot.heading_rad) + np.pi / 2)
    return path + float(foot.left_m) * normal


def _first_touch(view: View, poses: Floats) -> Floats:
    """(M) first step at which poses (M, K, 3) touch anybody at constant velocity; K: never."""
    tracks, steps = view.history, poses.shape[1]
    me = tracks.row(view.av_id)
    size = tracks.size_m[me, :2] + 2 * _MARGIN_M
    after = view.dt_s * np.arange(1, steps + 1)[:, None]
    first = np.full(len(poses), float(steps))
    if not steps:
        return first
    middle = poses[..., :2].mean(axis=0)
    reach_m = 12.0 + np.hypot(*np.moveaxis(poses[..., :2] - middle, -1, 0)).max()
    for row in range(tracks.agents):
        ahead = tracks.position_m[row, -1] + tracks.velocity_mps[row, -1] * after
        if row == me or clear(tracks.z_m[row, -1:], tracks.z_m[me, -1:]).all():
            continue
        if np.hypot(*(ahead - middle).T).min() > reach_m:
            continue
        heading = np.full(steps, tracks.heading_rad[row, -1])
        hit: Bools = boxes.touching(
            poses[..., :2], poses[..., 2], size, ahead, heading, tracks.size_m[row, :2]
        )
        if not hit[:, 0].all():
            first = np.where(hit.any(axis=1), np.minimum(first, hit.argmax(axis=1)), first)
    return first
