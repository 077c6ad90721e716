"""Candidates of the opponent, their probabilities, and their collisions with the AV.

There are N1 candidates: marginal modes, paths to goals, the rest of the last plan.

Probabilities. A marginal mode j keeps the probability P_j of the predictor. For any other candidate
g only a density f_g = exp(log_density(Y_g)) is known. It is assumed to cover the same volume of the
space of futures as the modes on average: V, the P-weighted geometric mean of P_j / f_j:

    log w_j = log P_j        log w_g = min(log f_g + log V, max_j log P_j)        P = softmax(log w)

so that no other candidate is more likely than the most likely mode, and candidates that the
predictor considers unlikely remain so.

Comfort. The predictor is better at where vehicles go than at how hard they accelerate, and of the
candidates that meet the AV some drive harder than others; and it knows the road's edge only
roughly. With a_j(t) the acceleration along candidate j, s_j its seconds off the road, both in the
first 3 s, and the weight c (`settings.Settings.comfort`; 0 as published):

    P'_j  ~  P_j exp(-c (mean of a_j(t)^2 + 4 m2/s5 s_j))
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Protocol

import numpy as np

from deepmf_sumo.deepmf.opponent import softmax
from deepmf_sumo.deepmf.scoring import Pairs
from deepmf_sumo.deepmf.situation import Levels, Situation
from deepmf_sumo.deepmf.tracking import Tracked
from deepmf_sumo.judge.ladder import LAST_S, MOMENT_S, stood_or_crept
from deepmf_sumo.scene import DT_S, Bools, Floats, Forecast, Futures, Ints
from deepmf_sumo.scene.geometry import boxes, frames, impact, road
from deepmf_sumo.scene.geometry.slow import WAITING_MPS

NO_SECTOR: Final = -1
"""Sector of a pair that does not collide."""
_LEAST = 1e-12  # probabilities below are rounding errors
_COMFORT_STEPS = 30  # 3 s; most of what follows is planned again before it is driven
_ROAD_EVERY = 3
_SECOND_STEPS = 10
_MOMENT_STEPS = round(MOMENT_S / DT_S)
_LAST_STEPS = round(LAST_S / DT_S)
_LENGTHWISE_STEPS = round(2.0 / DT_S)
_OFF_ROAD = 4.0  # m2/s5: a second off the road weighs as a mean acceleration of 2 m/s2


@dataclass(frozen=True, slots=True, kw_only=True)
class References:
    """Paths to track: positions (K, F, 2), limits (K, 3), and origins (K)."""

    position_m: Floats
    limits: Floats
    origin: tuple[str, ...]

    @classmethod
    def of(cls, origin: str, position_m: Floats, limits: Floats) -> "References":
        """References of one origin."""
        return cls(position_m=position_m, limits=limits, origin=(origin,) * len(position_m))

    @classmethod
    def none(cls, steps: int) -> "References":
        """No references."""
        return cls(position_m=np.empty((0, steps, 2)), limits=np.empty((0, 3)), origin=())

    @classmethod
    def joined(cls, parts: Sequence["References"]) -> "References":
        """All parts, one after the other."""
        return cls(
            position_m=np.concatenate([part.position_m for part in parts]),
            limits=np.concatenate([part.limits for part in parts]),
            origin=tuple(origin for part in parts for origin in part.origin),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Drivable candidates, likeliest first: forecast, speeds (N1, F), bent (N1), origins (N1)."""

    forecast: Forecast
    speed_mps: Floats
    bent_m: Floats
    origin: tuple[str, ...]

    def take(self, rows: Ints) -> "Candidates":
        """Only these candidates (K), with probabilities that sum to 1."""
        futures, probability = self.forecast.futures, self.forecast.probability[rows]
        return Candidates(
            forecast=replace(
                self.forecast,
                futures=replace(
                    futures,
                    position_m=futures.position_m[rows],
                    heading_rad=futures.heading_rad[rows],
                ),
                probability=probability / probability.sum(),
            ),
            speed_mps=self.speed_mps[rows],
            bent_m=self.bent_m[rows],
            origin=tuple(self.origin[row] for row in rows),
        )


