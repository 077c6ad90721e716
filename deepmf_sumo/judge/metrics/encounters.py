"""Encounters of the AV with vehicles whose path crosses or joins its own, and the time to spare.

A vehicle that only follows or leads the AV in its lane is not an encounter: that is common.
"""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric
from deepmf_sumo.scene import Bools, Floats, Ints, Rollout
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import CLEARANCE_M, clear

_PATH_STEPS: Final = 2
_STANDING_M = 0.05
_SLOWEST_MPS = 1e-3
_ACROSS_RAD = np.pi / 6
_BESIDE_M = 2.0  # a vehicle with its centre farther off the AV's path was not on it
_LOOK_BACK_STEPS = 40
_COURSE_STEPS = 10
_MOVED_M = 2.0
_NEAR_M = 60.0
_BEYOND_M = 100.0
_BLOCK_STEPS = 256
_MET: Final = ("vehicle", "other")  # trams are others
_LEVEL: Final = np.zeros(())


class Trip(NamedTuple):
    """A vehicle's path: steps (K), positions (K, 2), headings, speeds (K), length and width (2).

    ``z_m``: (K) heights, or () for all.
    """

    step: Ints
    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    size_m: Floats
    z_m: Floats = _LEVEL


def _trip(rollout: Rollout, row: int) -> Trip:
    """The path of a vehicle from the current step on."""
    tracks = rollout.tracks
    step = np.flatnonzero(tracks.valid[row])
    step = step[step >= rollout.now]
    return Trip(
        step=step,
        position_m=tracks.position_m[row, step],
        heading_rad=tracks.heading_rad[row, step],
        speed_mps=np.hypot(*tracks.velocity_mps[row, step].T),
        size_m=tracks.size_m[row, :2],
        z_m=tracks.z_m[row, step],
    )


@metric("s", better="lower")
def time_to_spare(episode: Episode) -> float:
    """Least post-encroachment time of the AV and a vehicle whose path crosses its own (by more than
    30 degrees), or time to collision with one that comes into its lane or into whose lane it comes
    (from 4 s before to now), over all vehicles, trams too; 0 in contact.

    Over all vehicles, not the opponent alone: how an attack disturbs a junction shows in all of
    them. After the two measures of conflicts of Gettman et al. (FHWA-HRT-08-051, 2008):
    post-encroachment time where paths cross, time to collision where they join.
    """
    rollout = episode.rollout
    if rollout.opponent_id is None:
        raise NotMeasurable(_slices.NO_OPPONENT)
    tracks = rollout.tracks
    av = _trip(rollout, tracks.row(rollout.av_id))
    if len(av.step) == 0:
        raise NotMeasurable("the AV left the simulation immediately")
    others = [
        _trip(rollout, row)
        for row, (agent_id, kind) in enumerate(zip(tracks.ids, tracks.kinds, strict=True))
        if kind in _MET and agent_id != rollout.av_id
    ]
    spare = [encounter_s(av, other, rollout.dt_s) for other in others if len(other.step)]
    least = min(spare, default=np.inf)
    if np.isinf(least):
        raise NotMeasurable("no path crossed or joined the AV's path")
    return least


def encounter_s(av: Trip, other: Trip, dt_s: float) -> float:
    """Least time between an encounter and a contact, in seconds; inf without an encounter.

    Paths on different levels do not meet. For paths that cross (by more than 30 degrees): the
    post-encroachment time. For paths that join (at most 30 degrees, and one vehicle came from
    beside the other's lane in the last 4 s): the time to collision along the lane. 0 where they
    touch after one of them came from beside the other's path.
    """
    if not _near(av, other):
        return float("inf")
    came = _came(av, other), _came(other, av)
    if _touch(av, other, came):
        return 0.0
    return min(_crossing_s(av, other, came, dt_s), _joining_s(av, other, came))


