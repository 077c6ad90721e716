"""What two boxes do to each other if they go on as they move now."""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.datatypes import DT_S, Bools, Floats, Ints, Tracks
from deepmf_sumo.geometry import angles
from deepmf_sumo.geometry.ground import CLEARANCE_M

_TIMES_S = np.concatenate([np.arange(0.1, 8.0, 0.1), np.geomspace(8.0, 120.0, 50)])
"""At which braking is looked at: gentle braking brings two cars together after a long time."""
_SPAN = 2  # steps over which an acceleration is taken
_CLIMB_STEPS = 10  # heights change slowly, and recorded ones are noisy
_LEVEL: Final = np.zeros(())


class Moving(NamedTuple):
    """One agent at K steps: centre (K, 2), heading (K), velocity (K, 2); its size (2).

    ``z_m``, ``climb_mps``: (K), or () for all, its height and how fast that grows.
    """

    position_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    size_m: Floats
    z_m: Floats = _LEVEL
    climb_mps: Floats = _LEVEL

    @classmethod
    def of(cls, tracks: Tracks, row: int, steps: Ints) -> "Moving":
        """The agent of a row at steps (K)."""
        return cls(
            tracks.position_m[row, steps],
            tracks.heading_rad[row, steps],
            tracks.velocity_mps[row, steps],
            tracks.size_m[row, :2],
            tracks.z_m[row, steps],
            _climb(tracks, row, steps),
        )

    def at(self, some: Bools) -> "Moving":
        """The agent at some of its steps (K)."""
        heading, velocity = self.heading_rad[some], self.velocity_mps[some]
        z_m, climb = (np.broadcast_to(one, some.shape)[some] for one in (self.z_m, self.climb_mps))
        return Moving(self.position_m[some], heading, velocity, self.size_m, z_m, climb)


def time_to_collision(a: Moving, b: Moving) -> Floats:
    """(K) seconds until two boxes overlap at constant velocity; inf where they never do, 0 if now.

    On each of the four box axes the projections overlap during one interval of time, and so do the
    heights; the boxes overlap while all five do.
    """
    offset, relative = b.position_m - a.position_m, b.velocity_mps - a.velocity_mps
    enter, leave = _overlapping(a, b, offset, relative)
    begin, end = _within(b.z_m - a.z_m, b.climb_mps - a.climb_mps, np.array(CLEARANCE_M))
    enter, leave = np.maximum(enter, begin), np.minimum(leave, end)
    met = (enter < leave) & (leave > 0)
    seconds: Floats = np.where(met, np.maximum(enter, 0.0), np.inf)
    return seconds


def slowing(tracks: Tracks, row: int, dt_s: float) -> Floats:
    """(T) how hard an agent brakes, from its speeds 0.2 s apart; 0 where it does not, or is new."""
    speed, valid = tracks.speed_mps[row], tracks.valid[row]
    lost = (speed[:-_SPAN] - speed[_SPAN:]) / (_SPAN * dt_s)
    known = valid[:-_SPAN] & valid[_SPAN:]
    braking: Floats = np.zeros(tracks.steps)
    braking[_SPAN:] = np.where(known, np.maximum(lost, 0.0), 0.0)
    return braking


def braking_to_stay_behind(a: Moving, b: Moving, slowing_mps2: Floats, ttc_s: Floats) -> Floats:
    """(K) least constant braking of ``a`` that keeps it behind ``b``, which goes on as it moves.

    ``a`` keeps its heading and begins at once; ``b`` keeps its heading and brakes on (K) until it
    stands. 0 off a collision course (K: time to collision inf), inf where no braking is enough.
    At each time to come the boxes overlap for one interval of ways of ``a``: it has to be short
    of that, either still braking or standing.
    """
    needed = np.zeros(len(ttc_s))
    some = np.isfinite(ttc_s)
    if not some.any():
        return needed
    first, other = a.at(some), b.at(some)
    ahead = angles.unit(first.heading_rad)
    way_b = _braked_way(other.velocity_mps, slowing_mps2[some], _TIMES_S)
    offset = (other.position_m - first.position_m)[:, None] + way_b
    # moving a by s along its heading is moving b by -s: enter and leave are in metres
    enter, leave = _overlapping(first, other, offset, -ahead[:, None])
    free = np.where((enter < leave) & (leave > 0), enter, np.inf)
    speed = np.maximum((first.velocity_mps * ahead).sum(-1), 0.0)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        moving = 2 * (speed * _TIMES_S - free) / _TIMES_S**2
        standing = speed**2 / (2 * free)
        braking = np.where(moving * _TIMES_S <= speed, moving, standing)
    braking = np.where(speed * _TIMES_S <= free, 0.0, np.where(free <= 0, np.inf, braking))
    needed[some] = braking.max(axis=1)
    return needed


