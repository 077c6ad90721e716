"""Poses and motions of vehicles now, and features of vehicles that follow from these alone."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.scene import AgentId, Bools, Floats, Ints, Tracks, View
from deepmf_sumo.scene.geometry import frames

MOTION: Final = 34
"""Columns of `motion_columns`."""
CONSTANT: Final = 18
"""Columns of `constant_columns`."""
STILL_MPS: Final = 0.5

_TIMES_S = np.arange(0.0, 8.01, 0.5)
_BACK_STEPS = 5
"""Acceleration and yaw rate are those of the last half second."""
_MOST_YAW_RPS, _MOST_GAIN_MPS2 = 0.8, 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where an agent is now: the frame of its features."""

    agent_id: AgentId
    position_m: Floats
    heading_rad: float
    speed_mps: float

    def to_local(self, points_m: Floats) -> Floats:
        """Points (..., 2) of the scene in the agent's frame."""
        return frames.to_local(points_m, self.position_m, self.heading_rad)

    def vectors(self, vectors: Floats) -> Floats:
        """Vectors (..., 2) of the scene in the agent's frame."""
        return frames.rotate(vectors, -self.heading_rad)

    def turn_rad(self, heading_rad: Floats) -> Floats:
        """Headings (...) of the scene in the agent's frame."""
        return frames.wrap(heading_rad - self.heading_rad)


