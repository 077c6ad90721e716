"""Reference paths of candidates: to predicted positions of the AV, and to a side of the AV.

**To a predicted position of the AV.** Marginal modes follow the road; few of them cross the AV's
path at the right moment. A goal is a predicted position of the AV at some time, or a point close to
it. The opponent reaches it along the nearest path of its own modes, with a smooth lateral shift and
the constant acceleration that arrives in time (or brakes to a stop there, and waits).

**To a side of the AV.** An aim is a pose of the opponent beside a predicted pose of the AV, such
that the two boxes touch in the wanted sector. As for goals, the opponent follows the nearest of its
own paths with a smooth lateral shift; but the shift may start late, and two accelerations, each for
half of the time, let it arrive at a speed that differs from the AV's: faster from behind, slower
from ahead. Of all aims within the limits, those that first touch the predicted AV in the wanted
sector are kept.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from deepmf_sumo.deepmf.candidates import References, collisions, impact_sectors
from deepmf_sumo.deepmf.off_lane_paths import off_lane_paths
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.tracking import Start, joined
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Bools, Floats, Forecast, Futures, Ints
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.slow import DIRECTION_MPS
from deepmf_sumo.scene.road_users import MotionLimits

_PATHS = 12
_SAME_PATH_M = 0.7  # a mode that ends this close to the path of another one is on that path
_BEYOND_M = 60.0
_COARSE = 8  # every eighth point (0.8 s) is enough to find the nearest point of a path


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnPath:
    """One of the opponent's predicted paths, continued straight for 60 m.

    Attributes:
        points_m: (P, 2). predicted_m: length without the continuation.
        coarse_m: (Q, 2) every eighth of the points; coarse_along_m: (Q) where they are on the path.
        sharpest: (Q) largest curvature up to them.
    """

    points_m: Floats
    predicted_m: float
    coarse_m: Floats
    coarse_along_m: Floats
    sharpest: Floats

    @classmethod
    def of(cls, points_m: Floats, heading_rad: float) -> "OwnPath":
        """A path from points (P, 2), P >= 1, continued in a direction."""
        predicted = float(polylines.arc_lengths(points_m)[-1])
        points = np.concatenate([points_m, [points_m[-1] + _BEYOND_M * frames.unit(heading_rad)]])
        rows = np.unique([*range(0, len(points), _COARSE), len(points) - 2, len(points) - 1])
        coarse, along = points[rows], polylines.arc_lengths(points)[rows]
        ahead = np.diff(coarse, axis=0)
        turn = np.abs(np.diff(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))))
        # Between short steps a turn is noise of a nearly standing vehicle: spread it over 4 m.
        curvature = turn / np.maximum((along[2:] - along[:-2]) / 2, 4.0)
        return cls(
            points_m=points,
            predicted_m=predicted,
            coarse_m=coarse,
            coarse_along_m=along,
            sharpest=np.maximum.accumulate(np.concatenate([[0.0], curvature, [0.0]])),
        )

    def project(self, query_m: Floats) -> tuple[Floats, polylines.Projection]:
        """Arc lengths (G) of the points nearest to queries (G, 2), and their projection."""
        foot = polylines.project(self.coarse_m, query_m)
        coarse_length = polylines.arc_lengths(self.coarse_m)
        return np.interp(foot.along_m, coarse_length, self.coarse_along_m), foot

    def curvature(self, along_m: Floats) -> Floats:
        """Largest curvature up to arc lengths (...)."""
        vertex = np.searchsorted(self.coarse_along_m, along_m, side="right") - 1
        return self.sharpest[np.maximum(vertex, 0)]


def own_paths(own: Forecast, start: Start) -> list[OwnPath]:
    """The distinct paths of the modes, likeliest first; of modes on one path the longest."""
    points = [
        _moving(np.concatenate([start.position_m[None], mode]))
        for mode in joined(own.futures.position_m, start)
    ]
    lengths = np.array([polylines.arc_lengths(path)[-1] for path in points])
    ends = np.stack([path[-1] for path in points])
    kept: list[int] = []
    covered = np.zeros(len(points), dtype=bool)
    for mode in np.argsort(-lengths, kind="stable"):
        if covered[mode] or (len(points[mode]) < 2 and kept):
            continue
        kept.append(int(mode))
        if len(points[mode]) > 1:
            covered |= polylines.project(_thinned(points[mode]), ends).distance_m < _SAME_PATH_M
    paths = []
    for mode in sorted(kept)[:_PATHS]:
        heading = own.futures.heading_rad[mode, -1] if lengths[mode] > 1.0 else start.heading_rad
        paths.append(OwnPath.of(points[mode], float(heading)))
    return paths


def _thinned(points: Floats) -> Floats:
    """Every fourth point and the last."""
    return points[np.unique([*range(0, len(points), _COARSE // 2), len(points) - 1])]


def _moving(points: Floats) -> Floats:
    """Points without those that repeat their predecessor."""
    moved = np.hypot(*np.diff(points, axis=0).T) > 0.2
    return points[np.concatenate([[True], moved])]


_FIRST_GOAL_STEP, _GOAL_EVERY_STEPS = 7, 6  # goals at 0.8, 1.4, 2.0 ... s
_BEYOND_COST = 0.2  # a metre past the end of a predicted path, in metres of lateral shift
_WIDEST_GOAL_M = 8.0  # two lanes: beyond that the path no longer follows the road
_STEEPEST_GOAL = 0.3  # lateral shift per metre driven: a mean angle of 17 degrees
_LENGTH_SHARE, _WIDTH_SHARE = 0.35, 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class _Targets:
    """Targets in coordinates of the opponent's own paths; arrays (G), also of subclasses."""

    path: Ints
    along_m: Floats
    left_m: Floats
    step: Ints
    accel: Floats

    def take(self, rows: Ints) -> Self:
        """Only these targets."""
        return replace(self, **{one.name: getattr(self, one.name)[rows] for one in fields(self)})

    def references(self, paths: list[OwnPath], driven_m: Floats, share: Floats) -> Floats:
        """(G, F, 2) positions at arc lengths (G, F), with ``share`` (G, F) of the lateral shift."""
        shift = self.left_m[:, None] * share**3 * (10 - 15 * share + 6 * share**2)
        reference = np.empty((*driven_m.shape, 2))
        for path in np.unique(self.path):
            rows = self.path == path
            where, heading = polylines.points_at(paths[path].points_m, driven_m[rows])
            reference[rows] = where + shift[rows][..., None] * frames.unit(heading + np.pi / 2)
        return reference


