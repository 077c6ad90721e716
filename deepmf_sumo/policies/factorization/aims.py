"""Candidates that meet the AV on a wanted side.

An aim is a pose of the opponent beside a predicted pose of the AV, such that the two boxes touch in
the wanted sector. As in `goals`, the opponent gets there along the nearest of its own ways, with a
smooth lateral shift; but the shift may begin late, and two accelerations, each for half of the
time, let it arrive at another speed than the AV's: from behind faster, from ahead slower. Of all
that the limits allow, those are kept that first touch the predicted AV in the wanted sector.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import DT_S, Bools, Floats, Forecast, Futures, Ints
from deepmf_sumo.geometry import angles, boxes, polylines
from deepmf_sumo.geometry.slow import DIRECTION_MPS
from deepmf_sumo.policies.factorization.collision import Levels, collisions, impact_sectors
from deepmf_sumo.policies.factorization.goals import GoalPaths
from deepmf_sumo.policies.factorization.own_paths import OwnPath, own_paths
from deepmf_sumo.policies.factorization.tracking import Limits, Start

_FIRST_STEP, _EVERY_STEPS = 4, 5  # aims at 0.5, 1.0, 1.5 ... s
_ASIDE_RAD = (0.0, 0.2, -0.2)  # points of contact off the middle of the sector
_DEEP_M = (0.15, 1.0)  # boxes that only touch do not overlap yet
_FASTER_MPS = (-3.0, 0.0, 3.0)  # arrival speeds beside that of a constant acceleration
_SHIFT_FROM = (0.0, 0.5)  # share of the way before the lateral shift
_SHIFT_PEAK = 5.77  # largest second derivative of the quintic step 10u^3 - 15u^4 + 6u^5
_WIDEST_M, _STEEPEST = 8.0, 0.35
_TRIED = 400  # aims that are driven against the prediction


@dataclass(frozen=True, slots=True, kw_only=True)
class _Aims:
    """Aims in coordinates of the opponent's own paths; arrays (G)."""

    path: Ints
    along_m: Floats
    left_m: Floats
    step: Ints
    accel: Floats
    then_accel: Floats
    shift_from: Floats
    effort: Floats

    def take(self, rows: Ints) -> "_Aims":
        return _Aims(**{name: getattr(self, name)[rows] for name in self.__slots__})


def aimed_paths(
    own: Forecast,
    av: Forecast,
    start: Start,
    sizes_m: tuple[Floats, Floats],
    sector: int,
    limits: Limits,
    horizon: int,
    count: int,
    levels: Levels | None = None,
) -> GoalPaths:
    """At most ``count`` references that first touch the predicted AV in ``sector``, best first.

    ``sizes_m`` are (2) length and width of the opponent and of the AV. Best are those that touch
    most of the AV's predicted mass, then those with the least effort.
    """
    steps = own.futures.position_m.shape[1]
    when = np.arange(_FIRST_STEP, min(horizon, steps), _EVERY_STEPS)
    none = GoalPaths(reference_m=np.empty((0, steps, 2)), limits=np.empty((0, 3)))
    if count == 0 or len(when) == 0:
        return none
    paths = own_paths(own, start)
    aims = _reachable(_aims(paths, av, when, sizes_m, sector, start), paths, start, limits)
    if len(aims.path) == 0:
        return none
    reference = _references(aims, paths, start, steps)
    mass = _wanted_mass(reference, start, av, sizes_m, sector, horizon, levels)
    order = np.lexsort((aims.effort, -np.round(mass, 1)))
    best = order[mass[order] > 0][:count]
    return GoalPaths(reference_m=reference[best], limits=limits.rows(len(best)))


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
    offset = _contact_offsets(angles.wrap(course - heading), sizes_m, sector)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x = offset[..., 0] * cos - offset[..., 1] * sin
    y = offset[..., 0] * sin + offset[..., 1] * cos
    aim = (position[:, None] + np.stack([x, y], axis=-1)).reshape(-1, 2)
    of_pose = np.repeat(np.arange(len(position)), offset.shape[1])
    along, left, reached = _projected(paths, path[of_pose], aim)
    rows = np.flatnonzero(reached & (along > 0.5))
    pose = of_pose[rows]
    av_speed = ((position - before) * angles.unit(course)).sum(-1)[pose] / DT_S
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
    offsets: Floats = (centre[:, :, :, None] - deep[None, :, None]).reshape(len(turn), -1, 2)
    return offsets


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
    """Every aim with each arrival speed and each beginning of the shift."""
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


def _reachable(aims: _Aims, paths: list[OwnPath], start: Start, limits: Limits) -> _Aims:
    """The best aims within the limits; of those within a metre in the same way only the best."""
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
    """(K, F, 2) positions of the opponent on its way to each aim and beyond."""
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
    shift = aims.left_m[:, None] * share**3 * (10 - 15 * share + 6 * share**2)
    reference = np.empty((len(aims.path), steps, 2))
    for path in np.unique(aims.path):
        rows = aims.path == path
        where, heading = polylines.points_at(paths[path].points_m, driven[rows])
        reference[rows] = where + shift[rows][..., None] * angles.unit(heading + np.pi / 2)
    return reference


def _wanted_mass(
    reference: Floats,
    start: Start,
    av: Forecast,
    sizes_m: tuple[Floats, Floats],
    sector: int,
    horizon: int,
    levels: Levels | None,
) -> Floats:
    """(K) mass of the AV's modes that each reference first touches in the sector."""
    futures = Futures(
        agent_id="", position_m=reference, heading_rad=_headings(reference, start.heading_rad)
    )
    each = [av] * len(reference)
    _, step = collisions(futures, each, *sizes_m, horizon, levels)
    found = impact_sectors(futures, each, *sizes_m, step)
    mass: Floats = ((found == sector) * av.probability).sum(axis=1)
    return mass


def _headings(reference: Floats, heading_rad: float) -> Floats:
    """(K, F) directions of motion; a standing vehicle keeps its last one."""
    moved = np.diff(reference, axis=1, prepend=reference[:, :1])
    moved[:, 0] = moved[:, 1]
    going = np.hypot(moved[..., 0], moved[..., 1]) > DIRECTION_MPS * DT_S
    last = np.maximum.accumulate(np.where(going, np.arange(going.shape[1]), -1), axis=1)
    course = np.arctan2(moved[..., 1], moved[..., 0])
    held = np.take_along_axis(course, np.maximum(last, 0), axis=1)
    heading: Floats = np.where(last >= 0, held, heading_rad)
    return heading
