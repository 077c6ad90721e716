"""Tracking: a model of the opponent's body follows reference paths within its limits of motion.

A predictor knows no limits, and its first sample need not join the current state. A single-track
model therefore follows every candidate from the current state *before* it is assessed, so that the
assessed motion is the executed one. The course (direction of motion of the box centre) turns at
most as fast as the lateral limit and the steering angle allow; the rear axle follows like a
trailer, which gives the heading.

The controller looks ahead along the path (pure pursuit: Coulter, CMU-RI-TR-92-01, 1992), keeps time
by a critically damped law with feed-forward, and slows down ahead of curves.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.scene import DT_S, AgentId, Floats, Ints, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS, MotionModel, road_user

Complexes = NDArray[np.complex128]
Along = TypeVar("Along", Floats, Complexes)

_SPACING_M = 0.5
_BEYOND_M = 40.0  # every path is extended straight by this length, the farthest look-ahead
_DIRECTED_M = 0.3  # a shorter last metre gives no direction
_STANDING_M = 0.005  # shorter steps are noise of a standing vehicle
_SMOOTHING_STEPS = 2  # speeds of a reference are differences over 0.4 s
_BEND_POINTS = 4  # curvature is the turn over 4 m
_SHARE = 0.9  # of the limits is used in curves; the rest corrects tracking errors
_SLOWEST_MPS = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Courses:
    """M paths (M, G) sampled every 0.5 m, and where each reference is on its path (M, F + 1).

    Points are complex numbers, x + iy, and everything that the tracking loop reads in its 80 steps
    is prepared: look-ups are a third of its cost.

    Attributes:
        path_m: (M, G) points. ahead_m: (M, G) from each point to the next, 0 at the end.
        square_m2: (M, G) squares of these distances, above 0.
        fastest_mps: (M, G) highest speeds at which the curves ahead can still be driven.
        due_m, speed_mps, accel_mps2: (F + 1, M) of the references. row: (M) flat index of points 0.
    """

    path_m: Complexes
    ahead_m: Complexes
    square_m2: Floats
    fastest_mps: Floats
    due_m: Floats
    speed_mps: Floats
    accel_mps2: Floats
    row: Ints

    @classmethod
    def along(
        cls, reference_m: Floats, start_m: Floats, course_rad: float, limits: Floats
    ) -> "Courses":
        """Courses of references (M, F, 2) from a start (2); limits (M, 3) bound speed in curves."""
        points = np.empty((len(reference_m), reference_m.shape[1] + 1), dtype=np.complex128)
        points[:, 0] = complex(*start_m)
        points[:, 1:] = reference_m[..., 0] + 1j * reference_m[..., 1]
        step = np.abs(np.diff(points, axis=1))
        step[step < _STANDING_M] = 0.0
        length = np.concatenate([np.zeros((len(step), 1)), np.cumsum(step, axis=1)], axis=1)
        path = _resampled(points, length, course_rad)
        ahead = np.diff(path, axis=1, append=path[:, -1:])
        speed = _smooth_speed(length)
        return cls(
            path_m=path,
            ahead_m=ahead,
            square_m2=np.maximum(square(ahead), 1e-9),
            fastest_mps=np.sqrt(_curve_limit(path, limits)),
            due_m=np.ascontiguousarray(length.T),
            speed_mps=np.ascontiguousarray(speed.T),
            accel_mps2=np.ascontiguousarray(np.gradient(speed, DT_S, axis=1).T),
            row=np.arange(len(path)) * path.shape[1],
        )

    def timing(self, step: int) -> tuple[Floats, Floats, Floats]:
        """Arc length, speed, acceleration of the references ``step`` steps from now, (M) each."""
        return self.due_m[step], self.speed_mps[step], self.accel_mps2[step]

    def point(self, along_m: Floats) -> Complexes:
        """Points at arc lengths (M), one for each path."""
        cell, share = self._cell(along_m)
        return self.path_m.take(cell) + share * self.ahead_m.take(cell)

    def progress(self, guess_m: Floats, least_m: Floats, position_m: Complexes) -> Floats:
        """Arc lengths (M) of the feet of points, near ``guess_m`` and at least ``least_m``."""
        cell, share = self._cell(guess_m)
        off = position_m - self.path_m.take(cell)
        product = off * self.ahead_m.take(cell).conj()
        foot = product.real / self.square_m2.take(cell)
        correction = np.minimum(np.maximum((foot - share) * _SPACING_M, -0.5), 0.5)
        return np.maximum(guess_m + correction, least_m)

    def speed_limit(self, along_m: Floats) -> Floats:
        """Highest speed (M) at which the curves ahead can still be driven."""
        return self.fastest_mps.take(self._cell(along_m)[0])

    def _cell(self, along_m: Floats) -> tuple[Ints, Floats]:
        """Rows (M) in the flat arrays, and shares of the distance to the next point."""
        place = np.minimum(along_m / _SPACING_M, self.path_m.shape[1] - 1.001)
        cell = place.astype(np.int64)
        return self.row + cell, place - cell


def square(number: Complexes) -> Floats:
    """Squares of the lengths of complex numbers."""
    return number.real**2 + number.imag**2


def _resampled(points: Complexes, length: Floats, course_rad: float) -> Complexes:
    """(M, G) points every 0.5 m, continued straight in the direction of the last metre."""
    total = length[:, -1]
    grid = np.arange(0.0, total.max() + _BEYOND_M, _SPACING_M)
    path = np.empty((len(points), len(grid)), dtype=np.complex128)
    for row, (mode, along) in enumerate(zip(points, length, strict=True)):
        end = mode[-1] - np.interp(max(total[row] - 1.0, 0.0), along, mode)
        # A standing vehicle goes on in the direction of its heading.
        ahead = end / np.abs(end) if np.abs(end) > _DIRECTED_M else np.exp(1j * course_rad)
        path[row] = np.interp(grid, along, mode) + np.maximum(grid - total[row], 0.0) * ahead
    return path


def _smooth_speed(length: Along) -> Along:
    """(M, F + 1) speeds as differences of arc length over 0.4 s, shorter at both ends.

    Velocities, if positions are given.
    """
    last = length.shape[1] - 1
    steps = np.arange(last + 1)
    low = np.maximum(steps - _SMOOTHING_STEPS, 0)
    high = np.minimum(steps + _SMOOTHING_STEPS, last)
    speed: Along = (length[:, high] - length[:, low]) / ((high - low) * DT_S)
    return speed


def _curve_limit(path: Complexes, limits: Floats) -> Floats:
    """(M, G) squares of the highest speeds: v^2 <= lateral / curvature, and braking in time."""
    ahead = np.diff(path, axis=1)
    turn = np.zeros(path.shape)
    bend = np.abs(np.angle(ahead[:, 2 * _BEND_POINTS :] * ahead[:, : -2 * _BEND_POINTS].conj()))
    turn[:, _BEND_POINTS + 1 : _BEND_POINTS + 1 + bend.shape[1]] = bend
    curvature = turn / (2 * _BEND_POINTS * _SPACING_M)
    square = _SHARE * limits[:, 2:3] / np.maximum(curvature, 1e-6)
    square = np.maximum(square, _SLOWEST_MPS**2)
    # v(s)^2 <= v(s')^2 + 2 b (s' - s) for every s' ahead: a running minimum from the far end.
    slope = 2 * _SHARE * limits[:, 1:2] * _SPACING_M * np.arange(path.shape[1])
    return np.minimum.accumulate((square + slope)[:, ::-1], axis=1)[:, ::-1] - slope


_JOIN_STEPS = 15  # an initial mismatch of the prediction fades out over 1.5 s
_LOOKAHEAD_S, _LOOKAHEAD_M = 0.6, 2.0
_DAMPING_PER_S = 2.0  # both poles of the timing law
_REST_MPS = 0.05  # a slower pedestrian turns freely
_FACES_RPS = 5.0  # half a turn in 0.6 s
_STEPS_MPS = 0.3  # recorded positions of a pedestrian who stands move as fast
_COURSE_MPS = 1.0  # slower, a measured velocity does not show the slip angle: 0.1 m/s are 6 degrees
_COURSE_SLIP = 0.2  # largest slip angle that is taken from a measured velocity, radians


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """The state now: box centre (2), heading, course and speed, length, and how it can move."""

    position_m: Floats
    heading_rad: float
    course_rad: float
    speed_mps: float
    length_m: float
    motion: MotionModel = ROAD_USERS["car"].motion

    @property
    def rear_m(self) -> float:
        """Distance of the rear axle behind the centre."""
        return self.motion.rear_axle * self.length_m

    @classmethod
    def of(cls, view: View, agent_id: AgentId) -> "Start":
        """Current state of an agent. A vehicle that rolls backwards starts at rest.

        A pedestrian goes in the direction of its velocity, whatever its heading.
        """
        tracks = view.history
        row = tracks.row(agent_id)
        heading = float(tracks.heading_rad[row, -1])
        velocity = tracks.velocity_mps[row, -1]
        motion = road_user(tracks.kinds[row], tracks.size_m[row]).motion
        if motion.body == "point":
            return cls._on_foot(tracks.position_m[row, -1], heading, velocity, motion)
        speed = max(0.0, float(velocity @ frames.unit(heading)))
        course = heading
        if speed > _COURSE_MPS:
            slip = float(frames.difference(np.arctan2(velocity[1], velocity[0]), heading))
            course += float(np.clip(slip, -_COURSE_SLIP, _COURSE_SLIP))
        return cls(
            position_m=tracks.position_m[row, -1],
            heading_rad=heading,
            course_rad=course,
            speed_mps=speed,
            length_m=float(tracks.size_m[row, 0]),
            motion=motion,
        )

    @classmethod
    def _on_foot(
        cls, position_m: Floats, heading_rad: float, velocity_mps: Floats, motion: MotionModel
    ) -> "Start":
        speed = float(np.hypot(*velocity_mps))
        moves = speed > _STEPS_MPS
        course = float(np.arctan2(velocity_mps[1], velocity_mps[0])) if moves else heading_rad
        return cls(
            position_m=position_m,
            heading_rad=heading_rad,
            course_rad=course,
            speed_mps=speed if moves else 0.0,
            length_m=0.0,
            motion=motion,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracked:
    """M drivable futures: (M, F, 2), (M, F), (M, F), and (M) largest distance to the reference.

    Speeds are those at the end of a step; differences of single steps are rough (2 to 3 m/s2).
    """

    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    bent_m: Floats


def joined(reference_m: Floats, start: Start) -> Floats:
    """(M, F, 2) references shifted so that they start at the vehicle's position in one step.

    The shift fades out over 1.5 s.
    """
    reference = np.asarray(reference_m, float)
    expected = start.position_m + start.speed_mps * DT_S * frames.unit(start.course_rad)
    share = np.clip(np.arange(reference.shape[1]) / _JOIN_STEPS, 0.0, 1.0)
    fade = 1.0 - share * share * (3.0 - 2.0 * share)
    return reference + (expected - reference[:, :1]) * fade[:, None]


def track(reference_m: Floats, start: Start, limits: Floats) -> Tracked:
    """Follow M references (M, F, 2) from the current state, each within its limits (M, 3).

    Guarantees for the box centre: the first pose is one step's drive away from the start; speed
    changes by at most accel*dt and brake*dt a step and is never negative, nor above the fastest of
    the start's class (who is faster now gets no faster); speed times turn rate of the course stays
    within the lateral limit, but a pedestrian at rest starts towards any side.
    """
    reference = np.asarray(reference_m, float)
    candidates, steps = reference.shape[:2]
    follows = joined(reference, start)
    state: _Pedestrian | _SingleTrack
    if start.motion.body == "point":
        state = _Pedestrian(follows, start, limits)
    else:
        courses = Courses.along(follows, start.position_m, start.course_rad, limits)
        state = _SingleTrack(courses, candidates, start, limits)
    place = np.empty((steps, candidates), dtype=np.complex128)
    heading, speed = np.empty((steps, candidates)), np.empty((steps, candidates))
    for step in range(steps):
        state.advance(step)
        place[step], heading[step], speed[step] = state.pose()
    position = np.stack([place.T.real, place.T.imag], -1)
    bent = np.hypot(*np.moveaxis(position - reference, -1, 0)).max(axis=1)
    return Tracked(
        position_m=position,
        heading_rad=frames.wrap(np.ascontiguousarray(heading.T)),
        speed_mps=np.ascontiguousarray(speed.T),
        bent_m=bent,
    )


class _SingleTrack:
    """States of M single-track vehicles that follow M courses; all arrays (M)."""

    def __init__(self, courses: Courses, candidates: int, start: Start, limits: Floats) -> None:
        self._courses = courses
        self._place = np.full(candidates, complex(*start.position_m))
        self._course = np.full(candidates, start.course_rad)
        self._slip = self._course - start.heading_rad
        self._speed = np.full(candidates, start.speed_mps)
        self._along = np.zeros(candidates)
        self._rear_m = start.rear_m
        self._curvature = np.sin(start.motion.slip_rad) / self._rear_m
        self._fastest_mps = max(start.motion.fastest_mps, start.speed_mps)
        self._accel, self._brake, self._lateral = np.asarray(limits, float).T

    def pose(self) -> tuple[Complexes, Floats, Floats]:
        """Position x + iy, heading, speed, (M) each."""
        return self._place, self._course - self._slip, self._speed

    def advance(self, step: int) -> None:
        """One step of DT_S towards where the references are at ``step`` (0: one step from now)."""
        courses = self._courses
        before, after = self._speed, self._next_speed(courses, step)
        curvature = self._steer(courses, np.maximum(before, after))
        mean = (before + after) / 2
        turn, driven = curvature * mean * DT_S, mean * DT_S
        self._place = self._place + driven * np.exp(1j * (self._course + turn / 2))
        self._course = self._course + turn
        # The slip of a trailed rear axle, solved exactly for a constant curvature and small slip.
        steady = np.arcsin(curvature * self._rear_m)
        fade = np.exp(driven / -self._rear_m)
        self._slip = steady + (self._slip - steady) * fade
        self._speed = after
        self._along = courses.progress(self._along + driven, self._along, self._place)

    def _next_speed(self, courses: Courses, step: int) -> Floats:
        """Speed after the step: keep to the reference's timing, slow down for curves."""
        due, speed, accel = courses.timing(step)
        wanted = accel + 2 * _DAMPING_PER_S * (speed - self._speed)
        wanted = wanted + _DAMPING_PER_S**2 * (due - self._along)
        allowed = (courses.speed_limit(self._along) - self._speed) / DT_S
        chosen = np.maximum(np.minimum(np.minimum(wanted, allowed), self._accel), -self._brake)
        after = np.minimum(self._speed + chosen * DT_S, self._fastest_mps)
        return np.maximum(after, 0.0)

    def _steer(self, courses: Courses, fastest: Floats) -> Floats:
        """Curvature of the arc to the point ahead on the course, within the limits."""
        ahead = np.maximum(_LOOKAHEAD_M, _LOOKAHEAD_S * self._speed)
        target = courses.point(self._along + ahead) - self._place
        left = (target * np.exp(-1j * self._course)).imag
        wanted = 2 * left / np.maximum(square(target), 1e-6)
        bound = np.minimum(self._curvature, self._lateral / np.maximum(fastest**2, 1e-6))
        return np.minimum(np.maximum(wanted, -bound), bound)


