"""The AV drives as it did in the recording."""

from typing import Final

import numpy as np

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import (
    DT_S,
    Case,
    Command,
    Floats,
    RecordedCase,
    Tracks,
    VehicleModel,
    View,
)
from deepmf_sumo.scene.geometry import frames

DRIVER: Final = "human"


class Settings(PluginSettings):
    """No settings."""


_BRAKES_MPS2: Final = 3.0


class ReplayPlanner:
    """Poses of the log. In its gaps the AV drives on evenly, after its end it comes to a stop."""

    def __init__(self) -> None:
        self._now = 0
        self._poses: Floats = np.empty((0, 4))

    @property
    def model(self) -> VehicleModel | None:
        """None: no car-following model is used."""
        return None

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Read the case's recording. Raises SimulationError if it has none."""
        if not isinstance(case, RecordedCase):
            raise SimulationError(
                f"The planner 'replay' needs a recording, and case '{case.name}' is a SUMO "
                "network; choose idm, sumo or constant_velocity."
            )
        self._now = case.scene.now
        self._poses = _poses(case.scene.tracks, case.scene.tracks.row(case.av_id), self._now)

    def act(self, view: View) -> Command:
        """The recorded pose of the next step."""
        ahead = view.step + 1 - self._now
        x, y, heading, speed = self.fixed_poses(ahead)[-1].tolist()
        return Command(kind="pose", x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)

    def fixed_poses(self, steps: int) -> Floats:
        """(steps, 4) x, y, heading, signed speed of the recording after now."""
        after = self._poses[1 : steps + 1]
        return np.concatenate([after, _stopped(self._poses[-1], steps - len(after))])


def _poses(tracks: Tracks, row: int, now: int) -> Floats:
    """(K, 4) poses from now to the last recorded step; in gaps evenly from end to end."""
    known = np.flatnonzero(tracks.valid[row, now:])
    heading, velocity = tracks.heading_rad[row, now:], tracks.velocity_mps[row, now:]
    speed = np.hypot(*velocity.T)
    backwards = (velocity * frames.unit(heading)).sum(-1) < 0  # it rolls
    x, y = tracks.position_m[row, now:].T
    columns = x, y, np.unwrap(heading[known]), np.where(backwards, -speed, speed)
    steps = np.arange(known[-1] + 1)
    given = [one if len(one) == len(known) else one[known] for one in columns]
    poses = np.column_stack([np.interp(steps, known, one) for one in given])
    inside = np.setdiff1d(steps, known)
    moved = (poses[inside, :2] - poses[inside - 1, :2]) / DT_S
    poses[inside, 3] = (moved * frames.unit(poses[inside, 2])).sum(-1)
    poses[:, 2] = np.where(np.isin(steps, known), heading[: len(steps)], frames.wrap(poses[:, 2]))
    return poses


def _stopped(pose: Floats, steps: int) -> Floats:
    """(steps, 4) poses after a pose (4), braking along its heading."""
    x, y, heading, speed = pose
    after = np.maximum(abs(speed) - _BRAKES_MPS2 * DT_S * np.arange(steps + 1), 0.0)
    way = np.sign(speed) * np.cumsum((after[:-1] + after[1:]) / 2 * DT_S)
    place = np.array([x, y]) + way[:, None] * frames.unit(heading)
    return np.column_stack([place, np.full(steps, heading), np.sign(speed) * after[1:]])


def build(settings: Settings) -> ReplayPlanner:
    """The planner."""
    return ReplayPlanner()
