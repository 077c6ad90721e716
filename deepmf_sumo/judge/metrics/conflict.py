"""Conflicts of AV and opponent: distance, time to collision, braking that avoids the contact.

`MovingBox` and its functions extrapolate the motion of two boxes. `over_time` applies them to every
step of a rollout.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric, once
from deepmf_sumo.scene import DT_S, Bools, Floats, Ints, Rollout, Tracks
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.ground import CLEARANCE_M, clear, distance_m

NEVER_TOGETHER = "AV and opponent were never present at the same time"
REACTION_S = 1.0
"""Required reactions count up to this time before a contact; later ones would come too late."""
TOO_SOON = f"AV and opponent collided within {REACTION_S:g} s"
_TIMES_S = np.concatenate([np.arange(0.1, 8.0, 0.1), np.geomspace(8.0, 120.0, 50)])
"""Times at which braking is tested: with gentle braking two cars meet after a long time."""
_SPAN = 2  # steps over which an acceleration is taken
_CLIMB_STEPS = 10  # heights change slowly, and recorded ones are noisy
_LEVEL: Final = np.zeros(())


class MovingBox(NamedTuple):
    """One agent at K steps: centre (K, 2), heading (K), velocity (K, 2); its size (2).

    Or K agents, each at a step: then the size is (K, 2).
    ``z_m``, ``climb_mps``: (K), or () for all, its height and rate of climb.
    """

    position_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    size_m: Floats
    z_m: Floats = _LEVEL
    climb_mps: Floats = _LEVEL

    @classmethod
    def of(cls, tracks: Tracks, row: int, steps: Ints) -> "MovingBox":
        """The agent of a row at steps (K)."""
        return cls(
            tracks.position_m[row, steps],
            tracks.heading_rad[row, steps],
            tracks.velocity_mps[row, steps],
            tracks.size_m[row, :2],
            tracks.z_m[row, steps],
            _climb(tracks, row, steps),
        )

    def at(self, some: Bools) -> "MovingBox":
        """The agent at some of its steps (K)."""
        heading, velocity = self.heading_rad[some], self.velocity_mps[some]
        z_m, climb = (np.broadcast_to(one, some.shape)[some] for one in (self.z_m, self.climb_mps))
        size_m = self.size_m if self.size_m.ndim == 1 else self.size_m[some]
        return MovingBox(self.position_m[some], heading, velocity, size_m, z_m, climb)


def time_to_collision(a: MovingBox, b: MovingBox) -> Floats:
    """(K) seconds until two boxes overlap at constant velocity; inf if they never do, 0 if now.

    On each of the four box axes the projections overlap during one interval of time, and so do the
    heights; the boxes overlap while all five do.
    """
    offset, relative = b.position_m - a.position_m, b.velocity_mps - a.velocity_mps
    enter, leave = _overlapping(a, b, offset, relative)
    first, last = _within(b.z_m - a.z_m, b.climb_mps - a.climb_mps, np.array(CLEARANCE_M))
    enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    met = (enter < leave) & (leave > 0)
    seconds: Floats = np.where(met, np.maximum(enter, 0.0), np.inf)
    return seconds


def slowing(tracks: Tracks, row: int, dt_s: float) -> Floats:
    """(T) deceleration of an agent from speeds 0.2 s apart; 0 if it does not brake, or is new."""
    speed, valid = tracks.speed_mps[row], tracks.valid[row]
    lost = (speed[:-_SPAN] - speed[_SPAN:]) / (_SPAN * dt_s)
    known = valid[:-_SPAN] & valid[_SPAN:]
    braking: Floats = np.zeros(tracks.steps)
    braking[_SPAN:] = np.where(known, np.maximum(lost, 0.0), 0.0)
    return braking


def braking_to_stay_behind(
    a: MovingBox, b: MovingBox, slowing_mps2: Floats, ttc_s: Floats
) -> Floats:
    """(K) least constant braking of ``a`` that keeps it behind ``b``.

    ``a`` keeps its heading and brakes immediately; ``b`` keeps its heading and its braking (K)
    until it stands. 0 off a collision course (time to collision inf), inf if no braking is enough.
    At each future time the boxes overlap for one interval of distances driven by ``a``, which has
    to stay short of it, either braking or standing.
    """
    needed = np.zeros(len(ttc_s))
    some = np.isfinite(ttc_s)
    if not some.any():
        return needed
    first, other = a.at(some), b.at(some)
    ahead = frames.unit(first.heading_rad)
    moved_b = _braked_distance(other.velocity_mps, slowing_mps2[some], _TIMES_S)
    offset = (other.position_m - first.position_m)[:, None] + moved_b
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


def _braked_distance(velocity: Floats, braking: Floats, time: Floats) -> Floats:
    """(K, F, 2) displacements at times (F) of vehicles that brake (K) from velocities (K, 2)."""
    speed = np.hypot(*velocity.T)[:, None]
    limit = np.divide(
        speed, braking[:, None], out=np.full_like(speed, np.inf), where=braking[:, None] > 0
    )
    until = np.minimum(time, limit)
    share = until - np.divide(
        braking[:, None] * until**2 / 2, speed, out=np.zeros_like(until), where=speed > 0
    )
    moved: Floats = share[..., None] * velocity[:, None]
    return moved


def _overlapping(a: MovingBox, b: MovingBox, offset: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Interval of x in which the boxes overlap when ``b`` is at ``offset + x * rate`` from ``a``.

    Offsets and rates are (K, ..., 2), headings and sizes those of ``a`` and ``b``. An interval
    that ends before it starts is empty.
    """
    shape = np.broadcast_shapes(offset.shape, rate.shape)[:-1]
    enter, leave = np.full(shape, -np.inf), np.full(shape, np.inf)
    turned = [
        heading + turn for heading in (a.heading_rad, b.heading_rad) for turn in (0, np.pi / 2)
    ]
    for heading in turned:
        line = frames.unit(heading)
        reach = _half(line, a.heading_rad, a.size_m) + _half(line, b.heading_rad, b.size_m)
        line, reach = (_spread(part, len(shape)) for part in (line, reach[:, None]))
        first, last = _within((offset * line).sum(-1), (rate * line).sum(-1), reach[..., 0])
        enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    return enter, leave


