"""The AV drives as it did in the recording."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import (
    Case,
    Command,
    Floats,
    RecordedCase,
    Tracks,
    VehicleModel,
    View,
)
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import frames
from deepmf_sumo.plugins import Settings as PluginSettings

DRIVER: Final = "human"


class Settings(PluginSettings):
    """No settings."""


class ReplayPlanner:
    """Poses of the log; after its end and in its gaps the AV stands still."""

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
        stands = np.repeat(self._poses[-1:] * [1, 1, 1, 0], steps - len(after), axis=0)
        return np.concatenate([after, stands])


def _poses(tracks: Tracks, row: int, now: int) -> Floats:
    """(K, 4) poses from now to the end of the recording; speed 0 in gaps."""
    valid, heading = tracks.valid[row, now:], tracks.heading_rad[row, now:]
    velocity = tracks.velocity_mps[row, now:]
    speed = np.hypot(*velocity.T)
    backwards = (velocity * frames.unit(heading)).sum(-1) < 0  # it rolls
    speed = np.where(valid, np.where(backwards, -speed, speed), 0.0)
    known = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), 0))
    poses = np.column_stack([tracks.position_m[row, now:], heading])[known]
    return np.column_stack([poses, speed])


def build(settings: Settings) -> ReplayPlanner:
    """The planner."""
    return ReplayPlanner()
