"""Which driver owns an agent at a step, and how an agent changes its owner.

Every agent has one owner at each step (`Driver`): the log, SUMO, the planner (of the AV), or the
policy (of an opponent). **A hand-over begins where the agent is.** But for the last row, no owner
puts an agent where a plan, the log or SUMO would have it:

| from | to | how |
| --- | --- | --- |
| log, SUMO | policy | the policy sees where the agent is, and its plan begins one step from there |
| policy | log | only at a step whose logged pose is reached without a jump (`continues`) |
| policy | SUMO | only from a pose from which SUMO drives on without moving or turning it |
| policy | nobody yet | it follows the nearest lane (`way_on`), in the log to a stop |
| policy | nobody yet | a person walks to the nearest footway (`on_foot`), in the log it stops |
| log | planner | from the recorded pose of the current step |
| planner | planner | off every lane, where SUMO drives nothing: it goes back to one, or stops |
| nobody yet | SUMO | after 30 s without a lane, said by an event: `Takeover.hand_back` |

An agent that nobody owns yet is recorded as `Driver.POLICY`. `NextOwner` is the question that a
world answers; `attack_schedule` asks it for opponents. An overlap that begins in the step of a
hand-over is no contact (`contacts`).
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from deepmf_sumo.scene import DT_S, AgentId, Tracks
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.on_foot import Walk

_ALONG_M: Final = 0.3
_ASIDE_M: Final = 0.2
"""Recorded positions of one step are this far from those that the recorded speeds lead to."""
_TURN_RAD: Final = 0.1
_HARDEST_MPS2: Final = 10.0


class NextOwner(Protocol):
    """What drives an opponent once its plan, or its attack, is over."""

    def creep_mps(self, agent: AgentId) -> float:
        """Speed at which an agent that is not taken goes back to a lane; 0: it stops."""
        ...

    def takes(self, agent: AgentId, step: int, pose: Pose) -> bool:
        """Whether the agent goes on to ``step`` without a jump from its pose one step before."""
        ...

    def clear(self, agent: AgentId, poses: Sequence[Pose]) -> bool:
        """Whether poses of an agent are free, but for what overlaps it already."""
        ...

    def lane_cost(self, agent: AgentId, lane_id: str) -> float | None:
        """Penalty of a lane in metres, added to its distance; None: not allowed there."""
        ...

    def walk(self, agent: AgentId, pose: Pose) -> Walk | None:
        """The way of a person to where it is taken; None for those who follow lanes."""
        ...

    def refusals(self, agents: Collection[AgentId]) -> Mapping[AgentId, str]:
        """Those that no policy can drive, and why."""
        ...


def continues(before: Pose, after: Pose) -> bool:
    """Whether a vehicle gets from a pose to another within a step, with the speeds of both."""
    course = before.heading_rad if before.course_rad is None else before.course_rad
    moved = np.array([after.x_m - before.x_m, after.y_m - before.y_m])
    along, aside = frames.to_local(moved, np.zeros(2), course)
    expected = (before.speed_mps + after.speed_mps) / 2 * DT_S
    return bool(
        abs(along - expected) <= _ALONG_M
        and abs(aside) <= _ASIDE_M
        and abs(frames.difference(after.heading_rad, before.heading_rad)) <= _TURN_RAD
        and abs(after.speed_mps - before.speed_mps) <= _HARDEST_MPS2 * DT_S
    )


class LogOwner:
    """The log as the next owner: it takes an agent that is where it has it, and no other."""

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks

    def creep_mps(self, agent: AgentId) -> float:  # noqa: ARG002
        """0: what the log does not take is not driven on by anything, so it stops."""
        return 0.0

    def takes(self, agent: AgentId, step: int, pose: Pose) -> bool:
        """Whether the log has the agent at ``step`` where it gets from its pose."""
        tracks = self._tracks
        row = tracks.row(agent)
        if step >= tracks.steps or not tracks.valid[row, step]:
            return False
        return continues(pose, logged(tracks, row, step))

    def clear(self, agent: AgentId, poses: Sequence[Pose]) -> bool:  # noqa: ARG002
        """True: an agent that stops does not look out for others."""
        return True

    def lane_cost(self, agent: AgentId, lane_id: str) -> float | None:  # noqa: ARG002
        """0 for vehicles: recordings do not say which lanes they may use. Others follow no lane."""
        return 0.0 if self._tracks.kinds[self._tracks.row(agent)] == "vehicle" else None

    def walk(self, agent: AgentId, pose: Pose) -> Walk | None:
        """Of pedestrians: they stop. Recordings do not say where people may walk."""
        if self._tracks.kinds[self._tracks.row(agent)] != "pedestrian":
            return None
        return Walk(pose, ROAD_USERS["pedestrian"].motion.planned, None)

    def refusals(self, agents: Collection[AgentId]) -> Mapping[AgentId, str]:  # noqa: ARG002
        """None: a box can be put anywhere."""
        return {}


def logged(tracks: Tracks, row: int, step: int) -> Pose:
    """Pose of an agent in the log; its speed is negative if it rolls back."""
    velocity, heading = tracks.velocity_mps[row, step], float(tracks.heading_rad[row, step])
    ahead = float(velocity @ frames.unit(np.array(heading)))
    speed = float(np.hypot(*velocity))
    x, y = tracks.position_m[row, step]
    return Pose(
        x_m=float(x),
        y_m=float(y),
        heading_rad=heading,
        speed_mps=-speed if ahead < 0 else speed,
    )