class _Pedestrian:
    """States of M pedestrians who follow M references (M, F, 2); all arrays (M)."""

    def __init__(self, reference_m: Floats, start: Start, limits: Floats) -> None:
        count, steps = reference_m.shape[:2]
        due = np.empty((steps + 1, count), dtype=np.complex128)
        due[0] = complex(*start.position_m)
        due[1:] = (reference_m[..., 0] + 1j * reference_m[..., 1]).T
        self._due = due
        self._due_velocity = _smooth_speed(due.T).T
        self._due_accel = np.gradient(self._due_velocity, DT_S, axis=0)
        self._place = due[0].copy()
        self._course = np.full(count, start.course_rad)
        self._heading = np.full(count, start.heading_rad)
        self._speed = np.full(count, start.speed_mps)
        self._fastest_mps = max(start.motion.fastest_mps, start.speed_mps)
        self._accel, self._brake, self._lateral = np.asarray(limits, float).T

    def pose(self) -> tuple[Complexes, Floats, Floats]:
        """Position x + iy, heading, speed, (M) each."""
        return self._place, self._heading, self._speed

    def advance(self, step: int) -> None:
        """One step of DT_S towards where the references are at ``step`` (0: one step from now)."""
        before = self._speed
        wanted = self._wanted_velocity(step)
        size, side = np.abs(wanted), np.angle(wanted)
        stands = before <= _REST_MPS
        course = np.where(stands & (size > _REST_MPS), side, self._course)
        wanted_turn = frames.difference(side, course)
        ahead = size * np.cos(wanted_turn)
        after = np.minimum(np.maximum(ahead, before - self._brake * DT_S), self._fastest_mps)
        after = np.maximum(np.minimum(after, before + self._accel * DT_S), 0.0)
        after = np.where(stands & (size <= _REST_MPS), 0.0, after)
        bound = self._lateral * DT_S / np.maximum(np.maximum(before, after), _REST_MPS)
        turn = np.clip(np.where(size > _REST_MPS, wanted_turn, 0.0), -bound, bound)
        driven = (before + after) / 2 * DT_S
        self._place = self._place + driven * np.exp(1j * (course + turn / 2))
        self._course, self._speed = course + turn, after
        facing = frames.difference(self._course, self._heading) * (after > _REST_MPS)
        self._heading = self._heading + np.clip(facing, -_FACES_RPS * DT_S, _FACES_RPS * DT_S)

    def _wanted_velocity(self, step: int) -> Complexes:
        """(M) velocities vx + i vy after the step that keep to the references' timing."""
        now = self._speed * np.exp(1j * self._course)
        accel = self._due_accel[step] + 2 * _DAMPING_PER_S * (self._due_velocity[step] - now)
        accel = accel + _DAMPING_PER_S**2 * (self._due[step] - self._place)
        return np.asarray(now + accel * DT_S)