def pose_of(view: View, agent_id: AgentId) -> Pose:
    """The agent's pose at the view's step. Raises KeyError if it is not in view."""
    row = view.history.row(agent_id)
    return Pose(
        agent_id=agent_id,
        position_m=view.history.position_m[row, -1],
        heading_rad=float(view.history.heading_rad[row, -1]),
        speed_mps=float(view.history.speed_mps[row, -1]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Motion of V vehicles now, in the AV's frame; the AV is the first.

    Attributes:
        position_m, velocity_mps: (V, 2). heading_rad, speed_mps: (V).
        gain_mps2, yaw_rps: (V) change of speed and heading over the last half second.
        moved_m: (V) distance to the first known position of the last second. seen: (V) share of its
            steps in which the vehicle is known.
        size_m: (V, 2) length, width.
    """

    position_m: Floats
    velocity_mps: Floats
    heading_rad: Floats
    speed_mps: Floats
    gain_mps2: Floats
    yaw_rps: Floats
    moved_m: Floats
    seen: Floats
    size_m: Floats

    @property
    def moving(self) -> Bools:
        """(V)."""
        return (self.moved_m > 0.5) | (self.speed_mps > STILL_MPS)


def half_second_ago(valid: Bools) -> Ints:
    """(V) first step of the last half second at which agents (V, H) were seen; else now.

    Not the sixth last step that was seen: across a gap that may be a second ago, and a change over
    a gap is not the present acceleration.
    """
    recent = valid.copy()
    recent[:, : valid.shape[1] - 1 - _BACK_STEPS] = False
    return recent.argmax(1)


def recent_change(tracks: Tracks, rows: Ints, dt_s: float) -> tuple[Floats, Floats]:
    """(V) acceleration in m/s2 and yaw rate in rad/s of agents over the last half second.

    0 for an agent that was not seen before now.
    """
    back, each = half_second_ago(tracks.valid[rows]), np.arange(len(rows))
    seconds = np.maximum((tracks.steps - 1 - back) * dt_s, dt_s)
    speed, heading = tracks.speed_mps[rows], tracks.heading_rad[rows]
    turned = frames.difference(heading[:, -1], heading[each, back])
    return (speed[:, -1] - speed[each, back]) / seconds, turned / seconds


def motion_of(view: View, rows: Ints) -> Motion:
    """Motion of the given rows of the view, the AV's first."""
    tracks = view.history
    pose = pose_of(view, tracks.ids[rows[0]])
    valid = tracks.valid[rows]
    first = valid.argmax(1)
    gain, yaw = recent_change(tracks, rows, view.dt_s)
    apart = tracks.position_m[rows, -1] - tracks.position_m[rows, first]
    return Motion(
        position_m=pose.to_local(tracks.position_m[rows, -1]),
        velocity_mps=pose.vectors(tracks.velocity_mps[rows, -1]),
        heading_rad=pose.turn_rad(tracks.heading_rad[rows, -1]),
        speed_mps=tracks.speed_mps[rows, -1],
        gain_mps2=np.clip(gain, -_MOST_GAIN_MPS2, _MOST_GAIN_MPS2),
        yaw_rps=np.clip(yaw, -_MOST_YAW_RPS, _MOST_YAW_RPS),
        moved_m=np.hypot(apart[:, 0], apart[:, 1]),
        seen=valid.mean(1),
        size_m=tracks.size_m[rows, :2],
    )


def motion_columns(motion: Motion) -> Floats:
    """(V - 1, 34) of all but the AV: pose, motion, the AV in its frame, the AV's motion."""
    x, y = motion.position_m[1:].T
    vx, vy = motion.velocity_mps[1:].T
    ego_speed = motion.speed_mps[0]
    heading, speed = motion.heading_rad[1:], motion.speed_mps[1:]
    distance = np.hypot(x, y)
    closing = -(x * (vx - ego_speed) + y * vy) / np.maximum(distance, 1.0)
    cos, sin = np.cos(heading), np.sin(heading)
    back_x, back_y = -(x * cos + y * sin), x * sin - y * cos
    ego = [
        ego_speed / 15, np.log1p(ego_speed), motion.gain_mps2[0] / 3, motion.yaw_rps[0] * 3,
        float(motion.moving[0]), motion.size_m[0, 0] / 5,
        len(x) / 30, motion.moving[1:].sum() / 15,
    ]  # fmt: skip
    columns = [
        x / 30, y / 30, np.minimum(np.abs(y) / 10, 4), distance / 30, np.log1p(distance) / 2,
        np.exp(-distance / 10), x / np.maximum(distance, 1.0), y / np.maximum(distance, 1.0),
        cos, sin, vx / 15, vy / 15, speed / 15, np.log1p(speed), closing / 15,
        motion.gain_mps2[1:] / 3, motion.yaw_rps[1:] * 3, np.minimum(motion.moved_m[1:] / 5, 5),
        motion.moving[1:], motion.seen[1:], motion.size_m[1:, 0] / 5, motion.size_m[1:, 1] / 2,
        back_x / 30, back_y / 30, np.minimum(np.abs(back_y) / 10, 4), (speed - ego_speed) / 15,
    ]  # fmt: skip
    return np.concatenate(
        [np.stack(columns, 1).astype(float), np.broadcast_to(ego, (len(x), len(ego)))], 1
    )


def constant_columns(motion: Motion) -> Floats:
    """(V - 1, 18) closest approach at constant velocity, and at constant turn and acceleration.

    Six of each: least distance at the same time and that time, least distance of the paths at any
    two times, both times and their difference. Then six of the lines along both headings: distances
    and times until they cross, their difference, and whether they cross ahead of both.
    """
    straight = _paths(motion, np.zeros(len(motion.speed_mps)), np.zeros(len(motion.speed_mps)))
    turning = _paths(motion, motion.gain_mps2, motion.yaw_rps)
    return np.concatenate([_nearest(straight), _nearest(turning), _rays(motion)], axis=1)


def _paths(motion: Motion, gain_mps2: Floats, yaw_rps: Floats) -> Floats:
    """(V, 17, 2) positions over 8 s; acceleration acts for 2 s, turning for 4 s."""
    time = _TIMES_S[None]
    speed = np.maximum(motion.speed_mps[:, None] + gain_mps2[:, None] * np.minimum(time, 2.0), 0.0)
    course = motion.heading_rad[:, None] + yaw_rps[:, None] * np.minimum(time, 4.0)
    moves = motion.speed_mps > STILL_MPS
    drift = np.arctan2(motion.velocity_mps[:, 1], motion.velocity_mps[:, 0])
    slip = np.where(moves, frames.difference(drift, motion.heading_rad), 0.0)
    step = 0.5 * (speed[:, 1:] + speed[:, :-1]) * np.diff(time)
    middle = 0.5 * (course[:, 1:] + course[:, :-1]) + slip[:, None]
    paths = np.zeros((len(speed), len(_TIMES_S), 2))
    paths[:, 1:] = np.cumsum(step[..., None] * frames.unit(middle), axis=1)
    return paths + motion.position_m[:, None]


def _nearest(paths: Floats) -> Floats:
    """(V - 1, 6) of each path and the first one, see `constant_columns`."""
    own, ego = paths[1:], paths[0]
    same = np.linalg.norm(own - ego, axis=-1)
    apart = np.linalg.norm(own[:, :, None] - ego, axis=-1).reshape(len(own), -1)
    when = apart.argmin(1)
    least = np.take_along_axis(apart, when[:, None], 1)[:, 0]
    own_time, ego_time = np.divmod(when, len(_TIMES_S))
    return np.stack(
        [
            np.minimum(same.min(1) / 10, 4), same.argmin(1) / 16, np.minimum(least / 10, 4),
            own_time / 16, ego_time / 16, (own_time - ego_time) / 16,
        ],
        axis=1,
    )  # fmt: skip


def _rays(motion: Motion) -> Floats:
    """(V - 1, 6) crossing of the lines along both headings, in metres and seconds of each."""
    x, y = motion.position_m[1:].T
    sin, cos = np.sin(motion.heading_rad[1:]), np.cos(motion.heading_rad[1:])
    parallel = np.abs(sin) < 0.1
    safe = np.where(parallel, 1.0, sin)
    own_way = np.where(parallel, 200.0, np.clip(-y / safe, -100, 200))
    ego_way = np.where(parallel, 200.0, np.clip(x + own_way * cos, -100, 200))
    own_time = own_way / np.maximum(motion.speed_mps[1:], 2.0)
    ego_time = ego_way / max(float(motion.speed_mps[0]), 2.0)
    return np.stack(
        [
            own_way / 50, ego_way / 50, np.clip(own_time / 8, -1, 2), np.clip(ego_time / 8, -1, 2),
            np.clip((own_time - ego_time) / 8, -2, 2), ~parallel & (own_way > 0) & (ego_way > 0),
        ],
        axis=1,
    ).astype(float)  # fmt: skip


def rank(values: Floats) -> Floats:
    """Logarithm of one plus the rank of each value; the least value has rank 0."""
    return np.log1p(values.argsort(kind="stable").argsort(kind="stable"))