def tail(situation: Situation, steps: int) -> list[References]:
    """The rest of the last plan, continued straight at its last speed; empty if there is none."""
    plan, view = situation.last, situation.view
    if plan is None:
        return []
    first = view.step + 1 - plan.first_step
    left = plan.position_m[first:]
    if first < 0 or len(left) < 2:
        return []
    beyond = np.arange(1, steps - len(left) + 1)[:, None] * view.dt_s * plan.speed_mps[-1]
    more = left[-1] + beyond * frames.unit(plan.heading_rad[-1])
    rest = np.concatenate([left, more])[None, :steps]
    return [References.of("tail", rest, situation.limits.rows(1))]


class Density(Protocol):
    """A prediction of a vehicle or of a person, as far as candidates are weighed by it."""

    def log_density(self, position_m: Floats) -> Floats:
        """(K) log density of trajectories (K, 80, 2)."""
        ...


def weights(modes: Forecast, others_m: Floats, prediction: Density) -> Floats:
    """(N1) joint probabilities of the modes and of the candidates (K, F, 2) after them."""
    if len(others_m) == 0:
        return modes.probability
    log_density = prediction.log_density(np.concatenate([modes.futures.position_m, others_m]))
    mass = np.log(np.maximum(modes.probability, _LEAST))
    own, other = log_density[: len(mass)], log_density[len(mass) :]
    volume = float((modes.probability * (mass - own)).sum() / modes.probability.sum())
    return softmax(np.concatenate([mass, np.minimum(other + volume, mass.max())]))


def comfortable(
    situation: Situation, probability: Floats, tracked: Tracked, weight: float
) -> Floats:
    """(N1) probabilities that fall with acceleration and time off the road, see above.

    ``weight`` is in s4/m2.
    """
    speed = tracked.speed_mps[:, :_COMFORT_STEPS]
    speed = np.column_stack([np.full(len(speed), situation.start.speed_mps), speed])
    square = ((np.diff(speed, axis=1) / situation.view.dt_s) ** 2).mean(axis=1)
    steps = np.arange(0, _COMFORT_STEPS, _ROAD_EVERY)
    off_s = off_road(situation, tracked.position_m[:, steps]).sum(axis=1) * _ROAD_EVERY * DT_S
    uncomfortable = square + _OFF_ROAD * off_s
    return softmax(np.log(np.maximum(probability, _LEAST)) - weight * uncomfortable)


def off_road(situation: Situation, position_m: Floats) -> Bools:
    """(N, S) whether positions (N, S, 2) of the opponent are off the road, after it was on it.

    A vehicle that is off the road now may come onto it. A pedestrian never is off it: where people
    can be is judged by `off_lane_paths`.
    """
    if situation.on_foot:
        return np.zeros(position_m.shape[:2], bool)
    levels, net = situation.levels, situation.view.road
    z_m = None if levels is None else levels.opponent_z_m(position_m).reshape(-1)
    rides = situation.kind == "cyclist"
    inside = road.on_road(net, position_m.reshape(-1, 2), z_m, bicycles=rides)
    inside = inside.reshape(position_m.shape[:2])
    now_z_m = None if levels is None else levels.opponent[2:]
    start = road.on_road(net, situation.start.position_m[None], now_z_m, bicycles=rides)
    return ~inside & (start | np.maximum.accumulate(inside, axis=1))


def leaves_road(situation: Situation, own: Candidates, until: Floats) -> Bools:
    """(N1) whether a candidate is `off_road` at a step up to ``until`` (N1) within the horizon.

    Of a pedestrian: whether it is beside the road at this very step, where it meets the AV.
    """
    if situation.on_foot:
        return _met_beside(situation, own, until)
    steps = np.arange(0, situation.horizon, _ROAD_EVERY)
    off = off_road(situation, own.forecast.futures.position_m[:, steps])
    return np.asarray((off & (steps <= until[:, None])).any(axis=1))


def _met_beside(situation: Situation, own: Candidates, until: Floats) -> Bools:
    """(N1) whether a candidate is on no lane, cycle lanes included, at step ``until`` (N1)."""
    rows = np.flatnonzero(until < situation.horizon)
    beside = np.zeros(len(until), bool)
    if len(rows):
        position_m = own.forecast.futures.position_m[rows, until[rows].astype(int)]
        levels = situation.levels
        z_m = None if levels is None else levels.opponent_z_m(position_m[:, None])[:, 0]
        beside[rows] = ~road.on_road(situation.view.road, position_m, z_m, bicycles=True)
    return beside


