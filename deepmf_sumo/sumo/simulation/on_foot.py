"""The motion of a person that neither a plan, nor the log, nor SUMO drives: it walks to a place.

See `way_on` for those who follow lanes.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from deepmf_sumo.scene import DT_S, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS, MotionLimits
from deepmf_sumo.sumo.simulation.frame import Pose

WALK_MPS: Final = ROAD_USERS["pedestrian"].motion.usual_mps[0]
_TURN_RAD: Final = 0.15
"""A person turns at most so far in a step."""
_THERE_M: Final = 0.1
_SHOWS_MPS: Final = 0.2
"""Slower motion does not turn a body."""
_AT_REST_MPS: Final = 0.02


class Walk:
    """The way of a person straight to a place, where it stays; from wherever a policy let go of it.

    Its velocity changes by at most what is planned for its class, and it does not step into a box
    that is in its way.

    Args:
        pose: the last one of the policy.
        limits: of its class.
        goal_m: (2,) where it goes; None: it stops.
    """

    def __init__(self, pose: Pose, limits: MotionLimits, goal_m: Floats | None) -> None:
        self._pose, self._limits, self._goal = pose, limits, goal_m
        self._velocity = pose.speed_mps * frames.unit(
            np.array(pose.heading_rad if pose.course_rad is None else pose.course_rad)
        )

    def next(self, clear: Callable[[Sequence[Pose]], bool]) -> Pose:
        """The pose after one more step; ``clear`` says whether poses are free."""
        pose = self._stepped(self._wanted())
        if pose.speed_mps > _AT_REST_MPS and not clear([pose]):
            pose = self._stepped(np.zeros(2))
        self._pose = pose
        return pose

    def _wanted(self) -> Floats:
        """The velocity (2,) that takes it to its goal, and lets it stop there."""
        if self._goal is None:
            return np.zeros(2)
        off = self._goal - np.array([self._pose.x_m, self._pose.y_m])
        away_m = float(np.hypot(*off))
        if away_m < _THERE_M:
            return np.zeros(2)
        fastest = min(WALK_MPS, float(np.sqrt(self._limits.brake * away_m)))
        return np.asarray(fastest * off / away_m, float)

    def _stepped(self, wanted: Floats) -> Pose:
        change = wanted - self._velocity
        braking = float(wanted @ wanted) < float(self._velocity @ self._velocity)
        most = DT_S * (self._limits.brake if braking else self._limits.accel)
        size = float(np.hypot(*change))
        before = self._velocity
        after = before + change * (min(1.0, most / size) if size > 0 else 0.0)
        if float(np.hypot(*after)) < _AT_REST_MPS:
            after = np.zeros(2)
        self._velocity = after
        moved = (before + after) / 2 * DT_S
        heading, speed = self._pose.heading_rad, float(np.hypot(*after))
        if speed > _SHOWS_MPS:
            course = float(np.arctan2(after[1], after[0]))
            turn = float(frames.difference(course, heading))
            heading = float(frames.wrap(heading + np.clip(turn, -_TURN_RAD, _TURN_RAD)))
        return Pose(
            x_m=self._pose.x_m + float(moved[0]),
            y_m=self._pose.y_m + float(moved[1]),
            heading_rad=heading,
            speed_mps=speed,
            course_rad=float(np.arctan2(after[1], after[0])) if speed > 0 else None,
            z_m=self._pose.z_m,
        )