@dataclass(frozen=True, slots=True, kw_only=True)
class _Goals(_Targets):
    """Goals, which one acceleration reaches."""

    curvature: Floats
    lateral: Floats
    score: Floats


def goal_paths(situation: Situation, paths: list[OwnPath], count: int) -> References:
    """At most ``count`` references to goals around the unattacked AV, the most plausible first.

    ``paths`` are the opponent's own. Goals that need more than the limits are dropped; those within
    the mild limits are tracked with these.
    """
    start, limits, av = situation.start, situation.limits, situation.unattacked
    when = np.arange(_FIRST_GOAL_STEP, min(situation.horizon, FUTURE_STEPS), _GOAL_EVERY_STEPS)
    if av is None or count == 0 or len(when) == 0:
        return References.none(FUTURE_STEPS)
    every = _goals(paths, av, when, situation.av_size_m)
    goals = _chosen(_reachable_goals(every, start, limits), count)
    if len(goals.path) == 0:
        return References.none(FUTURE_STEPS)
    mild = limits.mild()
    calm = (
        (goals.accel <= mild.accel) & (-goals.accel <= mild.brake) & (goals.lateral <= mild.lateral)
    )
    rows = np.where(calm[:, None], mild.rows(len(calm)), limits.rows(len(calm)))
    return References.of("goal", _goal_references(goals, paths, start, FUTURE_STEPS), rows)


