"""What is read off the simulation after a step."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import AgentId, AgentKind, Bytes, Driver, Floats
from deepmf_sumo.geometry import frames


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """What an agent is: fixed for the episode. ``size_m`` (length, width, height)."""

    kind: AgentKind
    size_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where a box is and how fast it goes; None: along its heading (backwards if negative).

    ``z_m``: of the road below it in SUMO, of its middle in recordings.
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    course_rad: float | None = None
    z_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """All N agents that are there at one step.

    Attributes:
        ids: (N). position_m: (N, 2) box centre. z_m, heading_rad: (N). velocity_mps: (N, 2).
        driver: (N) Driver numbers.
    """

    ids: list[AgentId]
    position_m: Floats
    z_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    driver: Bytes

    @staticmethod
    def of_poses(poses: dict[AgentId, tuple[Pose, Driver]]) -> "Frame":
        """Agents given one by one."""
        ids = list(poses)
        table = np.array(
            [
                [pose.x_m, pose.y_m, pose.heading_rad, pose.speed_mps, pose.z_m]
                for pose, _ in poses.values()
            ]
        ).reshape(-1, 5)
        drivers = np.array([int(driver) for _, driver in poses.values()], np.uint8)
        course = [
            pose.heading_rad if pose.course_rad is None else pose.course_rad
            for pose, _ in poses.values()
        ]
        velocity = table[:, 3:4] * frames.unit(np.array(course))
        return Frame(
            ids=ids,
            position_m=table[:, :2],
            z_m=table[:, 4],
            heading_rad=table[:, 2],
            velocity_mps=velocity,
            driver=drivers,
        )

    def with_poses(self, poses: dict[AgentId, tuple[Pose, Driver]]) -> "Frame":
        """This frame and the given agents (who are not in it)."""
        more = Frame.of_poses(poses)
        return Frame(
            ids=self.ids + more.ids,
            position_m=np.concatenate([self.position_m, more.position_m]),
            z_m=np.concatenate([self.z_m, more.z_m]),
            heading_rad=np.concatenate([self.heading_rad, more.heading_rad]),
            velocity_mps=np.concatenate([self.velocity_mps, more.velocity_mps]),
            driver=np.concatenate([self.driver, more.driver]),
        )
