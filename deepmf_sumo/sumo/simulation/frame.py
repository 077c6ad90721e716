"""Poses and frames: the state of all agents after a step, as read from the simulation."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, AgentKind, Bytes, Driver, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import Ground


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """Kind and size of an agent, fixed for the episode. ``size_m`` (length, width, height)."""

    kind: AgentKind
    size_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Pose and speed of a box.

    ``course_rad``: direction of motion; None: its heading (backwards if the speed is negative).
    ``z_m``: height of the ground below it, as in `scene.Tracks`.
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    course_rad: float | None = None
    z_m: float = 0.0


def states(poses: Sequence[Pose]) -> Floats:
    """(N, 6) x, y, z, heading, vx, vy of poses."""
    table = np.array(
        [[one.x_m, one.y_m, one.z_m, one.heading_rad, one.speed_mps] for one in poses]
    ).reshape(-1, 5)
    course = [one.heading_rad if one.course_rad is None else one.course_rad for one in poses]
    velocity = table[:, 4:] * frames.unit(np.array(course).reshape(-1))
    return np.concatenate([table[:, :4], velocity], axis=1)


def raised(agent: AgentId, pose: Pose, sumo_z_m: float, before: "Frame", ground: Ground) -> Pose:
    """The pose of a vehicle that is put there, with its height: SUMO's, except where roads cross.

    There SUMO takes the nearest lane by x and y alone; the vehicle follows the road from where it
    was in the frame before.
    """
    if not (ground.has_levels and agent in before.ids):
        return replace(pose, z_m=sumo_z_m)
    row = before.ids.index(agent)
    moved = np.array([[before.position_m[row], (pose.x_m, pose.y_m)]])
    return replace(pose, z_m=float(ground.follow(moved, before.z_m[row : row + 1])[0, 1]))


_ARRAYS: Final = ("position_m", "z_m", "heading_rad", "velocity_mps", "driver")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """All N agents that are present at one step.

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
        """A frame of agents that are given one by one."""
        state = states([pose for pose, _ in poses.values()])
        return Frame(
            ids=list(poses),
            position_m=state[:, :2],
            z_m=state[:, 2],
            heading_rad=state[:, 3],
            velocity_mps=state[:, 4:],
            driver=np.array([int(driver) for _, driver in poses.values()], np.uint8),
        )

    @staticmethod
    def of_sumo(ids: list[AgentId], states: Sequence[Sequence[float]], length_m: Floats) -> "Frame":
        """A frame of N agents as SUMO states them, all driven by SUMO.

        ``states``: (N, 5) x, y of the front bumper, angle (degrees), speed, z. ``length_m``: (N).
        """
        table = np.fromiter(chain.from_iterable(states), float, 5 * len(states)).reshape(-1, 5)
        centre, heading = frames.from_sumo(table[:, :2], table[:, 2], length_m)
        return Frame(
            ids=ids,
            position_m=centre,
            z_m=table[:, 4],
            heading_rad=heading,
            velocity_mps=table[:, 3:4] * frames.unit(heading),
            driver=np.full(len(ids), int(Driver.SUMO), np.uint8),
        )

    def with_poses(self, poses: dict[AgentId, tuple[Pose, Driver]]) -> "Frame":
        """This frame with the given agents: in their rows, or after all others if they are new."""
        if not poses:
            return self
        more = Frame.of_poses(poses)
        rows = [self.ids.index(agent) for agent in more.ids if agent in self.ids]
        if len(rows) == len(more.ids):  # mostly: only the AV and an opponent, where many are
            changed = {name: getattr(self, name).copy() for name in _ARRAYS}
            for name, values in changed.items():
                values[rows] = getattr(more, name)
            return Frame(ids=self.ids, **changed)
        row_of = {agent: row for row, agent in enumerate([*self.ids, *more.ids])}
        rows = list(row_of.values())  # the given pose in the place of the frame's own
        both = {
            name: np.concatenate([getattr(self, name), getattr(more, name)])[rows]
            for name in _ARRAYS
        }
        return Frame(ids=list(row_of), **both)

    def without(self, agent: AgentId) -> "Frame":
        """This frame without an agent."""
        return self._of_rows([row for row, one in enumerate(self.ids) if one != agent])

    def of_agents(self, agents: Collection[AgentId]) -> "Frame":
        """This frame with the given agents alone."""
        return self._of_rows([row for row, one in enumerate(self.ids) if one in agents])

    def _of_rows(self, rows: list[int]) -> "Frame":
        kept = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return Frame(ids=[self.ids[row] for row in rows], **kept)
