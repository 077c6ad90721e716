"""Reference drivers: their perception of an opponent, of a risk, and their braking.

``cc``: the competent and careful human driver of UN Regulation 157 (annex 4, appendix 3).
``fsm``: the fuzzy safety model of the same regulation (Mattas et al., Accident Analysis and
Prevention 174, 2022), written from its formulas. ``rss``: braking as Responsibility-Sensitive
Safety asks for (Shalev-Shwartz et al. 2017), with the parameters usual beside the other two.

The regulation's models are for lane keeping: a leader that brakes, a car that cuts in. Here every
opponent that enters the AV's corridor counts as a cut-in, and every opponent inside it as a leader,
whatever its direction: a crossing vehicle is a leader that stands, an oncoming one has a negative
speed, and its stopping distance adds to the AV's. No driver brakes for vehicles behind it, and none
knows right of way.

All lengths are in the frame of the AV's path: along it, and to the left of it. The corridor is the
area that the AV's box sweeps if it stays on its path.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final, NamedTuple, Protocol, Self

import numpy as np

from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.scene import Bools, Floats, Ints, frozen
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.slow import STANDING_MPS

JERK_MPS3: Final = 12.65
DELAY_S: Final = 0.75
_G_MPS2: Final = 9.81
_SPAN = 2
"""Steps between the positions of a velocity: noise of a centimetre stays below 0.1 m/s."""
_PARALLEL = np.cos(np.pi / 4)
_STILL_MPS = 0.05
"""Slower, one component of a motion is zero: a vehicle that drives along may drift across."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Approach:
    """N motions of the opponent over K steps, relative to the AV's path.

    Attributes:
        position_m, velocity_mps: (N, K, 2) of the box, heading_rad: (N, K), in the scene's frame.
        size_m, av_size_m: (2) length, width.
        rear_m, front_m: (N, K) ends of the box along the path.
        along_mps: (N, K) speed along the path, negative where it comes towards the AV.
        aside_mps: (N, K) speed towards the path's line; negative: away from it.
        clearance_m: (N, K) between the box and the corridor; negative inside.
        enters_s, leaves_s: (N, K) seconds until the box enters and leaves the corridor, at its
            velocity. A box that moves along the path (within 45 degrees) and has not yet passed its
            line is taken to stay: it changes lanes.
        parallel: (N, K) within 45 degrees of the path's direction.
        sideways_m: (N, K) distance that the box has come towards the path's line since it was
            farthest from it.
    """

    position_m: Floats
    velocity_mps: Floats
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
        path: AvPath,
        position_m: Floats,
        heading_rad: Floats,
        size_m: Floats,
        av_size_m: Floats,
        dt_s: float,
    ) -> Self:
        """Motions (N, K, 2), (N, K), K > 1, with a pose every ``dt_s``, the first being now."""
        position, heading = np.asarray(position_m, float), np.asarray(heading_rad, float)
        foot = path.project(position)
        turn = frames.difference(heading, foot.heading_rad)
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        half_along = (size_m[0] * cos + size_m[1] * sin) / 2
        reach = (size_m[0] * sin + size_m[1] * cos + av_size_m[1]) / 2
        velocity = _velocities(position, dt_s)
        left_mps = (velocity * frames.unit(foot.heading_rad + np.pi / 2)).sum(-1)
        parallel = np.cos(turn) > _PARALLEL
        far = np.abs(foot.left_m)
        enters, leaves = _crossing_times(foot.left_m, left_mps, reach, parallel)
        return cls(
            position_m=frozen(position),
            velocity_mps=frozen(velocity),
            heading_rad=frozen(heading),
            size_m=frozen(size_m),
            av_size_m=frozen(av_size_m),
            dt_s=dt_s,
            rear_m=foot.along_m - half_along,
            front_m=foot.along_m + half_along,
            along_mps=(velocity * frames.unit(foot.heading_rad)).sum(-1),
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

    def among(self, rows: Ints) -> "Approach":
        """These motions (M), in this order; a row may be named several times."""
        names = {one.name for one in fields(self)} - {"size_m", "av_size_m", "dt_s"}
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def seen(
        self, step: int | Ints, along_m: Floats, speed_mps: Floats, braking_mps2: Floats
    ) -> "Sight":
        """Perception of drivers at arc lengths, speeds and decelerations (D, N) at a step.

        At S steps: all (N, S), of one driver.
        """
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
    """Perception of N opponents at one step; for other names see `Approach`.

    Attributes:
        speed_mps, braking_mps2: (N) the AV's own speed, and its deceleration until now.
        gap_m: from the AV's front bumper to the box along the path, negative beside the AV.
        ahead: False if the middle of the box is behind the AV's rear bumper.
        reach_s: until the gap is closed, at the present speeds.
        meets_s: until the two overlap along and across the path; inf if they never do.
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
        """The perception of one of D drivers."""
        return self._replace(
            speed_mps=self.speed_mps[driver],
            braking_mps2=self.braking_mps2[driver],
            gap_m=self.gap_m[driver],
            ahead=self.ahead[driver],
            reach_s=self.reach_s[driver],
            meets_s=self.meets_s[driver],
        )


def _velocities(position_m: Floats, dt_s: float) -> Floats:
    """(N, K, 2) velocities from positions up to 0.2 s before, which are known by then."""
    now = np.maximum(np.arange(position_m.shape[1]), 1)
    before = np.maximum(now - _SPAN, 0)
    moved = position_m[:, now] - position_m[:, before]
    return moved / ((now - before) * dt_s)[:, None]


def _crossing_times(
    left_m: Floats, left_mps: Floats, reach_m: Floats, parallel: Bools
) -> tuple[Floats, Floats]:
    """Seconds until a box enters and leaves the band of ``reach_m`` around the path's line."""
    speed = np.abs(left_mps)
    still = speed < _STILL_MPS
    done = left_m * np.sign(left_mps)  # position across the line, which is at 0
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
    return np.where(moving, distance_m / np.where(moving, speed_mps, 1.0), np.inf)


class DriverModel(Protocol):
    """A model of a driver."""

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """(N) whether there is a risk now, and (N) the deceleration until the next step.

        Args:
            sight: what is seen at this step.
            since_s: (N) time since a risk was first perceived; 0 where none was yet.
        """
        ...


class CompetentCareful:
    """Perceives a car that is out of its wandering zone, with at most 2 s to the collision.

    The zone is 0.375 m; 0.4 s at 1.8 m/s sideways pass until the risk is evaluated. Then 0.75 s
    with the foot off the accelerator (0.4 m/s2), then full braking of 0.774 g, which is kept.
    """

    SIDEWAYS_M = 0.375 + 0.72
    HORIZON_S = 2.0
    RELEASE_MPS2 = 0.4
    HARDEST_MPS2 = 0.774 * _G_MPS2

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """Release, then the ramp, whatever follows."""
        noticed = (sight.sideways_m >= self.SIDEWAYS_M) | (sight.clearance_m <= 0)
        middle_s = since_s + sight.dt_s / 2
        ramp = np.minimum(JERK_MPS3 * (middle_s - DELAY_S), self.HARDEST_MPS2)
        return noticed & (sight.meets_s <= self.HORIZON_S), np.maximum(ramp, self.RELEASE_MPS2)


class FuzzySafety:
    """Brakes in proportion to how unsafe the gap is, before it becomes critical.

    The proactive measure (PFS) tells whether the AV could stop behind a leader that brakes at its
    maximum, the critical one (CFS) whether the two collide at their present motion. The braking
    follows the measures after the reaction time of 0.75 s, within the limit of jerk.
    """

    COMFORTABLE_MPS2 = 4.0
    HARDEST_MPS2 = 6.0
    LEADER_MPS2 = 7.0
    MARGIN_M = 2.0

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """Braking by the two measures."""
        # in the middle of the step, to which the braking applies: at its start it would be late
        closing = sight.speed_mps - sight.along_mps
        gap = np.maximum(sight.gap_m - closing * sight.dt_s / 2, 0.0)
        critical = critical_safety(gap, sight.speed_mps, sight.along_mps, -sight.braking_mps2)
        proactive = proactive_safety(gap, sight.speed_mps, sight.along_mps)
        more = self.HARDEST_MPS2 - self.COMFORTABLE_MPS2
        severe, mild = self.COMFORTABLE_MPS2 + more * critical, self.COMFORTABLE_MPS2 * proactive
        wanted = np.where(in_the_way(sight), np.where(critical > 0, severe, mild), 0.0)
        change = JERK_MPS3 * sight.dt_s
        ramped = np.clip(wanted, sight.braking_mps2 - change, sight.braking_mps2 + change)
        return wanted > 0, np.where(since_s >= DELAY_S, ramped, 0.0)


class ResponsibilitySensitive:
    """Brakes with 6 m/s2 from 0.75 s after the gap became too short, until it is no longer."""

    ACCEL_MPS2 = 3.0
    BRAKING_MPS2 = 6.0
    LEADER_MPS2 = 7.0
    LATERAL_MPS2 = 1.0
    LATERAL_MARGIN_M = 0.3

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """All or nothing. The lateral rule is for vehicles that drive along the path."""
        beside = sight.ahead & (sight.clearance_m < lateral_distance(sight.aside_mps))
        near = sight.gap_m < safe_distance(sight.speed_mps, sight.along_mps)
        danger = near & np.where(sight.parallel, beside, in_the_way(sight))
        return danger, np.where(danger & (since_s >= DELAY_S), self.BRAKING_MPS2, 0.0)


MODELS: Final[dict[str, DriverModel]] = {
    "cc": CompetentCareful(),
    "fsm": FuzzySafety(),
    "rss": ResponsibilitySensitive(),
}
"""The reference drivers by name."""


def in_the_way(sight: Sight) -> Bools:
    """(N) whether the opponent enters the corridor before the AV has passed, and is still there.

    The fuzzy model's test of a cut-in: the lateral headway is at most the longitudinal gross one
    (over the gap and both lengths) and 0.1 s.
    """
    passing = np.maximum(sight.gap_m, 0.0) + sight.lengths_m
    gross_s = passing / np.maximum(sight.speed_mps, 1e-3) + 0.1
    still_there = np.isinf(sight.leaves_s) | (sight.leaves_s > sight.reach_s)
    return sight.ahead & (sight.enters_s <= gross_s) & still_there


def proactive_safety(gap_m: Floats, speed_mps: Floats, leader_mps: Floats) -> Floats:
    """PFS of the fuzzy safety model: 0 safe, 1 unsafe, linear between the two distances."""
    model = FuzzySafety
    leader_stops = leader_mps * np.abs(leader_mps) / (2 * model.LEADER_MPS2)
    reacting = speed_mps * DELAY_S
    safe = reacting + speed_mps**2 / (2 * model.COMFORTABLE_MPS2) - leader_stops + model.MARGIN_M
    unsafe = reacting + speed_mps**2 / (2 * model.HARDEST_MPS2) - leader_stops
    share: Floats = (safe - (gap_m - model.MARGIN_M)) / (safe - unsafe)
    return np.clip(share, 0.0, 1.0)


def critical_safety(
    gap_m: Floats, speed_mps: Floats, leader_mps: Floats, accel_mps2: Floats
) -> Floats:
    """CFS of the fuzzy safety model: 0 safe, 1 unsafe; ``accel_mps2`` is the AV's, signed."""
    model = FuzzySafety
    accel = np.maximum(accel_mps2, -model.COMFORTABLE_MPS2)
    closing = speed_mps - leader_mps
    after = closing + accel * DELAY_S
    travel = (closing + after) / 2 * DELAY_S
    safe = travel + after**2 / (2 * model.COMFORTABLE_MPS2)
    unsafe = travel + after**2 / (2 * model.HARDEST_MPS2)
    share = np.clip((safe - gap_m) / np.maximum(safe - unsafe, 1e-9), 0.0, 1.0)
    soon = gap_m < closing**2 / (2 * np.maximum(np.abs(accel), 1e-9))
    return np.where(closing <= 0, 0.0, np.where(after < 0, soon, share))


def safe_distance(speed_mps: Floats, leader_mps: Floats) -> Floats:
    """RSS's longitudinal safe distance, behind a leader or (negative speed) towards an oncomer."""
    own = _response(speed_mps)
    ahead = own - leader_mps**2 / (2 * ResponsibilitySensitive.LEADER_MPS2)
    towards = own + _response(np.abs(leader_mps))
    return np.maximum(np.where(leader_mps < 0, towards, ahead), 0.0)


def lateral_distance(aside_mps: Floats) -> Floats:
    """RSS's lateral safe distance from a vehicle that moves towards the AV's path with this speed.

    Both may accelerate towards each other for 0.75 s before they correct it.
    """
    model = ResponsibilitySensitive
    gained, twice = model.LATERAL_MPS2 * DELAY_S, 2 * model.LATERAL_MPS2
    own = gained / 2 * DELAY_S + gained**2 / twice
    after = aside_mps + gained
    other = (aside_mps + after) / 2 * DELAY_S + np.maximum(after, 0.0) ** 2 / twice
    return model.LATERAL_MARGIN_M + np.maximum(own + other, 0.0)


def _response(speed_mps: Floats) -> Floats:
    """Stopping distance of a vehicle that accelerates during the response time, then brakes."""
    model = ResponsibilitySensitive
    after = speed_mps + model.ACCEL_MPS2 * DELAY_S
    return (speed_mps + after) / 2 * DELAY_S + after**2 / (2 * model.BRAKING_MPS2)


def drive(
    models: Sequence[DriverModel], approach: Approach, av_along_m: Floats, start: int | Ints = 0
) -> Floats:
    """(D, N, K) the AV's arc lengths if driver d takes over at step ``start``, one or (N).

    Until it perceives a risk, the driver drives as the AV did: ``av_along_m`` (K), K > 1, are the
    AV's arc lengths. From then on it brakes by its model, keeps its speed if the model does not
    brake, and is never faster than the AV was.
    """
    begin = np.broadcast_to(start, len(approach.heading_rad))
    speeds, first = np.maximum(np.gradient(av_along_m, approach.dt_s), 0.0), int(begin.min())
    moved = [av_along_m[first], *np.diff(av_along_m[first:])]
    alone = np.concatenate([av_along_m[:first], np.add.accumulate(moved)])
    aware_from = _aware_from(models, approach, alone, speeds, begin)
    along = np.tile(alone, (*aware_from.shape, 1))
    rows = np.flatnonzero((aware_from < approach.steps).any(axis=0))
    if len(rows):
        since = aware_from[:, rows]
        along[:, rows] = _braked(models, approach.among(rows), along[:, rows], speeds, since)
    return along


def _aware_from(
    models: Sequence[DriverModel],
    approach: Approach,
    along_m: Floats,
    speed_mps: Floats,
    start: Ints,
) -> Ints:
    """(D, N) first step from ``start`` (N) on at which a driver perceives a risk; K: none.

    Until then it drives as the AV did, so that all steps are looked at together. What it perceives
    at the last step has no consequence.
    """
    steps = np.arange(approach.steps - 1)
    shape = len(approach.heading_rad), len(steps)
    speed, none = np.broadcast_to(speed_mps[:-1], shape), np.zeros(shape)
    seen = approach.seen(steps, np.broadcast_to(along_m[:-1], shape), speed, none)
    found = np.full((len(models), shape[0]), approach.steps)
    for d, model in enumerate(models):
        risk = model.respond(seen, none)[0] & (steps >= start[:, None])
        some = risk.any(axis=1)
        found[d, some] = risk[some].argmax(axis=1)
    return found


def _braked(
    models: Sequence[DriverModel],
    approach: Approach,
    along_m: Floats,
    speeds_mps: Floats,
    aware_from: Ints,
) -> Floats:
    """(D, N, K) the arc lengths ``along_m`` where drivers brake once they are aware (D, N)."""
    along, dt, first = along_m.copy(), approach.dt_s, int(aware_from.min())
    speed = np.full(aware_from.shape, speeds_mps[first])
    braking, since, wanted = np.zeros((3, *aware_from.shape))
    for step in range(first, approach.steps - 1):
        seen = approach.seen(step, along[..., step], speed, braking)
        since = np.where(step > aware_from, since + dt, 0.0)
        for d, model in enumerate(models):
            wanted[d] = model.respond(seen.of(d), since[d])[1]
        aware = step >= aware_from
        braking = np.where(aware, wanted, 0.0)
        slower = np.minimum(np.maximum(speed - braking * dt, 0.0), speeds_mps[step + 1])
        moved = along[..., step] + (speed + slower) / 2 * dt
        along[..., step + 1] = np.where(aware, moved, along[..., step + 1])
        speed = np.where(aware, slower, speeds_mps[step + 1])
        if (aware & (speed == 0.0)).all():  # drivers that have stopped stay stopped
            along[..., step + 2 :] = along[..., step + 1 : step + 2]
            break
    return along


def overlaps(approach: Approach, centre_m: Floats, heading_rad: Floats, start: int = 0) -> Bools:
    """(N, K) overlap of AV boxes (N, K, 2), (N, K) and the opponent's from step ``start`` on.

    Either N may be 1.
    """
    return boxes.touching(
        centre_m,
        heading_rad,
        approach.av_size_m,
        approach.position_m[:, start:],
        approach.heading_rad[:, start:],
        approach.size_m,
    )


class DriverOutcomes(NamedTuple):
    """Outcomes of D drivers and N opponents, (D, N) each.

    ``avoided``: no contact. ``standing``: a contact, but the driver had stopped before, and the
    opponent hit the standing car.
    """

    avoided: Bools
    standing: Bools


def outcome(
    models: Sequence[DriverModel],
    path: AvPath,
    approach: Approach,
    av_along_m: Floats,
    start: int | Ints = 0,
) -> DriverOutcomes:
    """The outcome if each driver takes over at step ``start``; see `drive`."""
    along = drive(models, approach, av_along_m, start)
    hit = np.stack([overlaps(approach, *path.at(of_one)) for of_one in along])
    first = hit.argmax(axis=-1)[..., None]
    here, before = (np.take_along_axis(along, at, -1)[..., 0] for at in (first, first - 1))
    avoided: Bools = ~np.any(hit, axis=-1)
    stood = (here - before < STANDING_MPS * approach.dt_s) & (first[..., 0] > start)
    return DriverOutcomes(avoided, ~avoided & stood)