def against_traffic(
    situation: Situation, own: Candidates, until: Floats, since: int | None = None
) -> Bools:
    """(N1) whether a candidate drives against the traffic for more than 1 s up to ``until`` (N1).

    What the opponent drove in the last second counts, too, from the step after ``since`` on (None:
    all of it): before the first plan something else drove it. That alone excludes no
    candidate that is on its own side from the next step on. Pedestrians
    have no side, but cross: see `along_road`.
    """
    if situation.on_foot:
        return along_road(situation, own, until)
    view, levels = situation.view, situation.levels
    row = view.history.row(situation.opponent_id)
    known = np.flatnonzero(view.history.valid[row])[-_SECOND_STEPS:]
    step = view.step + 1 - view.history.steps + known
    past = known if since is None else known[step > since]
    before = road.against_traffic(
        view.road,
        view.history.position_m[row, past],
        view.history.heading_rad[row, past],
        None if levels is None else view.history.z_m[row, past],
    )
    more = np.zeros(len(until), int)
    for every in (_ROAD_EVERY, 1):  # few candidates are ever on the wrong side
        rows = np.arange(len(until)) if every > 1 else np.flatnonzero(more)
        steps = np.arange(0, situation.horizon, every)
        wrong = _wrong_side(situation, own, rows, steps)
        more[rows] = (wrong & (steps <= until[rows, None])).sum(axis=1)
    return np.asarray((more > 0) & (before.sum() + more > _MOMENT_STEPS))


def along_road(situation: Situation, own: Candidates, until: Floats) -> Bools:
    """(N1) whether a pedestrian walks along a lane for more than 2 s up to ``until`` (N1).

    Who crosses a lane at an angle is over it by then; who walks along it, through the traffic,
    meets an AV anywhere.
    """
    steps = np.arange(0, situation.horizon, _ROAD_EVERY)
    futures = own.forecast.futures
    position_m = futures.position_m[:, steps]
    z_m = None if situation.levels is None else situation.levels.opponent_z_m(futures.position_m)
    along = road.along_lanes(
        situation.view.road,
        position_m.reshape(-1, 2),
        futures.heading_rad[:, steps].reshape(-1),
        None if z_m is None else z_m[:, steps].reshape(-1),
    ).reshape(position_m.shape[:2])
    along &= (own.speed_mps[:, steps] > WAITING_MPS) & (steps <= until[:, None])
    return np.asarray(along.sum(axis=1) * _ROAD_EVERY > _LENGTHWISE_STEPS)


def _wrong_side(situation: Situation, own: Candidates, rows: Ints, steps: Ints) -> Bools:
    """(K, S) whether candidates (K) are against the traffic at steps (S)."""
    position_m = own.forecast.futures.position_m[rows][:, steps]
    z_m = None if situation.levels is None else situation.levels.opponent_z_m(position_m)
    found = road.against_traffic(
        situation.view.road,
        position_m.reshape(-1, 2),
        own.forecast.futures.heading_rad[rows][:, steps].reshape(-1),
        None if z_m is None else z_m.reshape(-1),
    )
    return found.reshape(position_m.shape[:2])


def ranked(
    references: References, tracked: Tracked, probability: Floats, modes: Forecast
) -> Candidates:
    """The tracked references as candidates, likeliest first."""
    order = np.argsort(-probability, kind="stable")
    return Candidates(
        forecast=Forecast(
            futures=Futures(
                agent_id=modes.futures.agent_id,
                position_m=tracked.position_m[order],
                heading_rad=tracked.heading_rad[order],
            ),
            probability=probability[order],
            temperature=modes.temperature,
        ),
        speed_mps=tracked.speed_mps[order],
        bent_m=tracked.bent_m[order],
        origin=tuple(references.origin[row] for row in order),
    )


