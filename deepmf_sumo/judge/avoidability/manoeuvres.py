"""What the AV could have done: evasive manoeuvres, and changes of its own drive.

About a hundred manoeuvres could have been started without delay. Each brakes with a constant
deceleration (0 keeps the speed), or drives as the AV did, and swerves with a constant lateral
acceleration to one side up to a target offset, where it goes on beside its path. The model is
kinematic: the grip of the tyres is 8 m/s2 in total (a dry road), and the turning circle of the rear
axle has a radius of 5 m.

A `Drive` is the AV as it drove until the contact, and changed one thing at a time, on its own path:
how far along it would have been. After the contact it goes on as it was: it keeps braking as hard
as at the contact, or keeps its speed. A changed AV is never faster than it was, unless the change
is that it does not brake.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, Self

import numpy as np

from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.judge.avoidability.reference_drivers import DELAY_S, JERK_MPS3, CompetentCareful
from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.scene.geometry.slow import WAITING_MPS

GRIP_MPS2: Final = 8.0
LATERAL_MPS2: Final = 6.0
BRAKING_MPS2: Final = (0.0, 2.0, 4.0, 6.0, GRIP_MPS2)
_SWERVES_MPS2 = (2.0, 4.0, LATERAL_MPS2)
_OFFSETS_M = (0.5, 1.0, 2.0, 3.5)
_RADIUS_M = 5.0
_SLOPE = 0.5  # largest angle between car and path, as a tangent
_BEND_M = 4.0
_SHARPEST = 1 / _RADIUS_M
_BRAKES_MPS2: Final = 1.0
"""A smaller deceleration is not a reaction: it comes from a lifted foot or a bend."""
COMFORTABLE_MPS2: Final = 3.5
"""A stop that a driver plans needs no more than this."""
_WINDOW: Final = 3
"""Steps over which decelerations are taken."""


class Manoeuvres(NamedTuple):
    """M manoeuvres: deceleration, lateral acceleration, target offset to the left; each (M).

    ``as_driven``: (M) along the path as the AV, instead of braking.
    """

    braking_mps2: Floats
    lateral_mps2: Floats
    offset_m: Floats
    as_driven: Bools


class ManoeuvrePaths(NamedTuple):
    """M manoeuvres over K steps, and whether their grip is enough in the path's bends.

    ``along_m``, ``left_m``: (M, K) on the path. ``centre_m`` (M, K, 2), ``heading_rad`` (M, K): of
    the box. ``holds``: (M).
    """

    along_m: Floats
    left_m: Floats
    centre_m: Floats
    heading_rad: Floats
    holds: Bools


def _grid() -> Manoeuvres:
    swerves = [
        (lateral, side * offset)
        for lateral in _SWERVES_MPS2
        for offset in _OFFSETS_M
        for side in (1.0, -1.0)
    ]
    rows = [
        (braking, lateral, offset, as_driven)
        for braking, as_driven in [(0.0, True), *((braking, False) for braking in BRAKING_MPS2)]
        for lateral, offset in [(0.0, 0.0), *swerves]
        if np.hypot(braking, lateral) <= GRIP_MPS2
    ]
    braking, lateral, offset, as_driven = (np.array(column) for column in zip(*rows, strict=True))
    return Manoeuvres(braking, lateral, offset, as_driven)


GRID: Final = _grid()
"""All manoeuvres within the grip of the tyres on a straight road."""


def drive(path: AvPath, av_along_m: Floats, dt_s: float) -> ManoeuvrePaths:
    """All of `GRID` from the first of the arc lengths (K), K > 1, at which the AV was."""
    along, speed = _along(av_along_m, dt_s)
    left, aside = _aside(speed, dt_s)
    on_path, heading = path.at(along)
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    return ManoeuvrePaths(
        along_m=along,
        left_m=left,
        centre_m=on_path + left[..., None] * normal,
        heading_rad=heading + np.arctan2(aside, np.maximum(speed, 1e-3)),
        holds=_holds(path, along, speed),
    )


def _along(av_along_m: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """(M, K) arc lengths and speeds: as driven, or under constant braking until standstill."""
    speeds = np.maximum(np.gradient(av_along_m, dt_s), 0.0)
    braking = GRID.braking_mps2[:, None]
    stands_s = np.where(braking > 0, speeds[0] / np.where(braking > 0, braking, 1.0), np.inf)
    moving_s = np.minimum(np.arange(len(speeds)) * dt_s, stands_s)
    along = av_along_m[0] + speeds[0] * moving_s - braking * moving_s**2 / 2
    speed = np.maximum(speeds[0] - braking * moving_s, 0.0)
    driven = GRID.as_driven[:, None]
    return np.where(driven, av_along_m, along), np.where(driven, speeds, speed)


def _aside(speed_mps: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """(M, K) offset to the left and its rate: swerve, then straighten to end at the offset.

    At low speed the steering angle limits the swerve; a car that stands does not move sideways.
    """
    wanted, hardest = np.abs(GRID.offset_m), GRID.lateral_mps2
    offset, rate = np.zeros_like(speed_mps), np.zeros_like(speed_mps)
    for step in range(speed_mps.shape[1] - 1):
        speed = speed_mps[:, step]
        lateral = np.minimum(hardest, speed**2 * _SHARPEST)
        rest = np.maximum(wanted - offset[:, step], 0.0)
        # the fastest sidewards motion, kept for a step, from which the remaining
        # distance is enough to straighten
        lost = lateral * dt_s
        allowed = np.sqrt(lost**2 + 2 * lateral * rest) - lost
        faster = np.minimum(rate[:, step] + lost, speed_mps[:, step + 1] * _SLOPE)
        rate[:, step + 1] = np.minimum(faster, allowed)
        offset[:, step + 1] = offset[:, step] + rate[:, step + 1] * dt_s
    side = np.sign(GRID.offset_m)[:, None]
    return side * offset, side * rate


def _holds(path: AvPath, along_m: Floats, speed_mps: Floats) -> Bools:
    """(M) whether braking, swerve and the path's bends together stay within the tyres' grip.

    Braking below the maximum is never excluded because of a bend only: the AV drove there as well.
    """
    bend = np.abs(path.at(along_m + _BEND_M / 2)[1] - path.at(along_m - _BEND_M / 2)[1]) / _BEND_M
    turning = np.minimum(bend * speed_mps**2, GRIP_MPS2)
    swerving, braking = GRID.lateral_mps2[:, None], GRID.braking_mps2[:, None]
    moving = speed_mps > 0
    needed = np.where(moving, np.hypot(turning + swerving, braking), 0.0)
    gentle = (GRID.lateral_mps2 == 0) & (GRID.braking_mps2 <= BRAKING_MPS2[-2])
    return gentle | (needed.max(axis=1) <= GRIP_MPS2 + 0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """How the AV drove on its path, over K steps.

    Attributes:
        along_m: (K) arc length; after the contact at constant speed.
        onset, contact: steps, 0 < contact < K.
        dt_s: of a step.
    """

    along_m: Floats
    onset: int
    contact: int
    dt_s: float

    @classmethod
    def of(cls, along_m: Floats, onset: int, contact: int, dt_s: float) -> Self:
        """See the class."""
        return cls(along_m=along_m, onset=onset, contact=contact, dt_s=dt_s)

    @cached_property
    def speed_mps(self) -> Floats:
        """(K - 1) mean speeds from each step to the next; after the contact as described above."""
        speed = np.maximum(np.diff(self.along_m), 0.0) / self.dt_s
        last = self.contact - 1
        since = max(last - _WINDOW, 0)
        lost = (speed[since] - speed[last]) / (max(last - since, 1) * self.dt_s)
        if lost > _BRAKES_MPS2:
            more = np.arange(1, len(speed) - last) * self.dt_s
            speed[last + 1 :] = np.maximum(speed[last] - lost * more, 0.0)
        return speed

    def braking_from(self, first: int) -> int | None:
        """The first step from ``first`` (at least 1) on at which it begins to brake, or None."""
        speed, last = self.speed_mps, self.contact - 1
        for step in range(max(first, 1), self.contact):
            end = min(step + _WINDOW - 1, last)
            lost = speed[step - 1] - speed[step]
            mean = (speed[step - 1] - speed[end]) / (end - step + 1)
            if min(2 * lost, mean) > _BRAKES_MPS2 * self.dt_s:  # it may begin within a step
                return step
        return None

    @cached_property
    def reaction(self) -> int | None:
        """Step at which it begins to brake, at the onset or later; None if it never did."""
        return self.braking_from(self.onset)

    @cached_property
    def braking_mps2(self) -> float:
        """Its hardest braking from the reaction to the contact; 0 without a reaction."""
        if self.reaction is None:
            return 0.0
        speed = self.speed_mps[self.reaction - 1 : self.contact]
        apart = min(_WINDOW, len(speed) - 1)
        return float((speed[:-apart] - speed[apart:]).max()) / (apart * self.dt_s)

    def at(self, step: int) -> float:
        """Its speed when a step begins."""
        return float(self.speed_mps[max(step - 1, 0)])

    def _driven(self, speed_mps: Floats, back_m: float = 0.0) -> Floats:
        """(K) arc lengths at speeds (K - 1), of an AV that is ``back_m`` behind at the start."""
        gone = np.concatenate([[0.0], np.cumsum(speed_mps) * self.dt_s])
        return np.asarray(self.along_m[0] - back_m + gone)

    def reacting_earlier(self, by_s: float) -> Floats | None:
        """The braking that it did, begun earlier; None if that is before the onset."""
        reaction, steps = self.reaction, round(by_s / self.dt_s)
        if reaction is None or reaction - steps < self.onset:
            return None
        speed = self.speed_mps
        lost = speed[reaction - 1] - speed[reaction:]
        rest = np.arange(1, steps + 1) * max(lost[-1] - lost[-2], 0.0) if len(lost) > 1 else 0.0
        lost = np.concatenate([lost, np.broadcast_to(lost[-1] + rest, steps)])
        since = reaction - steps
        slower = np.maximum(speed[max(since - 1, 0)] - lost, 0.0)
        return self._driven(np.concatenate([speed[:since], np.minimum(slower, speed[since:])]))

    def braking_harder(self, hardest_mps2: float) -> Floats | None:
        """The braking that it did, scaled to a hardest one; None if it braked no less."""
        if self.reaction is None or self.braking_mps2 >= hardest_mps2:
            return None
        before = self.speed_mps[self.reaction - 1]
        lost = (before - self.speed_mps) * hardest_mps2 / self.braking_mps2
        slower = np.clip(before - lost, 0.0, self.speed_mps)
        braked = np.arange(len(slower)) >= self.reaction
        return self._driven(np.where(braked, slower, self.speed_mps))

    @cached_property
    def release(self) -> int | None:
        """Step from which it accelerated again after its reaction, by more than 1 m/s.

        None if it did not, or if it had stopped before: then it set off.
        """
        if self.reaction is None:
            return None
        speed = self.speed_mps[self.reaction : self.contact]
        slowest = int(speed.argmin())
        again = speed[-1] - speed[slowest] > _BRAKES_MPS2 and speed[slowest] > WAITING_MPS
        return self.reaction + slowest if again else None

    def braking_on(self) -> Floats | None:
        """From its release on it brakes as before; None if it did not accelerate again."""
        if self.reaction is None or self.release is None:
            return None
        speed, since = self.speed_mps, max(self.release - _WINDOW, self.reaction - 1)
        lost = (speed[since] - speed[self.release]) / ((self.release - since) * self.dt_s)
        after_s = np.maximum(np.arange(len(speed)) - self.release, 0) * self.dt_s
        slower = np.maximum(speed[self.release] - max(lost, _BRAKES_MPS2) * after_s, 0.0)
        return self._driven(np.where(after_s > 0, slower, speed))

    def reacting(self) -> Floats | None:
        """A stop like that of the careful driver, 0.75 s after the onset; None if it braked."""
        if self.reaction is not None:
            return None
        speed = self.speed_mps
        middle_s = (np.arange(len(speed)) + 0.5 - self.onset) * self.dt_s - DELAY_S
        braking = np.clip(JERK_MPS3 * middle_s, 0.0, CompetentCareful.HARDEST_MPS2)
        lost = (np.cumsum(braking) - braking / 2) * self.dt_s  # in the middle of each step
        begun = np.flatnonzero(braking)
        if not len(begun):
            return self.along_m
        slower = np.maximum(speed[max(begun[0] - 1, 0)] - lost, 0.0)
        return self._driven(np.where(braking > 0, np.minimum(slower, speed), speed))

    def slower(self, factor: float) -> Floats | None:
        """At the onset where it was, at a part of its speed; it brakes as it did.

        None if it stood.
        """
        before, speed = self.at(self.onset), self.speed_mps
        if before < _BRAKES_MPS2:
            return None
        later = np.arange(len(speed)) >= self.onset
        return self._driven(np.where(later, np.maximum(speed - (1 - factor) * before, 0.0), speed))

    def farther_back(self, distance_m: float) -> Floats:
        """As it drove, behind where it was by a distance."""
        return self._driven(self.speed_mps, distance_m)

    def not_braking(self, since: int) -> Floats:
        """At the speed that it had when it began to brake at a step."""
        speed = self.speed_mps.copy()
        speed[since:] = speed[since - 1]
        return self._driven(speed)

    def stopping_before(self, along_m: float, first: int = 0) -> Floats | None:
        """A comfortable stop with its front or centre at an arc length, begun as late as possible.

        It stands there to the end. None where no step from ``first`` to the contact allows it.
        """
        steps = np.arange(first, self.contact + 1)
        speed = self.speed_mps[np.maximum(steps - 1, 0)]
        way = along_m - self.along_m[steps]
        can: Bools = (way >= 0) & (speed**2 <= 2 * COMFORTABLE_MPS2 * np.maximum(way, 0.0))
        if not can.any():
            return None
        last = int(np.flatnonzero(can)[-1])
        begin, before, left = int(steps[last]), float(speed[last]), float(way[last])
        braking = before**2 / (2 * left) if left > 0 else COMFORTABLE_MPS2
        after_s = np.arange(len(self.along_m) - begin) * self.dt_s
        moving_s = np.minimum(after_s, before / braking if braking > 0 else 0.0)
        stop = self.along_m[begin] + before * moving_s - braking * moving_s**2 / 2
        along = self.along_m.copy()
        along[begin:] = np.minimum(stop, along[begin:])
        return np.asarray(along)
