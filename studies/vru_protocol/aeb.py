"""A planner that keeps its speed, and brakes at the last moment for what it would hit.

It stands for a good automatic emergency brake, not for a careful driver: others are predicted at
their velocity, the AV along its route. It brakes fully once it could hardly stop any later, and
then stands: a test of the protocol ends there.
"""

from typing import Final

import numpy as np
from pydantic import Field

from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import Case, Command, Floats, VehicleModel, View
from deepmf_sumo.scene.geometry import boxes, frames, polylines

_HORIZON_S: Final = 4.0
_STEP_S: Final = 0.1
_SPEED_STEPS: Final = 3
"""Velocities of others are those of the last 0.3 s: a person starts to walk within a second."""


class Settings(PluginSettings):
    """The brake.

    Attributes:
        braking_mps2: full braking; 8 is a dry road.
        delay_s: from the command to full braking, as lost time.
        reserve_s: it brakes so much before the last moment.
        margin_m: the AV is wider by this on both sides.
    """

    braking_mps2: float = Field(default=8.0, gt=0.0, le=10.0)
    delay_s: float = Field(default=0.2, ge=0.0, le=2.0)
    reserve_s: float = Field(default=0.2, ge=0.0, le=2.0)
    margin_m: float = Field(default=0.2, ge=0.0, le=2.0)


class Aeb:
    """See the module."""

    Settings = Settings

    @classmethod
    def build(cls, settings: Settings) -> "Aeb":
        """The planner."""
        return cls(settings)

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._wanted_mps: float | None = None
        self._since_s = 0.0

    @property
    def model(self) -> VehicleModel | None:
        """None: no car-following model is used."""
        return None

    def reset(self, case: Case, rng: np.random.Generator) -> None:  # noqa: ARG002
        """Start of an episode."""
        self._wanted_mps, self._since_s = None, 0.0

    def act(self, view: View) -> Command:
        """The speed after the next step."""
        row = view.history.row(view.av_id)
        speed = float(view.history.speed_mps[row, -1])
        if self._wanted_mps is None:
            self._wanted_mps = speed
        asked = self._settings
        need_s = speed / (2 * asked.braking_mps2) + asked.delay_s + asked.reserve_s
        if self._since_s == 0.0 and time_to_conflict(view, asked.margin_m) > need_s:
            return Command(kind="speed", speed_mps=self._wanted_mps)
        self._since_s += view.dt_s
        braking = asked.braking_mps2 if self._since_s > asked.delay_s else 0.0
        return Command(kind="speed", speed_mps=max(0.0, speed - braking * view.dt_s))


def time_to_conflict(view: View, margin_m: float) -> float:
    """Seconds until the AV is in the way of a road user that it would touch; inf if of nobody.

    At present velocities. A driver who stops must do so before the way of the other, not only
    before where the two would touch.
    """
    tracks, path = view.history, view.av_path_m
    if path is None:
        return float("inf")
    me = tracks.row(view.av_id)
    size = tracks.size_m[me, :2] + np.array([0.0, 2 * margin_m])
    seconds = np.arange(0.0, _HORIZON_S, _STEP_S)
    where, heading = _along(path, tracks.speed_mps[me, -1] * seconds, float(size[0]))
    first = float("inf")
    for row in range(tracks.agents):
        if row == me:
            continue
        known = np.flatnonzero(tracks.valid[row])[-_SPEED_STEPS - 1 :]
        moved = tracks.position_m[row, -1] - tracks.position_m[row, known[0]]
        velocity = moved / (max(len(known) - 1, 1) * view.dt_s)
        there = tracks.position_m[row, -1] + velocity * seconds[:, None]
        turned = np.full(len(seconds), tracks.heading_rad[row, -1])
        other = there, turned, tracks.size_m[row, :2]
        if boxes.touching(where, heading, size, *other).any():
            sweeps = boxes.touching(where[:, None], heading[:, None], size, *other).any(axis=1)
            first = min(first, float(seconds[int(sweeps.argmax())]))
    return first


def _along(path_m: Floats, driven_m: Floats, length_m: float) -> tuple[Floats, Floats]:
    """Poses of the box whose front bumper has driven along a path."""
    front, heading = polylines.points_at(path_m, driven_m)
    return front - frames.unit(heading) * length_m / 2, heading
