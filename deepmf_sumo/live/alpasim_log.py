"""The log of an AlpaSim session: its objects as tracks, and the ego as it is told.

Times are microseconds. Steps of 0.1 s count from the first at which the ego is logged, and one of
them is the handover. Trajectories are of box centres, in the scene's local frame.
"""

import bisect
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Self

import numpy as np

from deepmf_sumo.live.alpasim_messages import MESSAGES
from deepmf_sumo.scene import DT_S, AgentId, AgentKind, Bools, Floats, Ints, Tracks
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.frame import Pose

EGO: Final = "EGO"
"""AlpaSim's id of the ego."""
STEP_US: Final = round(DT_S * 1e6)
_MOST_STEPS: Final = 6000
_KINDS: Final[dict[str, AgentKind]] = {
    "automobile": "vehicle", "bus": "vehicle", "car": "vehicle", "heavy_truck": "vehicle",
    "other_vehicle": "vehicle", "truck": "vehicle", "van": "vehicle", "vehicle": "vehicle",
    "pedestrian": "pedestrian", "person": "pedestrian",
    "bicycle": "cyclist", "cyclist": "cyclist", "rider": "cyclist",
}  # fmt: skip
"""By AlpaSim's ``label_class``; all others are ``other``, which do not attack."""

Status = Literal["ALREADY_EXISTS", "FAILED_PRECONDITION", "INVALID_ARGUMENT", "NOT_FOUND"]


