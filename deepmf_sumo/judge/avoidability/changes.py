"""The AV changed one thing at a time, on its own path: how far along it would have been.

A `Drive` is the AV as it drove until the contact. After that it goes on as it was: it keeps braking
as hard as at the contact, or keeps its speed. A changed AV is never faster than it was, unless the
change is that it does not brake.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from deepmf_sumo.judge.avoidability.reference_drivers import DELAY_S, JERK_MPS3, CompetentCareful
from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.scene.geometry.slow import WAITING_MPS

BRAKES_MPS2: Final = 1.0
"""A smaller deceleration is not a reaction: it comes from a lifted foot or a bend."""
COMFORTABLE_MPS2: Final = 3.5
"""A stop that a driver plans needs no more than this."""
_WINDOW: Final = 3
"""Steps over which decelerations are taken."""


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
        if lost > BRAKES_MPS2:
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
            if min(2 * lost, mean) > BRAKES_MPS2 * self.dt_s:  # it may begin within a step
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
        again = speed[-1] - speed[slowest] > BRAKES_MPS2 and speed[slowest] > WAITING_MPS
        return self.reaction + slowest if again else None

    def braking_on(self) -> Floats | None:
        """From its release on it brakes as before; None if it did not accelerate again."""
        if self.reaction is None or self.release is None:
            return None
        speed, since = self.speed_mps, max(self.release - _WINDOW, self.reaction - 1)
        lost = (speed[since] - speed[self.release]) / ((self.release - since) * self.dt_s)
        after_s = np.maximum(np.arange(len(speed)) - self.release, 0) * self.dt_s
        slower = np.maximum(speed[self.release] - max(lost, BRAKES_MPS2) * after_s, 0.0)
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
        if before < BRAKES_MPS2:
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