def collisions(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    horizon: int,
    levels: Levels | None = None,
) -> tuple[Bools, Floats]:
    """(N1, N2) overlap of the oriented boxes at the same time, and (N1, N2) its first step.

    Every step (10 Hz) of the first ``horizon`` is tested; without overlap the step is F, the length
    of the futures. Sizes are (2): length, width. Poses whose centres are farther apart than the
    half diagonals reach are not tested: they cannot overlap. ``levels``: heights, if some of them
    may pass over each other.
    """
    own, other = candidates.position_m, _stacked([each.futures.position_m for each in reactions])
    other_heading = _stacked([each.futures.heading_rad for each in reactions])
    # Each axis by itself: numpy is slow at sums over an axis of length two.
    x, y = (own[:, None, :horizon, axis] - other[:, :, :horizon, axis] for axis in range(2))
    reach = (np.hypot(*opponent_size_m) + np.hypot(*av_size_m)) / 2
    near = np.nonzero(x * x + y * y < reach**2)
    row, mode, step = near
    hit = boxes.overlap(
        own[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
        other[near],
        other_heading[near],
        av_size_m,
    )
    if levels is not None:
        hit[hit] = ~levels.clear(own, other, (row[hit], mode[hit], step[hit]))
    steps = own.shape[1]
    first = np.full(other.shape[:2], float(steps))
    np.minimum.at(first, (row[hit], mode[hit]), step[hit].astype(float))
    return first < steps, first


def _stacked(arrays: Sequence[Floats]) -> Floats:
    """(N, ...) without a copy if all arrays are the same."""
    if all(each is arrays[0] for each in arrays):
        return np.broadcast_to(arrays[0], (len(arrays), *arrays[0].shape))
    return np.stack(arrays)


def impact_sectors(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Ints:
    """(N1, N2) sector of the AV, 0..7, in which each pair first overlaps, or `NO_SECTOR`.

    Sectors are those of contacts in the simulation (`scene.geometry.impact`).
    """
    found = np.full(collision_step.shape, NO_SECTOR)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    step = collision_step[row, mode].astype(int)
    other = _stacked([reaction.futures.position_m for reaction in reactions])
    other_heading = _stacked([reaction.futures.heading_rad for reaction in reactions])
    found[row, mode] = impact.sectors(
        other[row, mode, step],
        other_heading[row, mode, step],
        av_size_m,
        candidates.position_m[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
    )
    return found


class _Before(NamedTuple):
    """K pairs that collide, a step before they first overlap; all (K), in the AV's frame.

    Attributes:
        row, mode: of the pair. ahead_m: of the candidate's centre. along_m, across_m: gaps of the
            boxes in both directions. turn_rad: of the candidate's heading against the AV's.
    """

    row: Ints
    mode: Ints
    ahead_m: Floats
    along_m: Floats
    across_m: Floats
    turn_rad: Floats

    @classmethod
    def of(
        cls,
        candidates: Futures,
        reactions: Sequence[Forecast],
        opponent_size_m: Floats,
        av_size_m: Floats,
        collision_step: Floats,
    ) -> "_Before":
        """Of (N1, N2) first steps of overlap."""
        row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
        step = np.maximum(collision_step[row, mode].astype(int) - 1, 0)
        heading = _stacked([each.futures.heading_rad for each in reactions])[row, mode, step]
        apart = (
            candidates.position_m[row, step]
            - (_stacked([each.futures.position_m for each in reactions])[row, mode, step])
        )
        turn = frames.difference(candidates.heading_rad[row, step], heading)
        forward = frames.unit(heading)
        ahead = (apart * forward).sum(axis=1)
        left = forward[:, 0] * apart[:, 1] - forward[:, 1] * apart[:, 0]
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        (length, width), (av_length, av_width) = opponent_size_m, av_size_m
        along = np.abs(ahead) - (av_length + length * cos + width * sin) / 2
        across = np.abs(left) - (av_width + length * sin + width * cos) / 2
        return cls(row, mode, ahead, along, across, turn)


def rear_ends(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Bools:
    """(N1, N2) whether the candidate hits the AV's rear end from behind, in the same direction.

    A step before they first overlap the candidate is farther behind the AV than beside it, as in
    the metric `accident_type`, and headings differ by less than 45 degrees.
    """
    found = np.zeros(collision_step.shape, bool)
    at = _Before.of(candidates, reactions, opponent_size_m, av_size_m, collision_step)
    behind = (at.ahead_m < 0) & (at.along_m >= at.across_m)
    found[at.row, at.mode] = behind & (np.abs(at.turn_rad) < np.pi / 4)
    return found


def off_front(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Bools:
    """(N1, N2) whether the candidate meets the AV elsewhere than at its front.

    A step before they first overlap it is not ahead of the front bumper.
    """
    found = np.zeros(collision_step.shape, bool)
    at = _Before.of(candidates, reactions, opponent_size_m, av_size_m, collision_step)
    found[at.row, at.mode] = (at.ahead_m < 0) | (at.along_m < 0)
    return found


def av_stands(situation: Situation, reactions: Sequence[Forecast], collision_step: Floats) -> Bools:
    """(N1, N2) whether the AV, where it is met, stands or creeps in its last second (`ladder`).

    What it has driven before now counts, too.
    """
    tracks, found = situation.view.history, np.zeros(collision_step.shape, bool)
    row, mode = np.nonzero(collision_step < reactions[0].futures.position_m.shape[1])
    av = tracks.row(situation.view.av_id)
    past = np.where(tracks.valid[av], tracks.speed_mps[av], tracks.speed_mps[av, -1])
    ahead = _stacked([each.futures.position_m for each in reactions])[row, mode]
    begin = np.broadcast_to(tracks.position_m[av, -1], (len(row), 1, 2))
    moved = np.diff(np.concatenate([begin, ahead], axis=1), axis=1)
    driven = np.hypot(moved[..., 0], moved[..., 1]) / DT_S
    speed = np.concatenate([np.broadcast_to(past, (len(row), len(past))), driven], axis=1)
    last = collision_step[row, mode].astype(int)[:, None] + len(past) - 1 - np.arange(_LAST_STEPS)
    found[row, mode] = stood_or_crept(np.take_along_axis(speed, np.maximum(last, 0), axis=1))
    return found


def delta_v(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Floats:
    """(N1, N2) change of the AV's velocity in m/s (`Contact.delta_v_mps`); 0 without contact."""
    change = np.zeros(collision_step.shape)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    after = np.maximum(collision_step[row, mode].astype(int), 1)
    other = _stacked([reaction.futures.position_m for reaction in reactions])
    apart = other[row, mode, after] - candidates.position_m[row, after]
    before = other[row, mode, after - 1] - candidates.position_m[row, after - 1]
    relative = np.hypot(*(apart - before).T) / DT_S
    areas = (float(size.prod()) for size in (av_size_m, opponent_size_m))
    change[row, mode] = impact.delta_v(relative, *areas)
    return change


def pairs(
    situation: Situation,
    own: Candidates,
    reactions: Sequence[Forecast],
    *,
    sectors: bool = False,
    severity: bool = False,
) -> Pairs:
    """Collisions of N1 candidates and the AV's reactions to each of them within the horizon.

    ``sectors`` and ``severity``, which take time, are computed on request.
    """
    futures, sizes = own.forecast.futures, (situation.size_m, situation.av_size_m)
    collides, step = collisions(futures, reactions, *sizes, situation.horizon, situation.levels)
    return Pairs(
        probability=own.forecast.probability,
        reaction_probability=np.stack([reaction.probability for reaction in reactions]),
        collides=collides,
        collision_step=step,
        sector=impact_sectors(futures, reactions, *sizes, step) if sectors else None,
        severity=delta_v(futures, reactions, *sizes, step) if severity else None,
    )


def shortlisted(
    situation: Situation,
    own: Candidates,
    count: int,
    without: frozenset[str] = frozenset(),
    since: int | None = None,
) -> Candidates:
    """At most ``count``: those most likely to meet the unattacked AV, then the likeliest.

    ``without``: constraints by which some meetings do not count: ``no_rear_end``, ``on_road``,
    ``with_traffic``; ``since``: as of `against_traffic`.
    """
    alone = situation.unattacked
    if alone is None or len(own.origin) <= count:
        return own
    alike = [alone] * len(own.origin)
    met = pairs(situation, own, alike)
    counted = met.collides
    if "no_rear_end" in without:
        sizes = situation.size_m, situation.av_size_m
        ends = off_front if situation.person else rear_ends
        counted = counted & ~ends(own.forecast.futures, alike, *sizes, met.collision_step)
        if situation.person:
            counted &= ~av_stands(situation, alike, met.collision_step)
    if "on_road" in without:
        counted = counted & ~leaves_road(situation, own, met.collision_step.min(axis=1))[:, None]
    if "with_traffic" in without:
        wrong = against_traffic(situation, own, met.collision_step.min(axis=1), since)
        counted = counted & ~wrong[:, None]
    mass = counted @ alone.probability
    return own.take(np.sort(np.argsort(-mass, kind="stable")[:count]))
