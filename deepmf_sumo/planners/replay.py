"""The AV does what it did in the recording."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Case, Command, Scene, VehicleModel, View
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import angles
from deepmf_sumo.plugins import Settings as PluginSettings

DRIVER: Final = "human"


class Settings(PluginSettings):
    """No settings."""


class ReplayPlanner:
    """The log's poses; where the log ends or has a gap the AV stays where it was."""

    def __init__(self) -> None:
        self._scene: Scene | None = None

    @property
    def model(self) -> VehicleModel | None:
        """None: no car-following model is used."""
        return None

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Take the case's recording. Raises SimulationError where there is none."""
        if case.scene is None:
            raise SimulationError(
                f"The planner 'replay' needs a recording, and case '{case.name}' is a SUMO "
                "network; choose idm, sumo or constant_velocity."
            )
        self._scene = case.scene

    def act(self, view: View) -> Command:
        """The recorded pose of the next step."""
        assert self._scene is not None
        tracks = self._scene.tracks
        row, step = tracks.row(view.av_id), view.step + 1
        if step < tracks.steps and tracks.valid[row, step]:
            x, y = tracks.position_m[row, step]
            heading, speed = tracks.heading_rad[row, step], tracks.speed_mps[row, step]
            if tracks.velocity_mps[row, step] @ angles.unit(heading) < 0:
                speed = -speed  # it rolls backwards
        else:
            row = view.history.row(view.av_id)
            x, y = view.history.position_m[row, -1]
            heading, speed = view.history.heading_rad[row, -1], 0.0
        return Command(
            kind="pose",
            x_m=float(x),
            y_m=float(y),
            heading_rad=float(heading),
            speed_mps=float(speed),
        )


def build(settings: Settings) -> ReplayPlanner:
    """The planner."""
    return ReplayPlanner()
