"""Spreads SUMO's sideways jumps over time.

Without its sublane model SUMO changes lanes within one step, and turns a vehicle that starts askew
into the lane's direction at once. SUMO's own remedy (`lanechange.duration`) makes a vehicle that
starts beside the middle of a lane inside a junction stop there for ever. So SUMO keeps the vehicle
where it wants, and what is shown to planners, policies and judges glides there.
"""

import numpy as np

from deepmf_sumo.datatypes import DT_S
from deepmf_sumo.geometry import angles
from deepmf_sumo.simulation.frame import Pose

_STEPS = 30
"""A lane change takes 3 s."""
_SIDEWAYS_M = 0.2
_TURN_RAD = 0.1
_LARGEST_M = 6.0
"""More than a lane is a teleport, and shown as it is."""
_FULL_MPS = 2.0
"""Slower than this the glide is slower, too: nobody moves sideways standing."""


class Glide:
    """One vehicle's poses, without jumps to the side.

    Args:
        start: its pose before the first step.
    """

    def __init__(self, start: Pose) -> None:
        self._shown = start
        self._left_m = 0.0
        self._turn_rad = 0.0
        self._share = 0.0

    def follow(self, pose: Pose) -> Pose:
        """What to show for the pose that SUMO has after a step."""
        before = self._shown
        way = (before.speed_mps + pose.speed_mps) / 2 * DT_S
        x = before.x_m + way * np.cos(before.heading_rad) - pose.x_m
        y = before.y_m + way * np.sin(before.heading_rad) - pose.y_m
        sin, cos = float(np.sin(pose.heading_rad)), float(np.cos(pose.heading_rad))
        left = float(y * cos - x * sin)
        turn = float(angles.difference(before.heading_rad, pose.heading_rad))
        pace = min(1.0, pose.speed_mps / _FULL_MPS)
        self._share = max(0.0, self._share - pace / _STEPS)
        jumped = (
            abs(left - self._left_m * self._share) > _SIDEWAYS_M
            or abs(turn - self._turn_rad * self._share**2) > _TURN_RAD
        )
        if jumped and np.hypot(x, y) < _LARGEST_M:
            self._left_m, self._turn_rad, self._share = left, turn, 1.0 - pace / _STEPS
        rest = self._left_m * self._share
        self._shown = Pose(
            x_m=pose.x_m - rest * sin,
            y_m=pose.y_m + rest * cos,
            heading_rad=float(angles.wrap(pose.heading_rad + self._turn_rad * self._share**2)),
            speed_mps=pose.speed_mps,
        )
        return self._shown
