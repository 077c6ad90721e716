"""The AV keeps its present velocity and reacts to nothing: the simplest baseline."""

import numpy as np

from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import Case, Command, VehicleModel, View
from deepmf_sumo.scene.geometry import frames


class Settings(PluginSettings):
    """What it keeps.

    Attributes:
        follow_route: keep the speed along the route instead of going straight on.
    """

    follow_route: bool = False


class ConstantVelocityPlanner:
    """Keeps the speed and heading (or the route) of the first view."""

    def __init__(self, settings: Settings) -> None:
        self._follow_route = settings.follow_route
        self._start: Command | None = None
        self._step = 0

    @property
    def model(self) -> VehicleModel | None:
        """None: no car-following model is used."""
        return None

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Forget the last episode."""
        self._start = None

    def act(self, view: View) -> Command:
        """The pose that the first view's velocity leads to."""
        if self._start is None:
            self._start, self._step = _now(view), view.step
        start = self._start
        if self._follow_route:
            # along a route SUMO drives nothing backwards
            return Command(kind="speed", speed_mps=max(start.speed_mps, 0.0))
        moved_m = start.speed_mps * view.dt_s * (view.step + 1 - self._step)
        return Command(
            kind="pose",
            x_m=start.x_m + moved_m * float(np.cos(start.heading_rad)),
            y_m=start.y_m + moved_m * float(np.sin(start.heading_rad)),
            heading_rad=start.heading_rad,
            speed_mps=start.speed_mps,
        )


def build(settings: Settings) -> ConstantVelocityPlanner:
    """The planner."""
    return ConstantVelocityPlanner(settings)


def _now(view: View) -> Command:
    row = view.history.row(view.av_id)
    x, y = view.history.position_m[row, -1]
    heading = float(view.history.heading_rad[row, -1])
    ahead = float(view.history.velocity_mps[row, -1] @ frames.unit(np.array(heading)))
    speed = float(view.history.speed_mps[row, -1])
    return Command(
        kind="pose",
        x_m=float(x),
        y_m=float(y),
        heading_rad=heading,
        speed_mps=-speed if ahead < 0 else speed,  # it may roll back
    )