def _touch(av: Trip, other: Trip, came: tuple[Bools, Bools]) -> bool:
    """Whether their boxes overlap at a time, also in a sideswipe or head on."""
    _, mine, theirs = np.intersect1d(av.step, other.step, return_indices=True)
    apart = np.hypot(*(av.position_m[mine] - other.position_m[theirs]).T)
    near = apart < (np.hypot(*av.size_m) + np.hypot(*other.size_m)) / 2
    near &= (came[0][theirs] | came[1][mine]) & ~clear(_heights(av)[mine], _heights(other)[theirs])
    mine, theirs = mine[near], theirs[near]
    touch = boxes.overlap(
        av.position_m[mine], av.heading_rad[mine], av.size_m,
        other.position_m[theirs], other.heading_rad[theirs], other.size_m,
    )  # fmt: skip
    return bool(touch.any())


def _near(av: Trip, other: Trip) -> bool:
    return bool(_around(av.position_m, other.position_m, _NEAR_M).any())


def _around(path_m: Floats, position_m: Floats, margin_m: float) -> Bools:
    """(K) positions (K, 2) inside the rectangle around a path (P, 2) and a margin."""
    low, high = (end(path_m, axis=0) for end in (np.min, np.max))
    inside = (position_m > low - margin_m) & (position_m < high + margin_m)
    around: Bools = inside.all(axis=1)
    return around


def _crossing_s(av: Trip, other: Trip, came: tuple[Bools, Bools], dt_s: float) -> float:
    reach_m = float(np.hypot(*av.size_m) + np.hypot(*other.size_m)) / 2
    course, course_other = _course_rad(av), _course_rad(other)
    rows = np.flatnonzero(came[1])
    least = np.inf
    # in blocks: minutes of both would not fit into memory
    for first in range(0, len(rows), _BLOCK_STEPS):
        some = rows[first : first + _BLOCK_STEPS]
        near = np.flatnonzero(came[0] & _around(av.position_m[some], other.position_m, reach_m))
        apart = av.position_m[some, None] - other.position_m[near]
        across = np.cos(course[some, None] - course_other[near]) < np.cos(_ACROSS_RAD)
        one, two = np.nonzero(((apart**2).sum(axis=-1) < reach_m**2) & across)
        mine, theirs = some[one], near[two]
        shared = boxes.overlap(
            av.position_m[mine],
            av.heading_rad[mine],
            av.size_m,
            other.position_m[theirs],
            other.heading_rad[theirs],
            other.size_m,
        )
        shared &= ~clear(_heights(av)[mine], _heights(other)[theirs])
        between = np.abs(av.step[mine] - other.step[theirs])[shared]
        least = min(least, float(between.min()) if len(between) else np.inf)
    return least * dt_s


def _course_rad(trip: Trip) -> Floats:
    """(K) direction from 1 s before to 1 s after: during a lane change, a box turns more."""
    rows = np.arange(len(trip.step))
    before = trip.position_m[np.maximum(rows - _COURSE_STEPS, 0)]
    after = trip.position_m[np.minimum(rows + _COURSE_STEPS, len(rows) - 1)]
    moved = after - before
    course = np.arctan2(moved[:, 1], moved[:, 0])
    driven: Floats = np.where(np.hypot(*moved.T) > _MOVED_M, course, trip.heading_rad)
    return driven