def _braked_way(velocity: Floats, braking: Floats, time: Floats) -> Floats:
    """(K, F, 2) ways at times (F) of what brakes (K) from velocities (K, 2) until it stands."""
    speed = np.hypot(*velocity.T)[:, None]
    limit = np.divide(
        speed, braking[:, None], out=np.full_like(speed, np.inf), where=braking[:, None] > 0
    )
    until = np.minimum(time, limit)
    share = until - np.divide(
        braking[:, None] * until**2 / 2, speed, out=np.zeros_like(until), where=speed > 0
    )
    way: Floats = share[..., None] * velocity[:, None]
    return way


def _overlapping(a: Moving, b: Moving, offset: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Interval of x in which the boxes overlap when ``b`` is at ``offset + x * rate`` from ``a``.

    Offsets and rates are (K, ..., 2), headings and sizes those of ``a`` and ``b``. An interval
    that ends before it begins is empty.
    """
    shape = np.broadcast_shapes(offset.shape, rate.shape)[:-1]
    enter, leave = np.full(shape, -np.inf), np.full(shape, np.inf)
    turned = [
        heading + turn for heading in (a.heading_rad, b.heading_rad) for turn in (0, np.pi / 2)
    ]
    for heading in turned:
        line = angles.unit(heading)
        reach = _half(line, a.heading_rad, a.size_m) + _half(line, b.heading_rad, b.size_m)
        line, reach = (_spread(part, len(shape)) for part in (line, reach[:, None]))
        begin, end = _within((offset * line).sum(-1), (rate * line).sum(-1), reach[..., 0])
        enter, leave = np.maximum(enter, begin), np.minimum(leave, end)
    return enter, leave


def _within(distance: Floats, speed: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Interval of x in which ``distance + x * speed`` is less than ``reach``, either way."""
    still = np.abs(speed) < 1e-9
    divisor = np.where(still, 1.0, speed)
    ends = (-reach - distance) / divisor, (reach - distance) / divisor
    inside = np.where(np.abs(distance) < reach, -np.inf, np.inf)
    return (
        np.where(still, inside, np.minimum(*ends)),
        np.where(still, np.inf, np.maximum(*ends)),
    )


def _climb(tracks: Tracks, row: int, steps: Ints) -> Floats:
    """(K) how fast an agent climbed in the last second, as far as it was there."""
    before = np.maximum(steps - _CLIMB_STEPS, 0)
    there = np.flatnonzero(tracks.valid[row])
    before = there[np.searchsorted(there, before)] if len(there) else before
    seconds = np.maximum(steps - before, 1) * DT_S
    climb: Floats = (tracks.z_m[row, steps] - tracks.z_m[row, before]) / seconds
    return climb


def _spread(values: Floats, axes: int) -> Floats:
    """(K, n) values with axes of length one between, as many as ``axes`` in all."""
    return values.reshape(len(values), *(1,) * (axes - 1), values.shape[1])


def _half(axis: Floats, heading: Floats, size: Floats) -> Floats:
    """(K) half the extent of boxes on axes (K, 2)."""
    along = np.abs((axis * angles.unit(heading)).sum(-1))
    across = np.abs((axis * angles.unit(heading + np.pi / 2)).sum(-1))
    half: Floats = (size[0] * along + size[1] * across) / 2
    return half