class RefusedCall(Exception):  # noqa: N818  (it is an answer)
    """A call that is answered with a status of gRPC."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status: Status = status


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoggedWay:
    """Poses of one object: (P) times, (P, 3) centres, (P, 4) quaternions w x y z."""

    time_us: Ints
    centre_m: Floats
    turn: Floats

    @classmethod
    def of(cls, name: str, poses: Any) -> Self:
        """Of a message. Raises RefusedCall where it is empty, unordered or not finite."""
        time_us = np.array([one.timestamp_us for one in poses], np.int64)
        centre = [(one.pose.vec.x, one.pose.vec.y, one.pose.vec.z) for one in poses]
        turn = [
            (one.pose.quat.w, one.pose.quat.x, one.pose.quat.y, one.pose.quat.z) for one in poses
        ]
        made = cls(
            time_us=time_us,
            centre_m=np.array(centre, float).reshape(-1, 3),
            turn=np.array(turn, float).reshape(-1, 4),
        )
        length = np.linalg.norm(made.turn, axis=1)
        finite = np.isfinite(made.centre_m).all() and np.isfinite(length).all()
        if not len(time_us) or not finite or (length < 0.5).any() or (np.diff(time_us) <= 0).any():
            text = f"the trajectory of '{name}' is empty, out of order, or has no valid poses"
            raise RefusedCall("INVALID_ARGUMENT", text)
        return made

    @property
    def heading_rad(self) -> Floats:
        """(P) without jumps of a full turn."""
        w, x, y, z = self.turn.T
        return np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def at(self, time_us: Ints) -> Floats:
        """(T, 4) x, y, z and heading; before the first and after the last pose those."""
        known = [*self.centre_m.T, self.heading_rad]
        return np.column_stack([np.interp(time_us, self.time_us, one) for one in known])

    def turn_at(self, time_us: int) -> Floats:
        """(4) the quaternion between those of the poses around a time."""
        at = int(np.clip(np.searchsorted(self.time_us, time_us), 1, max(len(self.time_us) - 1, 1)))
        if len(self.time_us) == 1:
            return self.turn[0] / np.linalg.norm(self.turn[0])
        before, after = self.turn[at - 1], self.turn[at]
        span = float(self.time_us[at] - self.time_us[at - 1])
        share = min(max((time_us - float(self.time_us[at - 1])) / span, 0.0), 1.0)
        mixed = (1 - share) * before + share * after * (1.0 if before @ after >= 0 else -1.0)
        return mixed / np.linalg.norm(mixed)


@dataclass(slots=True, kw_only=True, eq=False)
class LoggedScene:
    """A scene as a session begins with it.

    Attributes:
        ways: by object, in the order of the request, with the ego.
        tracks: the same on steps. fixed: ids of what is static.
        first_us: time of the first step. now: the step of the handover.
    """

    ways: dict[AgentId, LoggedWay]
    tracks: Tracks
    fixed: frozenset[AgentId]
    first_us: int
    now: int
    _told_us: list[int] = field(default_factory=list)
    _told: list[Floats] = field(default_factory=list)

    @classmethod
    def of(cls, request: Any) -> Self:
        """Of a ``TrafficSessionRequest``. Raises RefusedCall."""
        logged = request.logged_object_trajectories
        ways = {one.object_id: LoggedWay.of(one.object_id, one.trajectory.poses) for one in logged}
        if EGO not in ways or len(ways) != len(logged):
            text = f"logged_object_trajectories need '{EGO}', and each object once"
            raise RefusedCall("INVALID_ARGUMENT", text)
        handover_us, ego = request.handover_time_us, ways[EGO]
        if not ego.time_us[0] <= handover_us <= ego.time_us[-1]:
            text = f"handover_time_us {handover_us} is not within the log of '{EGO}'"
            raise RefusedCall("INVALID_ARGUMENT", text)
        now = int(handover_us - ego.time_us[0]) // STEP_US
        first_us = handover_us - now * STEP_US
        last_us = max(int(one.time_us[-1]) for one in ways.values())
        steps = (last_us - first_us) // STEP_US + 1
        if steps > _MOST_STEPS:
            text = f"the log has {steps} steps of 0.1 s, and at most {_MOST_STEPS} are taken"
            raise RefusedCall("INVALID_ARGUMENT", text)
        fixed = frozenset(one.object_id for one in logged if one.is_static)
        times = first_us + STEP_US * np.arange(steps)
        return cls(
            ways=ways, tracks=_tracks(logged, ways, times, fixed), fixed=fixed,
            first_us=first_us, now=now,
        )  # fmt: skip

    @property
    def objects(self) -> list[AgentId]:
        """All but the ego."""
        return [one for one in self.ways if one != EGO]

    def time_us(self, step: int) -> int:
        """Of a step."""
        return self.first_us + step * STEP_US

    def step_at(self, time_us: int) -> int:
        """The last step up to a time; 0 before all."""
        return max((time_us - self.first_us) // STEP_US, 0)

    def follow(self, request: Any) -> None:
        """Take the ego's poses from a ``TrafficRequest``. Raises RefusedCall."""
        for one in request.object_trajectory_updates:
            if one.object_id != EGO:
                text = f"object '{one.object_id}' cannot be moved from outside; only '{EGO}' can"
                raise RefusedCall("INVALID_ARGUMENT", text)
            way = LoggedWay.of(EGO, one.trajectory.poses)
            if not self._told_us and way.time_us[0] > self.time_us(self.now):
                begin_us = self.time_us(self.now)
                self._told.append(self._ego(begin_us))
                self._told_us.append(begin_us)
            keep = bisect.bisect_left(self._told_us, int(way.time_us[0]))
            self._told_us[keep:] = way.time_us.tolist()
            self._told[keep:] = list(way.at(way.time_us))
        asked = request.time_query_us
        if asked > self.time_us(self.now) and (not self._told_us or self._told_us[-1] < asked):
            text = f"there is no pose of '{EGO}' at time_query_us {asked} or later"
            raise RefusedCall("INVALID_ARGUMENT", text)

    def ego_at(self, time_us: int) -> Pose:
        """As it was told; as logged before, up to the handover."""
        here, before = (self._ego(one) for one in (time_us, time_us - STEP_US))
        moved = (here[:2] - before[:2]) / DT_S
        return Pose(
            x_m=float(here[0]), y_m=float(here[1]), heading_rad=float(here[3]),
            speed_mps=float(np.hypot(*moved)), z_m=float(here[2]),
            course_rad=float(np.arctan2(moved[1], moved[0])) if np.hypot(*moved) > 0.1 else None,
        )  # fmt: skip

    def pose_at(self, name: AgentId, time_us: int, driven: Pose | None) -> Floats | None:
        """(7) x, y, z of the centre and w, x, y, z; None where the object is not in the log.

        ``driven``: where a plan has it; its height is the logged one, which AlpaSim's physics
        corrects.
        """
        way = self.ways[name]
        there = name in self.fixed or way.time_us[0] <= time_us <= way.time_us[-1]
        if not there and driven is None:
            return None
        centre, turn = way.at(np.array([time_us]))[0, :3], way.turn_at(time_us)
        if driven is not None:
            half = driven.heading_rad / 2
            centre = np.array([driven.x_m, driven.y_m, centre[2]])
            turn = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
        return np.concatenate([centre, turn])

    def _ego(self, time_us: int) -> Floats:
        """(4) x, y, z, heading."""
        told = bisect.bisect_left(self._told_us, time_us)
        if told < len(self._told_us) and self._told_us[told] == time_us:
            return self._told[told]
        if not told or told == len(self._told_us):  # before the handover
            return self.ways[EGO].at(np.array([time_us]))[0]
        times, values = self._told_us[told - 1 : told + 1], self._told[told - 1 : told + 1]
        share = (time_us - times[0]) / (times[1] - times[0])
        turn = frames.difference(values[1][3], values[0][3])
        mixed = (1 - share) * values[0] + share * values[1]
        mixed[3] = values[0][3] + share * turn
        return mixed