def _within(distance: Floats, speed: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Interval of x in which the absolute value of ``distance + x * speed`` is below ``reach``."""
    still = np.abs(speed) < 1e-9
    divisor = np.where(still, 1.0, speed)
    ends = (-reach - distance) / divisor, (reach - distance) / divisor
    inside = np.where(np.abs(distance) < reach, -np.inf, np.inf)
    return (
        np.where(still, inside, np.minimum(*ends)),
        np.where(still, np.inf, np.maximum(*ends)),
    )


def _climb(tracks: Tracks, row: int, steps: Ints) -> Floats:
    """(K) mean rate of climb in the last second, or since the agent appeared."""
    before = np.maximum(steps - _CLIMB_STEPS, 0)
    there = np.flatnonzero(tracks.valid[row])
    before = there[np.searchsorted(there, before)] if len(there) else before
    seconds = np.maximum(steps - before, 1) * DT_S
    climb: Floats = (tracks.z_m[row, steps] - tracks.z_m[row, before]) / seconds
    return climb


def _spread(values: Floats, axes: int) -> Floats:
    """(K, n) values with ``axes`` axes: those in between have length one."""
    return values.reshape(len(values), *(1,) * (axes - 1), values.shape[1])


def _half(axis: Floats, heading: Floats, size: Floats) -> Floats:
    """(K) half the extent of boxes on axes (K, 2)."""
    along = np.abs((axis * frames.unit(heading)).sum(-1))
    across = np.abs((axis * frames.unit(heading + np.pi / 2)).sum(-1))
    half: Floats = (size[..., 0] * along + size[..., 1] * across) / 2
    return half


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairedMotion:
    """AV and opponent at the K simulated steps at which both are present.

    Attributes:
        step: (K) of the rollout. time_s: (K) since the current step.
        gap_m: (K) between the boxes; a difference in height counts beyond 2.5 m.
        ttc_s: (K) until the boxes touch if both keep velocity and heading; inf if they never do,
            or one passes over the other.
        drac_mps2: (K) relative speed over twice the time to collision; 0 off a collision course,
            inf in contact. For a follower and its leader: (speed difference)^2 / (2 gap).
        braking_mps2: (K) least constant braking, along the AV's heading and immediately, that keeps
            the AV behind an opponent with constant heading and speed, or braking; 0 off a collision
            course, inf if no braking is enough.
    """

    step: Ints
    time_s: Floats
    gap_m: Floats
    ttc_s: Floats
    drac_mps2: Floats
    braking_mps2: Floats


def over_time(rollout: Rollout) -> PairedMotion:
    """The series of one rollout. Raises NotMeasurable if the two are never present together."""
    row = _slices.opponent_row(rollout)
    av, together = _slices.together(rollout, row)
    step = np.flatnonzero(together)
    if not len(step):
        raise NotMeasurable(NEVER_TOGETHER)
    tracks = rollout.tracks
    me = MovingBox.of(tracks, av, step)
    other = MovingBox.of(tracks, row, step)
    ttc = time_to_collision(me, other)
    relative = np.hypot(*(me.velocity_mps - other.velocity_mps).T)
    braking = slowing(tracks, row, rollout.dt_s)[step]
    drac = np.divide(relative, 2 * ttc, out=np.full_like(ttc, np.inf), where=ttc > 0)
    gap = boxes.gap(
        me.position_m,
        me.heading_rad,
        me.size_m,
        other.position_m,
        other.heading_rad,
        other.size_m,
    )
    return PairedMotion(
        step=step,
        time_s=np.asarray((step - rollout.now) * rollout.dt_s, float),
        gap_m=distance_m(gap, me.z_m, other.z_m),
        ttc_s=ttc,
        drac_mps2=drac,
        braking_mps2=braking_to_stay_behind(me, other, braking, ttc),
    )


@once
def series(episode: Episode) -> PairedMotion:
    """`over_time` of an episode."""
    return over_time(episode.rollout)


def _early(episode: Episode) -> Bools:
    """(K) steps of the series up to 1 s before the contact; all without a contact."""
    found, hit = series(episode), episode.rollout.first("av_opponent")
    if hit is None:
        return np.ones(len(found.step), bool)
    early: Bools = found.step <= hit.step - round(REACTION_S / episode.rollout.dt_s)
    if not early.any():
        raise NotMeasurable(TOO_SOON)
    return early


@metric("m", better="lower")
def min_gap(episode: Episode) -> float:
    """Least distance of the boxes of AV and opponent over the simulated steps; 0 in contact."""
    return float(series(episode).gap_m.min())


@metric("s", better="lower")
def ttc_min(episode: Episode) -> float:
    """Least time over the simulated steps until the boxes of AV and opponent touch if both keep
    velocity and heading; 0 in contact.
    """
    least = float(series(episode).ttc_s.min())
    if np.isinf(least):
        raise NotMeasurable("AV and opponent were never on a collision course")
    return least


@metric("m/s2", better="higher")
def drac_max(episode: Episode) -> float:
    """Largest relative speed over twice the time to collision (same direction: speed difference
    squared over twice the gap), over the simulated steps, up to 1 s before a contact; 0 without a
    collision course.
    """
    drac = series(episode).drac_mps2[_early(episode)]
    if np.isinf(drac).any():
        raise NotMeasurable("AV and opponent overlapped without a contact that counts")
    return float(drac.max())


@metric("m/s2", better="higher")
def required_deceleration(episode: Episode) -> float:
    """Largest constant braking, along the heading of the AV and immediately, that keeps it behind
    an opponent which keeps its heading and its speed or braking, over the simulated steps, up to 1
    s before a contact; 0 without a collision course.

    After the required longitudinal deceleration of Brannstrom et al. (2008), with boxes, in two
    dimensions, without a reaction time.
    """
    hardest = float(series(episode).braking_mps2[_early(episode)].max())
    if np.isinf(hardest):
        raise NotMeasurable("at some step no braking is enough: the opponent runs into the AV")
    return hardest


def encroachment_s(rollout: Rollout) -> float:
    """Least time between AV and opponent at a common place. Raises NotMeasurable without one.

    Over all pairs of steps at which the AV's box at one and the opponent's box at the other
    overlap: 0 in contact.
    """
    row = _slices.opponent_row(rollout)
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    later = np.arange(tracks.steps) > rollout.now
    mine, theirs = (np.flatnonzero(tracks.valid[one] & later) for one in (av, row))
    shared = boxes.overlap(
        tracks.position_m[av, mine, None],
        tracks.heading_rad[av, mine, None],
        tracks.size_m[av, :2],
        tracks.position_m[row, theirs],
        tracks.heading_rad[row, theirs],
        tracks.size_m[row, :2],
    )
    shared &= ~clear(tracks.z_m[av, mine, None], tracks.z_m[row, theirs])
    if not shared.any():
        raise NotMeasurable("AV and opponent passed over no common place")
    return float(np.abs(mine[:, None] - theirs)[shared].min()) * rollout.dt_s


@metric("s", better="lower")
def pet(episode: Episode) -> float:
    """Least time between one of AV and opponent leaving a place and the other coming onto it, over
    all places that both boxes cover in the simulated steps; 0 in contact.

    Allen, Shin, Cooper (1978); here the least over all common places, so that following counts too.
    """
    return encroachment_s(episode.rollout)
