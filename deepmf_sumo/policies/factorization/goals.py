"""Candidates that meet the AV where it is predicted to be.

Marginal modes follow the road; few of them cross the AV's way at the right moment. A goal is a
predicted position of the AV at some time, or a point a little off it. The opponent reaches it
along the path of that own mode which passes nearest, with a smooth lateral shift and with the one
constant acceleration that arrives in time (or brakes to a stop there, and waits).
"""

from dataclasses import dataclass, replace

import numpy as np

from deepmf_sumo.datatypes import DT_S, Floats, Forecast, Ints
from deepmf_sumo.geometry import angles, polylines
from deepmf_sumo.policies.factorization.own_paths import OwnPath, own_paths
from deepmf_sumo.policies.factorization.tracking import Limits, Start

_FIRST_STEP, _EVERY_STEPS = 7, 6  # goals at 0.8, 1.4, 2.0 ... s
_BEYOND_COST = 0.2  # a metre past the end of a predicted path, in metres of lateral shift
_WIDEST_M = 8.0  # two lanes: farther sideways the path is no longer the road's
_STEEPEST = 0.3  # lateral shift per metre driven: a mean angle of 17 degrees
_SHIFT_PEAK = 5.77  # largest second derivative of the quintic step 10u^3 - 15u^4 + 6u^5
_LENGTH_SHARE, _WIDTH_SHARE = 0.35, 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalPaths:
    """K references (K, F, 2) that reach goals, and the limits (K, 3) to track each with."""

    reference_m: Floats
    limits: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class _Goals:
    """Goals in coordinates of the opponent's own paths; arrays (G)."""

    path: Ints
    along_m: Floats
    left_m: Floats
    step: Ints
    accel: Floats
    curvature: Floats
    lateral: Floats
    score: Floats

    def take(self, rows: Ints) -> "_Goals":
        return _Goals(**{name: getattr(self, name)[rows] for name in self.__slots__})


def goal_paths(
    own: Forecast,
    av: Forecast,
    start: Start,
    av_size_m: Floats,
    limits: Limits,
    horizon: int,
    count: int,
) -> GoalPaths:
    """At most ``count`` references to goals around the AV's modes, most plausible first.

    ``own`` are the opponent's predicted modes, ``av`` the AV's. Goals that need more than the
    limits are dropped; those within the mild limits are tracked with these.
    """
    steps = own.futures.position_m.shape[1]
    when = np.arange(_FIRST_STEP, min(horizon, steps), _EVERY_STEPS)
    empty = GoalPaths(reference_m=np.empty((0, steps, 2)), limits=np.empty((0, 3)))
    if count == 0 or len(when) == 0:
        return empty
    paths = own_paths(own, start)
    goals = _chosen(_reachable(_goals(paths, av, when, av_size_m), start, limits), count)
    if len(goals.path) == 0:
        return empty
    mild = limits.mild()
    calm = (
        (goals.accel <= mild.accel) & (-goals.accel <= mild.brake) & (goals.lateral <= mild.lateral)
    )
    rows = np.where(calm[:, None], mild.rows(len(calm)), limits.rows(len(calm)))
    return GoalPaths(reference_m=_references(goals, paths, start, steps), limits=rows)


def _goals(paths: list[OwnPath], av: Forecast, when: Ints, av_size_m: Floats) -> _Goals:
    """All goals on their nearest own path, without timing yet."""
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
    # Feet before the start or past the end are no lateral shift: they cannot be reached sideways.
    sideways = np.abs(np.abs(left[pick]) - distance[pick]) < 0.1
    length, width = _LENGTH_SHARE * av_size_m[0], _WIDTH_SHARE * av_size_m[1]
    spots = np.array([[0, 0], [length, 0], [-length, 0], [0, width], [0, -width]], dtype=float)
    turn = heading - course[pick]
    cos, sin = np.cos(turn)[None], np.sin(turn)[None]
    shift_along = spots[:, :1] * cos - spots[:, 1:] * sin
    shift_left = spots[:, :1] * sin + spots[:, 1:] * cos
    # Points off the centre come after all centres: each costs as much as a mode e^5 less likely.
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


def _reachable(goals: _Goals, start: Start, limits: Limits) -> _Goals:
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
        & (np.abs(goals.left_m) <= np.minimum(_WIDEST_M, _STEEPEST * along + 0.2))
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


def _references(goals: _Goals, paths: list[OwnPath], start: Start, steps: int) -> Floats:
    """(K, F, 2) positions of the opponent on its way to each goal and beyond."""
    reference = np.empty((len(goals.path), steps, 2))
    accel, along = goals.accel[:, None], goals.along_m[:, None]
    arrival = (goals.step[:, None] + 1) * DT_S
    standing = start.speed_mps / np.maximum(-accel, 1e-6)
    arrival = np.where(accel < 0, np.minimum(arrival, standing), arrival)
    seconds = (np.arange(steps) + 1) * DT_S
    busy = np.minimum(seconds, arrival)
    final = start.speed_mps + accel * arrival
    driven = start.speed_mps * busy + accel * busy**2 / 2 + final * (seconds - busy)
    share = np.clip(driven / along, 0.0, 1.0)
    shift = goals.left_m[:, None] * share**3 * (10 - 15 * share + 6 * share**2)
    for path in np.unique(goals.path):
        rows = goals.path == path
        where, heading = polylines.points_at(paths[path].points_m, driven[rows])
        reference[rows] = where + shift[rows][..., None] * angles.unit(heading + np.pi / 2)
    return reference