def goals(situation: Situation, paths: list[OwnPath], count: int) -> list[References]:
    """At most ``count`` references to where the AV will be.

    Those of a pedestrian are off the lanes as far as there are any, half of a cyclist's.
    """
    if not situation.person:
        return [goal_paths(situation, paths, count)]
    free = off_lane_paths(situation, count if situation.on_foot else (count + 1) // 2)
    return [free, goal_paths(situation, paths, count - len(free.origin))]


def _goals(paths: list[OwnPath], av: Forecast, when: Ints, av_size_m: Floats) -> _Goals:
    """All goals on their nearest own path, not timed yet."""
    position = av.futures.position_m[:, when].reshape(-1, 2)
    heading = av.futures.heading_rad[:, when].reshape(-1)
    chance = np.repeat(np.log(np.maximum(av.probability, 1e-6)), len(when))
    projected = [path.project(position) for path in paths]
    along = np.stack([lengths for lengths, _ in projected])
    ends = np.array([path.predicted_m for path in paths])
    left, course, distance = (
        np.stack([getattr(foot, name) for _, foot in projected])
        for name in ("left_m", "heading_rad", "distance_m")
    )
    cost = distance + _BEYOND_COST * np.maximum(along - ends[:, None], 0.0)
    path = cost.argmin(axis=0)
    pick = path, np.arange(len(path))
    curvature = np.stack([path.curvature(row) for path, row in zip(paths, along, strict=True)])
    # Goals before the start or past the end of a path cannot be reached by a lateral shift.
    sideways = np.abs(np.abs(left[pick]) - distance[pick]) < 0.1
    length, width = _LENGTH_SHARE * av_size_m[0], _WIDTH_SHARE * av_size_m[1]
    spots = np.array([[0, 0], [length, 0], [-length, 0], [0, width], [0, -width]], dtype=float)
    turn = heading - course[pick]
    cos, sin = np.cos(turn)[None], np.sin(turn)[None]
    shift_along = spots[:, :1] * cos - spots[:, 1:] * sin
    shift_left = spots[:, :1] * sin + spots[:, 1:] * cos
    # Points off the centre come after all centres: each costs as much as a mode e^10 less likely.
    # Likelihoods count by half, so that goals near unlikely modes are not crowded out.
    score = chance[None] / 2 - 5.0 * (np.arange(len(spots)) > 0)[:, None]
    every = np.ones(len(spots), dtype=np.int64)[:, None]
    return _Goals(
        path=(every * path).ravel(),
        along_m=(along[pick] + shift_along).ravel(),
        left_m=(left[pick] + shift_left).ravel(),
        step=(every * np.tile(when, len(av.probability))).ravel(),
        accel=np.zeros(score.size),
        curvature=(every * curvature[pick]).ravel(),
        lateral=np.zeros(score.size),
        score=np.where(sideways, score, -np.inf).ravel(),
    )


def _reachable_goals(goals: _Goals, start: Start, limits: MotionLimits) -> _Goals:
    """Goals that a constant acceleration reaches within the limits, scored by comfort."""
    seconds = (goals.step + 1) * DT_S
    along = np.maximum(goals.along_m, 1e-3)
    accel = 2 * (along - start.speed_mps * seconds) / seconds**2
    stops = start.speed_mps + accel * seconds < 0
    accel = np.where(stops, -(start.speed_mps**2) / (2 * along), accel)
    busy = np.where(stops, np.minimum(seconds, 2 * along / max(start.speed_mps, 0.1)), seconds)
    fastest = np.maximum(start.speed_mps, along / busy)
    lateral = _SHIFT_PEAK * np.abs(goals.left_m) / busy**2 + goals.curvature * fastest**2
    possible = (
        (goals.score > -np.inf)
        & (goals.along_m > 0.5)
        & (accel <= limits.accel)
        & (-accel <= limits.brake)
        & (lateral <= limits.lateral)
        & (np.abs(goals.left_m) <= np.minimum(_WIDEST_GOAL_M, _STEEPEST_GOAL * along + 0.2))
    )
    effort = np.abs(accel) / 3 + lateral / 3 + np.abs(goals.left_m) / 4
    timed = replace(goals, along_m=along, accel=accel, lateral=lateral, score=goals.score - effort)
    return timed.take(np.flatnonzero(possible))


def _chosen(goals: _Goals, count: int) -> _Goals:
    """The best ``count`` goals; of goals within a metre at the same time only the best."""
    order = np.argsort(-goals.score, kind="stable")
    cells = np.stack(
        [goals.path, np.rint(goals.along_m), np.rint(2 * goals.left_m), goals.step], -1
    )
    _, first = np.unique(cells[order], axis=0, return_index=True)
    return goals.take(order[np.sort(first)[:count]])


def _goal_references(goals: _Goals, paths: list[OwnPath], start: Start, steps: int) -> Floats:
    """(K, F, 2) positions of the opponent on the path to each goal and past it."""
    accel, along = goals.accel[:, None], goals.along_m[:, None]
    arrival = (goals.step[:, None] + 1) * DT_S
    standing = start.speed_mps / np.maximum(-accel, 1e-6)
    arrival = np.where(accel < 0, np.minimum(arrival, standing), arrival)
    seconds = (np.arange(steps) + 1) * DT_S
    busy = np.minimum(seconds, arrival)
    final = start.speed_mps + accel * arrival
    driven = start.speed_mps * busy + accel * busy**2 / 2 + final * (seconds - busy)
    return goals.references(paths, driven, np.clip(driven / along, 0.0, 1.0))


_FIRST_STEP, _EVERY_STEPS = 4, 5  # aims at 0.5, 1.0, 1.5 ... s
_ASIDE_RAD = (0.0, 0.2, -0.2)  # contact points beside the middle of the sector
_DEEP_M = (0.15, 1.0)  # boxes that merely touch do not overlap yet
_FASTER_MPS = (-3.0, 0.0, 3.0)  # arrival speeds relative to the AV's
_SHIFT_FROM = (0.0, 0.5)  # share of the path before the lateral shift
_SHIFT_PEAK = 5.77  # largest second derivative of the quintic step 10u^3 - 15u^4 + 6u^5
_WIDEST_M, _STEEPEST = 8.0, 0.35
_TRIED = 400  # aims at most are tested against the prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class _Aims(_Targets):
    """Aims, which two accelerations reach; the shift starts after a share of the path."""

    then_accel: Floats
    shift_from: Floats
    effort: Floats


def aimed_paths(situation: Situation, paths: list[OwnPath], sector: int, count: int) -> References:
    """At most ``count`` references that first touch the unattacked AV in ``sector``, best first.

    ``paths`` are the opponent's own. Best are those that touch most of the AV's predicted mass,
    then those with the least effort.
    """
    start, limits, av = situation.start, situation.limits, situation.unattacked
    when = np.arange(_FIRST_STEP, min(situation.horizon, FUTURE_STEPS), _EVERY_STEPS)
    if av is None or count == 0 or len(when) == 0:
        return References.none(FUTURE_STEPS)
    sizes_m = situation.size_m, situation.av_size_m
    aims = _reachable(_aims(paths, av, when, sizes_m, sector, start), paths, start, limits)
    if len(aims.path) == 0:
        return References.none(FUTURE_STEPS)
    reference = _references(aims, paths, start, FUTURE_STEPS)
    mass = _wanted_mass(situation, av, reference, sector)
    order = np.lexsort((aims.effort, -np.round(mass, 1)))
    best = order[mass[order] > 0][:count]
    return References.of("aim", reference[best], limits.rows(len(best)))


def _aims(
    paths: list[OwnPath],
    av: Forecast,
    when: Ints,
    sizes_m: tuple[Floats, Floats],
    sector: int,
    start: Start,
) -> _Aims:
    """All aims on their nearest own path, with every arrival speed and both kinds of shift."""
    position = av.futures.position_m[:, when].reshape(-1, 2)
    heading = av.futures.heading_rad[:, when].reshape(-1)
    before = av.futures.position_m[:, when - 1].reshape(-1, 2)
    feet = [path.project(position)[1] for path in paths]
    path = np.stack([foot.distance_m for foot in feet]).argmin(axis=0)
    course = np.stack([foot.heading_rad for foot in feet])[path, np.arange(len(path))]
    offset = _contact_offsets(frames.wrap(course - heading), sizes_m, sector)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x = offset[..., 0] * cos - offset[..., 1] * sin
    y = offset[..., 0] * sin + offset[..., 1] * cos
    aim = (position[:, None] + np.stack([x, y], axis=-1)).reshape(-1, 2)
    of_pose = np.repeat(np.arange(len(position)), offset.shape[1])
    along, left, reached = _projected(paths, path[of_pose], aim)
    rows = np.flatnonzero(reached & (along > 0.5))
    pose = of_pose[rows]
    av_speed = ((position - before) * frames.unit(course)).sum(-1)[pose] / DT_S
    chance = np.repeat(np.log(np.maximum(av.probability, 1e-6)), len(when))[pose] / 2
    step = np.tile(when, len(av.probability))[pose]
    return _timed(path[pose], along[rows], left[rows], step, av_speed, chance, start)


def _contact_offsets(turn: Floats, sizes_m: tuple[Floats, Floats], sector: int) -> Floats:
    """(G, V, 2) opponent's centres in the AV's frame at headings (G) relative to the AV's.

    They put the corner that reaches farthest, or the middle of the side that does, on points of the
    AV's outline in the sector.
    """
    (own_length, own_width), (length, width) = sizes_m
    bearing = sector * np.pi / 4 + np.array(_ASIDE_RAD)
    across, aside = np.cos(bearing), np.sin(bearing)
    end = length / 2 / np.maximum(np.abs(across), 1e-9)
    side = width / 2 / np.maximum(np.abs(aside), 1e-9)
    touch = np.minimum(end, side)[:, None] * np.stack([across, aside], axis=-1)
    zero = np.zeros(len(bearing))
    at_end = np.stack([np.sign(across), zero], axis=-1)
    outward = np.where((end < side)[:, None], at_end, np.stack([zero, np.sign(aside)], axis=-1))
    size = np.array([own_length, own_width])
    corners = boxes.corners(np.zeros(2), turn, size)
    reach = np.einsum("gcx,nx->gnc", corners, outward)
    two = np.argsort(reach, axis=-1)[..., :2]
    nearest = np.take_along_axis(corners[:, None], two[..., None], axis=2)
    supports = np.stack([nearest[:, :, 0], nearest.mean(axis=2)], axis=2)
    centre = touch[None, :, None] - supports
    deep = np.array(_DEEP_M)[:, None] * outward[:, None]
    return (centre[:, :, :, None] - deep[None, :, None]).reshape(len(turn), -1, 2)


def _projected(paths: list[OwnPath], path: Ints, aim_m: Floats) -> tuple[Floats, Floats, Bools]:
    """Arc lengths and lateral shifts (G) of aims on their paths; whether a shift reaches them."""
    along, left = np.zeros(len(path)), np.zeros(len(path))
    reached = np.zeros(len(path), dtype=bool)
    for number in np.unique(path):
        rows = path == number
        along[rows], foot = paths[number].project(aim_m[rows])
        left[rows] = foot.left_m
        reached[rows] = np.abs(np.abs(foot.left_m) - foot.distance_m) < 0.1
    return along, left, reached


def _timed(
    path: Ints,
    along: Floats,
    left: Floats,
    step: Ints,
    av_speed: Floats,
    chance: Floats,
    start: Start,
) -> _Aims:
    """Every aim with each arrival speed and each start of the shift."""
    seconds = (step + 1) * DT_S
    lack = along - start.speed_mps * seconds
    steady = start.speed_mps + 2 * lack / seconds
    arrival = np.stack([steady, *(np.maximum(av_speed + more, 0.0) for more in _FASTER_MPS)])
    total = 2 * (arrival - start.speed_mps) / seconds
    accel = (8 * lack / seconds**2 - total) / 2
    shift_from = np.repeat(_SHIFT_FROM, accel.size)

    def every(values: Floats | Ints) -> Any:
        return np.tile(np.broadcast_to(values, accel.shape).ravel(), len(_SHIFT_FROM))

    effort = np.abs(every(accel)) / 3 + np.abs(every(total - accel)) / 3
    effort = effort + np.abs(every(left)) / 4 - every(chance)
    return _Aims(
        path=every(path),
        along_m=every(along),
        left_m=every(left),
        step=every(step),
        accel=every(accel),
        then_accel=every(total - accel),
        shift_from=shift_from,
        effort=effort,
    )


def _reachable(aims: _Aims, paths: list[OwnPath], start: Start, limits: MotionLimits) -> _Aims:
    """The best aims within the limits; of aims that differ by less than a metre only the best."""
    seconds = (aims.step + 1) * DT_S
    halfway = start.speed_mps + aims.accel * seconds / 2
    arrival = halfway + aims.then_accel * seconds / 2
    fastest = np.maximum(start.speed_mps, np.maximum(halfway, arrival))
    curvature = np.stack([path.curvature(aims.along_m) for path in paths])
    bend = curvature[aims.path, np.arange(len(aims.path))]
    rest = 1.0 - aims.shift_from
    shift = np.abs(aims.left_m)
    lateral = _SHIFT_PEAK * shift / (seconds * rest) ** 2 + bend * fastest**2
    least, most = np.minimum(aims.accel, aims.then_accel), np.maximum(aims.accel, aims.then_accel)
    possible = (
        (most <= limits.accel)
        & (-least <= limits.brake)
        & (lateral <= limits.lateral)
        & (halfway >= -1e-6)
        & (arrival >= -1e-6)
        & (shift <= np.minimum(_WIDEST_M, _STEEPEST * rest * aims.along_m + 0.2))
    )
    rows = np.flatnonzero(possible)
    rows = rows[np.argsort(aims.effort[rows], kind="stable")]
    cells = np.stack(
        [
            aims.path,
            np.rint(aims.along_m),
            np.rint(2 * aims.left_m),
            aims.step,
            np.rint(arrival),
            2 * aims.shift_from,
        ],
        axis=-1,
    )[rows]
    _, first = np.unique(cells, axis=0, return_index=True)
    return aims.take(rows[np.sort(first)[:_TRIED]])


def _references(aims: _Aims, paths: list[OwnPath], start: Start, steps: int) -> Floats:
    """(K, F, 2) positions of the opponent on the path to each aim and past it."""
    arrival = (aims.step[:, None] + 1) * DT_S
    seconds = (np.arange(steps) + 1) * DT_S
    first = np.minimum(seconds, arrival / 2)
    second = np.clip(seconds - arrival / 2, 0.0, arrival / 2)
    accel, then = aims.accel[:, None], aims.then_accel[:, None]
    halfway = start.speed_mps + accel * arrival / 2
    final = halfway + then * arrival / 2
    driven = start.speed_mps * first + accel * first**2 / 2
    driven = driven + halfway * second + then * second**2 / 2
    driven = driven + final * np.maximum(seconds - arrival, 0.0)
    begin = aims.shift_from[:, None]
    share = np.clip((driven / aims.along_m[:, None] - begin) / (1.0 - begin), 0.0, 1.0)
    return aims.references(paths, driven, share)


def _wanted_mass(situation: Situation, av: Forecast, reference: Floats, sector: int) -> Floats:
    """(K) mass of the AV's modes that each reference first touches in the sector."""
    futures = Futures(
        agent_id=situation.opponent_id,
        position_m=reference,
        heading_rad=_headings(reference, situation.start.heading_rad),
    )
    each, sizes_m = [av] * len(reference), (situation.size_m, situation.av_size_m)
    _, step = collisions(futures, each, *sizes_m, situation.horizon, situation.levels)
    found = impact_sectors(futures, each, *sizes_m, step)
    return ((found == sector) * av.probability).sum(axis=1)


def _headings(reference: Floats, heading_rad: float) -> Floats:
    """(K, F) directions of motion; a standing vehicle keeps its last direction."""
    moved = np.diff(reference, axis=1, prepend=reference[:, :1])
    moved[:, 0] = moved[:, 1]
    going = np.hypot(moved[..., 0], moved[..., 1]) > DIRECTION_MPS * DT_S
    last = np.maximum.accumulate(np.where(going, np.arange(going.shape[1]), -1), axis=1)
    course = np.arctan2(moved[..., 1], moved[..., 0])
    held = np.take_along_axis(course, np.maximum(last, 0), axis=1)
    return np.where(last >= 0, held, heading_rad)