def pose_message(pose: Floats, time_us: int) -> Any:
    """``PoseAtTime`` of (7) x, y, z and w, x, y, z."""
    x, y, z, w, i, j, k = pose.tolist()
    vec, quat = MESSAGES["Vec3"](x=x, y=y, z=z), MESSAGES["Quat"](w=w, x=i, y=j, z=k)
    return MESSAGES["PoseAtTime"](pose=MESSAGES["Pose"](vec=vec, quat=quat), timestamp_us=time_us)


def _velocity(way: LoggedWay, times_us: Ints) -> Floats:
    """(T, 2) from the steps before and after, as far as it is logged."""
    begin, end = int(way.time_us[0]), int(way.time_us[-1])
    before, after = (np.clip(times_us + side, begin, end) for side in (-STEP_US, STEP_US))
    span_s = np.maximum(after - before, 1) / 1e6
    return (way.at(after) - way.at(before))[:, :2] / span_s[:, None]


def _tracks(
    logged: Any, ways: dict[AgentId, LoggedWay], times_us: Ints, fixed: frozenset[AgentId]
) -> Tracks:
    """All objects on steps; zero where they are not logged."""
    states = np.stack([way.at(times_us) for way in ways.values()])
    valid: Bools = np.stack(
        [
            (times_us >= way.time_us[0]) & (times_us <= way.time_us[-1]) | (name in fixed)
            for name, way in ways.items()
        ]
    )
    size_m = np.array([(one.aabb.size_x, one.aabb.size_y, one.aabb.size_z) for one in logged])
    if not (np.isfinite(size_m).all() and (size_m > 0).all()):
        raise RefusedCall("INVALID_ARGUMENT", "an aabb has a size that is not above 0")
    velocity = np.stack([_velocity(way, times_us) for way in ways.values()])
    heading = frames.wrap(states[..., 3])
    shown = valid[..., None]
    return Tracks(
        ids=tuple(ways),
        kinds=tuple(
            "vehicle" if one.object_id == EGO else _KINDS.get(one.label_class.lower(), "other")
            for one in logged
        ),
        size_m=size_m,
        position_m=np.where(shown, states[..., :2], 0.0),
        z_m=np.where(valid, states[..., 2] - size_m[:, None, 2] / 2, 0.0),
        heading_rad=np.where(valid, heading, 0.0),
        velocity_mps=np.where(shown, velocity, 0.0),
        valid=valid,
    )