def _joining_s(av: Trip, other: Trip, came: tuple[Bools, Bools]) -> float:
    _, mine, theirs = np.intersect1d(av.step, other.step, return_indices=True)
    if not len(mine):
        return float("inf")
    reach_m = (av.size_m[1] + other.size_m[1]) / 2
    # one of them may have just changed lanes: either path may be the common one
    ahead_m, off_m = _from(av, mine, other.position_m[theirs])
    behind_m, beside_m = _from(other, theirs, av.position_m[mine])
    on_level = np.where(
        off_m < reach_m,
        ~_passes(av, other.position_m[theirs], _heights(other)[theirs]),
        ~_passes(other, av.position_m[mine], _heights(av)[mine]),
    )
    ahead_m = np.where(off_m < reach_m, ahead_m, -behind_m)
    turn = np.cos(av.heading_rad[mine] - other.heading_rad[theirs])
    in_lane = (np.minimum(off_m, beside_m) < reach_m) & (turn > np.cos(_ACROSS_RAD))
    joined = in_lane & on_level & came[0][theirs] & came[1][mine]
    gap = np.maximum(np.abs(ahead_m) - (av.size_m[0] + other.size_m[0]) / 2, 0.0)
    closing = (av.speed_mps[mine] - other.speed_mps[theirs]) * np.sign(ahead_m)
    soon = joined & ((closing > 0) | (gap == 0))
    seconds = gap[soon] / np.maximum(closing[soon], _SLOWEST_MPS)
    return float(seconds.min(initial=np.inf))


def _from(trip: Trip, rows: Ints, position_m: Floats) -> tuple[Floats, Floats]:
    """(K) distances of positions (K, 2) ahead of a vehicle along its path, and off the path."""
    path = _path(trip)
    along_m, off_m = _feet(path, position_m)
    own_m, _ = _feet(path, trip.position_m[rows])
    return along_m - own_m, off_m


def _heights(trip: Trip) -> Floats:
    """(K) heights of a trip."""
    return np.broadcast_to(trip.z_m, trip.step.shape)


def _passes(trip: Trip, position_m: Floats, z_m: Floats) -> Bools:
    """(K) whether positions (K, 2) at heights (K) are above or below a vehicle's path.

    False beyond the ends of the path, where its height is unknown.
    """
    length = polylines.arc_lengths(trip.position_m)
    if length[-1] < _STANDING_M or np.ptp(np.append(_heights(trip), z_m)) < CLEARANCE_M:
        return np.zeros(len(position_m), bool)
    moved = np.concatenate([[True], np.diff(length) > 0])
    along, _ = _feet(trip.position_m[moved], position_m)
    inside = (along > 0.0) & (along < length[-1])
    passes: Bools = inside & clear(np.interp(along, length[moved], _heights(trip)[moved]), z_m)
    return passes


def _feet(path: Floats, position_m: Floats) -> tuple[Floats, Floats]:
    """(K) arc lengths of positions (K, 2) on a path (P, 2), and distances from it, in blocks."""
    blocks = range(0, len(position_m), _BLOCK_STEPS)
    feet = [polylines.project(path, position_m[row : row + _BLOCK_STEPS]) for row in blocks]
    return (
        np.concatenate([foot.along_m for foot in feet]),
        np.concatenate([foot.distance_m for foot in feet]),
    )


def _came(first: Trip, second: Trip) -> Bools:
    """(K) whether the second was off the first's path in the 4 s before, at each of its steps."""
    # a vehicle far beyond the ends of the path did not come from beside it
    apart = np.ptp(np.concatenate([first.position_m, second.position_m]), axis=0)
    path = _path(first, _BEYOND_M + float(np.hypot(*apart)))
    off = _feet(path, second.position_m)[1] > _BESIDE_M
    before = np.concatenate([[0], np.cumsum(off)])
    row = np.arange(len(off))
    came: Bools = before[row + 1] > before[np.maximum(row + 1 - _LOOK_BACK_STEPS, 0)]
    return came


def _path(trip: Trip, beyond_m: float = _BEYOND_M) -> Floats:
    """(P, 2) the path of a vehicle, extended straight at both ends."""
    path = trip.position_m[::_PATH_STEPS]
    start, end = (frames.unit(trip.heading_rad[row]) for row in (0, -1))
    path = np.concatenate([path[:1] - beyond_m * start, path, path[-1:] + beyond_m * end])
    moved: Floats = path[np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > _STANDING_M])]
    return moved
