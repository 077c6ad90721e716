"""The opponent as the driver on the AV's path sees it: how far ahead, how far aside, how fast.

All lengths are measured in the frame of the AV's path: along it, and to the left of it. The
corridor is what the AV's box sweeps if it stays on its path.
"""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple, Self

import numpy as np

from deepmf_sumo.avoidance.path import Path
from deepmf_sumo.datatypes import Bools, Floats, frozen
from deepmf_sumo.geometry import angles

_SPAN = 2
"""Steps over which velocities are taken, so that noise of a centimetre stays below 0.1 m/s."""
_PARALLEL = np.cos(np.pi / 4)
_STILL_MPS = 0.05
"""Of one component of a motion: a vehicle that drives along may drift across this slowly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Approach:
    """N motions of the opponent over K steps, as seen from the AV's path.

    Attributes:
        position_m: (N, K, 2) of the box, heading_rad: (N, K), as they are in the scene.
        size_m, av_size_m: (2) length, width.
        rear_m, front_m: (N, K) ends of the box along the path.
        along_mps: (N, K) speed along the path, negative where it comes towards the AV.
        aside_mps: (N, K) speed towards the path's line; negative: away from it.
        clearance_m: (N, K) between the box and the corridor; negative inside.
        enters_s, leaves_s: (N, K) seconds until the box begins and ceases to reach into the
            corridor, at the velocity that it has. A box that moves along the path (within 45
            degrees) and has not yet passed its line is taken to stay: it changes lanes.
        parallel: (N, K) within 45 degrees of the path's direction.
        sideways_m: (N, K) how far the box has come towards the path's line from where it was
            farthest off.
    """

    position_m: Floats
    heading_rad: Floats
    size_m: Floats
    av_size_m: Floats
    dt_s: float
    rear_m: Floats
    front_m: Floats
    along_mps: Floats
    aside_mps: Floats
    clearance_m: Floats
    enters_s: Floats
    leaves_s: Floats
    parallel: Bools
    sideways_m: Floats

    @classmethod
    def of(
        cls,
        path: Path,
        position_m: Floats,
        heading_rad: Floats,
        size_m: Floats,
        av_size_m: Floats,
        dt_s: float,
    ) -> Self:
        """Motions (N, K, 2), (N, K), K > 1, with a pose every ``dt_s``, the first being now."""
        position, heading = np.asarray(position_m, float), np.asarray(heading_rad, float)
        foot = path.project(position)
        turn = angles.difference(heading, foot.heading_rad)
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        half_along = (size_m[0] * cos + size_m[1] * sin) / 2
        reach = (size_m[0] * sin + size_m[1] * cos + av_size_m[1]) / 2
        velocity = _velocities(position, dt_s)
        left_mps = (velocity * angles.unit(foot.heading_rad + np.pi / 2)).sum(-1)
        parallel = np.cos(turn) > _PARALLEL
        far = np.abs(foot.left_m)
        enters, leaves = _crossing_times(foot.left_m, left_mps, reach, parallel)
        return cls(
            position_m=frozen(position),
            heading_rad=frozen(heading),
            size_m=frozen(size_m),
            av_size_m=frozen(av_size_m),
            dt_s=dt_s,
            rear_m=foot.along_m - half_along,
            front_m=foot.along_m + half_along,
            along_mps=(velocity * angles.unit(foot.heading_rad)).sum(-1),
            aside_mps=-np.sign(foot.left_m) * left_mps,
            clearance_m=far - reach,
            enters_s=enters,
            leaves_s=leaves,
            parallel=parallel,
            sideways_m=np.maximum.accumulate(far, axis=1) - far,
        )

    @property
    def steps(self) -> int:
        """Number of steps, K."""
        return int(self.heading_rad.shape[1])

    def since(self, step: int) -> Self:
        """The same motions from a step on."""
        parts = {
            part.name: getattr(self, part.name)[:, step:]
            for part in fields(self)
            if part.name not in ("size_m", "av_size_m", "dt_s")
        }
        return replace(self, **parts)

    def seen(self, step: int, along_m: Floats, speed_mps: Floats, braking_mps2: Floats) -> "Sight":
        """What drivers at these arc lengths, speeds and decelerations (D, N) see at a step."""
        front_m = along_m + self.av_size_m[0] / 2
        rear = front_m - self.av_size_m[0]
        along_mps, enters_s = self.along_mps[:, step], self.enters_s[:, step]
        gap = self.rear_m[:, step] - front_m
        closing = speed_mps - along_mps
        reach_s = np.where(gap <= 0, 0.0, _time(gap, closing))
        past = np.where(closing > 0, self.front_m[:, step] - rear, -gap)
        meets_s = np.maximum(reach_s, enters_s)
        parts_s = np.minimum(_time(past, np.abs(closing)), self.leaves_s[:, step])
        ahead = self.rear_m[:, step] + self.front_m[:, step] > 2 * rear
        return Sight(
            speed_mps=speed_mps,
            braking_mps2=braking_mps2,
            along_mps=along_mps,
            aside_mps=self.aside_mps[:, step],
            gap_m=gap,
            clearance_m=self.clearance_m[:, step],
            sideways_m=self.sideways_m[:, step],
            parallel=self.parallel[:, step],
            ahead=ahead,
            reach_s=reach_s,
            meets_s=np.where(ahead & (meets_s < parts_s), meets_s, np.inf),
            enters_s=enters_s,
            leaves_s=self.leaves_s[:, step],
            lengths_m=float(self.size_m[0] + self.av_size_m[0]),
            dt_s=self.dt_s,
        )


class Sight(NamedTuple):
    """What drivers see of N opponents at one step; the names are those of `Approach`.

    Attributes:
        speed_mps, braking_mps2: (N) the AV's own speed, and its deceleration until now.
        gap_m: from the AV's front bumper to the box along the path, negative beside the AV.
        ahead: False where the box's middle is behind the AV's rear bumper.
        reach_s: until the gap is closed, at the speeds of this step.
        meets_s: until the two overlap along and across the path; inf where they never do.
        lengths_m: of both vehicles together.
    """

    speed_mps: Floats
    braking_mps2: Floats
    along_mps: Floats
    aside_mps: Floats
    gap_m: Floats
    clearance_m: Floats
    sideways_m: Floats
    parallel: Bools
    ahead: Bools
    reach_s: Floats
    meets_s: Floats
    enters_s: Floats
    leaves_s: Floats
    lengths_m: float
    dt_s: float

    def of(self, driver: int) -> "Sight":
        """What one of D drivers sees."""
        return self._replace(
            speed_mps=self.speed_mps[driver],
            braking_mps2=self.braking_mps2[driver],
            gap_m=self.gap_m[driver],
            ahead=self.ahead[driver],
            reach_s=self.reach_s[driver],
            meets_s=self.meets_s[driver],
        )


def _velocities(position_m: Floats, dt_s: float) -> Floats:
    """(N, K, 2) differences to the pose before, over up to 0.2 s: what can be seen by then."""
    now = np.maximum(np.arange(position_m.shape[1]), 1)
    before = np.maximum(now - _SPAN, 0)
    moved = position_m[:, now] - position_m[:, before]
    velocity: Floats = moved / ((now - before) * dt_s)[:, None]
    return velocity


def _crossing_times(
    left_m: Floats, left_mps: Floats, reach_m: Floats, parallel: Bools
) -> tuple[Floats, Floats]:
    """Seconds until a box begins and ceases to be within ``reach_m`` of the path's line."""
    speed = np.abs(left_mps)
    still = speed < _STILL_MPS
    done = left_m * np.sign(left_mps)  # position on the way across the line, which is at 0
    divisor = np.where(still, 1.0, speed)
    inside = np.abs(left_m) < reach_m
    enters = np.where(done < reach_m, np.maximum(-reach_m - done, 0.0) / divisor, np.inf)
    leaves = (reach_m - done) / divisor
    stays = still | (parallel & (done <= 0))
    enters = np.where(still, np.where(inside, 0.0, np.inf), enters)
    return enters, np.where(stays, np.inf, leaves)


def _time(distance_m: Floats, speed_mps: Floats) -> Floats:
    """Seconds to cover a distance; inf at less than 0.05 m/s."""
    moving = speed_mps > _STILL_MPS
    seconds: Floats = np.where(moving, distance_m / np.where(moving, speed_mps, 1.0), np.inf)
    return seconds
