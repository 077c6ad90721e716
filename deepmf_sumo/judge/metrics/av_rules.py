"""Rules of the road and of comfort that the AV keeps or breaks, whether it is attacked or not.

Each is a number of one episode, 0 where the AV keeps the rule. They need no attack: a run measures
them on the attacked episode and on the same one without attack (`MONITORS`).
"""

from typing import Final

import numpy as np
import shapely

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, driving, metric, once
from deepmf_sumo.judge.metrics._surroundings import (
    CEILING_MPS2,
    DrivenSteps,
    StopApproach,
    approaches,
    driven_steps,
    lane_ids,
    limits_ahead,
    own_stops,
    unexplained,
)
from deepmf_sumo.judge.metrics.conflict import (
    MovingBox,
    braking_to_stay_behind,
    slowing,
    time_to_collision,
)
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, Rollout
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import on_level
from deepmf_sumo.scene.geometry.lane_map import MARGIN_M
from deepmf_sumo.scene.geometry.road import lanes_for_cars
from deepmf_sumo.scene.geometry.slow import WAITING_MPS, WALKING_MPS
from deepmf_sumo.scene.signals import FORBIDS

MONITORS: Final = (
    "av_over_limit",
    "av_late_at_signal",
    "av_signal_braking",
    "av_beyond_stop_line",
    "av_red_run",
    "av_right_of_way_taken",
    "av_crossing_taken",
    "av_unexplained_stop",
    "av_unexplained_braking",
    "av_close_following",
    "av_off_lane",
    "av_frozen",
    "av_ttc_min",
    "av_time_gap_min",
    "av_required_braking",
    "av_progress",
    "planner_hardest_braking",
)
"""Metrics of the AV alone: a run has them of its episode without attack, too."""

_REACTION_S: Final = 1.0
_COMFORTABLE_MPS2: Final = 3.0
"""A driver who can stop with this, a second after the light changed, has to (ITE, yellow times)."""
_AT_LINE_M: Final = 0.5
_PARKS_S: Final = 3.0
"""To a bay and back onto the lane."""
_ACROSS_LINE_M: Final = 10.0
_FOLLOWS_MPS: Final = 5.0
_SLOWER_MPS: Final = 0.01
_CLOSE_S: Final = 0.9
"""Half of the speedometer's number in metres is 1.8 s; half of that is an offence in Germany."""
_SAME_WAY_RAD: Final = float(np.pi / 6)
_PRESENT_M: Final = 60.0
_LONG_STEPS: Final = 5
_FROZEN_MPS: Final = 0.0005
_AT_LIMIT_MPS: Final = 0.01
_SEEN_S: Final = 2.5
"""A driver reacts and stops from 50 km/h in this time."""
_WAITS_S: Final = 3.0
_TURNS_M: Final = 30.0
_TURNED_RAD: Final = float(np.radians(20))
_REPEATED_STEPS: Final = 3
_BRAKES_MPS2: Final = 0.7
_BESIDE_STEPS: Final = 2


@metric("m/s2", better="higher")
def av_signal_braking(episode: Episode) -> float:
    """Largest constant braking that still stops the AV's front at the line of a light that is
    yellow or red, over the simulated steps up to the AV's first contact; at most 10 m/s2, and 0
    without a light at which it could have stopped with 3 m/s2 one second after the light changed.

    Of lanes that begin at one line all lights must be yellow or red. Who begins to brake late, or
    drives on where it could have stopped, has a large value.
    """
    drive = DrivenSteps.of(episode)
    needed = [_to_stop_mps2(drive, one) for one in approaches(episode)]
    return min(max(needed, default=0.0), CEILING_MPS2)


def _to_stop_mps2(drive: DrivenSteps, approach: StopApproach) -> float:
    speed, left_m = drive.speed_mps, approach.left_m
    hardest = 0.0
    for run in _slices.runs(approach.halts & (left_m > 0) & np.isfinite(left_m)):
        if _could_stop(speed[run.start], left_m[run.start]):
            needed = speed[run] ** 2 / (2 * np.maximum(left_m[run], _AT_LINE_M))
            hardest = max(hardest, float(needed.max()))
    return hardest


def _could_stop(speed_mps: float, left_m: float) -> bool:
    """Whether braking that is comfortable, begun a second later, stops the AV before the line."""
    room = left_m - speed_mps * _REACTION_S
    return bool(0 < room < np.inf and speed_mps**2 / (2 * room) <= _COMFORTABLE_MPS2)


@metric("m", better="higher")
def av_beyond_stop_line(episode: Episode) -> float:
    """Largest distance by which the AV's front is beyond the line of a light, while it stands
    (below 0.5 m/s) and the light has been yellow or red since the AV could have stopped before it
    with 3 m/s2 after a second; over the simulated steps up to the AV's first contact.
    """
    drive, worst = DrivenSteps.of(episode), 0.0
    for one in approaches(episode):
        for run in _slices.runs(one.halts & np.isfinite(one.left_m)):
            if _could_stop(drive.speed_mps[run.start], one.left_m[run.start]):
                beyond = np.where(drive.speed_mps < WAITING_MPS, -one.left_m, 0.0)[run]
                worst = max(worst, float(beyond[beyond < _ACROSS_LINE_M].max(initial=0.0)))
    return worst


@metric("1", better="higher")
def av_red_run(episode: Episode) -> float:
    """1 where the middle of the AV's front bumper crosses stop lines of lanes in its direction that
    all are red, in the simulated steps up to the AV's first contact, else 0.
    """
    rollout = episode.rollout
    if not rollout.signals:
        raise NotMeasurable("the rollout has no states of traffic lights")
    row = rollout.tracks.row(rollout.av_id)
    return driving.passed_on_red(rollout, episode.case, row, driven_steps(rollout))


@metric("m/s2", better="higher")
def av_right_of_way_taken(episode: Episode) -> float:
    """Largest braking that the AV, moving on a lane inside a junction, asks of a vehicle, a cyclist
    or a tram that drives on a lane with priority over it, over the simulated steps up to the AV's
    first contact; at most 10 m/s2. A road user whose light is red has no priority. Lights of trams
    on tracks of their own are not known: at lights trams do not count.
    """
    drive, road = DrivenSteps.of(episode), episode.case.road
    if not any(one.gives_way_to for one in road.lanes.values()):
        raise NotMeasurable("the map does not say who has priority")
    hardest, inside = 0.0, lane_ids(episode)
    for name in dict.fromkeys(inside):
        lane = road.lanes.get(name or "")
        if lane is None or not (lane.interpolating and lane.gives_way_to):
            continue
        on_it = np.array([one == name for one in inside]) & (drive.speed_mps > WAITING_MPS)
        if not on_it.any():
            continue
        begin = int(np.flatnonzero(on_it)[0])
        first = {
            one for one in lane.gives_way_to
            if drive.light(begin, one) not in FORBIDS and not _waits_too(road, one, lane.id)
        }  # fmt: skip
        rail = drive.light(begin, lane.id) is None and not first <= road.lanes.keys()
        for row in _with_priority(episode, drive, begin, first, rail=rail):
            hardest = max(hardest, _asked_mps2(episode.rollout, drive.steps[on_it], row))
    return min(hardest, CEILING_MPS2)


def _waits_too(road: RoadMap, one: str, other: str) -> bool:
    """Whether a lane gives way to another, as all do to each other at an all-way stop."""
    return one in road.lanes and other in road.lanes[one].gives_way_to


def _with_priority(
    episode: Episode, drive: DrivenSteps, begin: int, first: set[str], *, rail: bool
) -> list[int]:
    """Rows of road users near the AV at step ``begin`` that use one of some lanes from then on.

    ``rail``: trams have priority wherever they are; maps do not have their tracks.
    """
    tracks = episode.rollout.tracks
    step, found = int(drive.steps[begin]), []
    apart = np.hypot(*(tracks.position_m[:, step] - drive.position_m[begin]).T)
    for row in np.flatnonzero(tracks.valid[:, step] & (apart < _PRESENT_M)).tolist():
        if row == drive.row or tracks.kinds[row] == "pedestrian":
            continue
        there = tracks.valid[row] & (np.arange(tracks.steps) >= step)
        on_rail = rail and tracks.kinds[row] == "other"
        if on_rail or first & set(lane_ids(episode, row, there)):
            found.append(row)
    return found


def _asked_mps2(rollout: Rollout, steps: Ints, row: int) -> float:
    """Braking that the AV at some steps asks of another, which has not begun to brake before."""
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    steps = steps[tracks.valid[row, steps]]
    if not len(steps):
        return 0.0
    other, mine = MovingBox.of(tracks, row, steps), MovingBox.of(tracks, av, steps)
    soon = time_to_collision(other, mine)
    brakes = slowing(tracks, av, rollout.dt_s)[steps]
    return float(braking_to_stay_behind(other, mine, brakes, soon).max(initial=0.0))


@metric("1", better="higher")
def av_crossing_taken(episode: Episode) -> float:
    """1 where the AV, faster than walking (1.4 m/s), drives onto a pedestrian crossing on which
    somebody has walked for 2.5 s, and who gets into its corridor within the next 3 s, in the
    simulated steps up to the AV's first contact, else 0. Nobody counts where the AV passed a green
    light and went straight on: the crossing is red then.
    """
    drive, road = DrivenSteps.of(episode), episode.case.road
    crossings = [(one.id, shapely.Polygon(one.points_m), float(one.z_m.mean()))
                 for one in road.polygons
                 if one.kind == "crosswalk" and len(one.points_m) > 2]  # fmt: skip
    if not crossings:
        raise NotMeasurable("the map has no pedestrian crossings")
    on_foot = np.flatnonzero(np.array(episode.rollout.tracks.kinds) == "pedestrian").tolist()
    for crossing, area, z_m in crossings if on_foot else ():
        inside = np.asarray(shapely.contains_xy(area, *drive.front_m.T))
        inside &= on_level(road, drive.z_m, z_m)
        for at in np.flatnonzero(inside & ~np.concatenate([inside[:1], inside[:-1]])).tolist():
            let_go = _light_let_it_go(episode, drive, at, crossing)
            fast = drive.speed_mps[at] > WALKING_MPS and not let_go
            if fast and any(_has_to_wait_for(episode, drive, at, row, area) for row in on_foot):
                return 1.0
    return 0.0


def _has_to_wait_for(
    episode: Episode, drive: DrivenSteps, at: int, row: int, area: shapely.Polygon
) -> bool:
    """Whether a person has been on a crossing for long, and comes into the AV's corridor."""
    tracks, step = episode.rollout.tracks, int(drive.steps[at])
    since = np.arange(max(step - round(_SEEN_S / episode.rollout.dt_s), 0), step + 1)
    if not tracks.valid[row, since].all():
        return False
    if not np.all(shapely.contains_xy(area, *tracks.position_m[row, since].T)):
        return False
    if not on_level(episode.case.road, tracks.z_m[row, step], drive.z_m[at]):
        return False
    left_m = frames.to_local(
        tracks.position_m[row, step], drive.position_m[at], float(drive.heading_rad[at])
    )[1]
    normal = frames.unit(np.asarray(drive.heading_rad[at] + np.pi / 2))
    towards_mps = -np.sign(left_m) * float(tracks.velocity_mps[row, step] @ normal)
    room_m = abs(float(left_m)) - float(drive.size_m[1] + tracks.size_m[row, 1]) / 2
    return bool(room_m <= 0 or room_m < towards_mps * _WAITS_S)


def _light_let_it_go(episode: Episode, drive: DrivenSteps, at: int, crossing: str) -> bool:
    """Whether the AV passed a green light before a crossing, and has gone straight on since."""
    rollout, road = episode.rollout, episode.case.road
    before = np.hypot(*(drive.position_m[: at + 1] - drive.position_m[at]).T) < _TURNS_M
    turned = frames.difference(drive.heading_rad[: at + 1][before], drive.heading_rad[at])
    if np.abs(turned).max() > _TURNED_RAD:
        return False
    return driving.passed_green(rollout, road, drive.row, drive.position_m[at], crossing)


@metric("s", better="higher")
def av_unexplained_stop(episode: Episode) -> float:
    """Longest time for which the AV stands (below 0.5 m/s) without a reason that can be seen, over
    the simulated steps up to its first contact.

    Reasons are: a road user ahead within 60 m (and the way on which the AV stops with 2 m/s2) that
    neither passes beside the AV nor drives away from it, a light
    within 100 m that is not green, a lower limit or the end of the lane within 100 m, a lane within
    60 m that gives way, a stop of its own route within 100 m, and the first second.
    """
    drive = DrivenSteps.of(episode)
    stands = (drive.speed_mps < WAITING_MPS) & unexplained(episode)
    return _longest(stands) * episode.rollout.dt_s


@metric("m/s2", better="higher")
def av_unexplained_braking(episode: Episode) -> float:
    """Hardest braking of the AV, mean of 0.5 s, without a reason that can be seen in the second
    before and since, over the simulated steps up to its first contact; reasons are those of
    `av_unexplained_stop`.
    """
    drive, dt_s = DrivenSteps.of(episode), episode.rollout.dt_s
    free, speed = unexplained(episode), drive.speed_mps
    before = round(1.0 / dt_s)
    hardest = 0.0
    for at in range(before, len(speed) - _LONG_STEPS):
        if free[at - before : at + _LONG_STEPS + 1].all():
            lost = float(speed[at] - speed[at + _LONG_STEPS])
            hardest = max(hardest, lost / (_LONG_STEPS * dt_s))
    return hardest


@metric("s", better="higher")
def av_close_following(episode: Episode) -> float:
    """Longest time for which the AV, faster than 5 m/s and not slowing down, is less than 0.9 s
    behind the place where a road user ahead in its direction (within 30 degrees) is at that moment,
    over the simulated steps up to the AV's first contact.
    """
    drive, gap_s = DrivenSteps.of(episode), _gap_s(episode)
    slower = np.concatenate([[0.0], np.diff(drive.speed_mps)]) < -_SLOWER_MPS
    close = (gap_s < _CLOSE_S) & (drive.speed_mps > _FOLLOWS_MPS) & ~slower
    return _longest(close) * episode.rollout.dt_s


@once
def _gap_s(episode: Episode) -> Floats:
    """(K) least time gap to a road user that drives ahead in the AV's direction."""
    drive, tracks = DrivenSteps.of(episode), episode.rollout.tracks
    least = np.full(len(drive.steps), np.inf)
    for row in range(tracks.agents):
        offset = tracks.position_m[row, drive.steps] - drive.position_m
        turn = frames.difference(tracks.heading_rad[row, drive.steps], drive.heading_rad)
        ahead = (offset * frames.unit(drive.heading_rad)).sum(-1) > 0
        near = ahead & (np.hypot(*offset.T) < _PRESENT_M) & (np.abs(turn) < _SAME_WAY_RAD)
        near &= tracks.valid[row, drive.steps]
        if row == drive.row or not near.any():
            continue
        at = drive.steps[near]
        other = MovingBox.of(tracks, row, at)
        still = other._replace(
            velocity_mps=np.zeros_like(other.velocity_mps), climb_mps=np.zeros(len(at))
        )
        least[near] = np.minimum(
            least[near], time_to_collision(MovingBox.of(tracks, drive.row, at), still)
        )
    return least


@metric("m", better="higher")
def av_off_lane(episode: Episode) -> float:
    """Largest distance by which a side of the AV's box, at its middle, is outside of all lanes for
    cars, over the simulated steps up to its first contact at which it is outside of junctions. A
    change between lanes counts nothing, nor does overtaking on a lane of the other direction, nor
    standing at a stop of its own route, with 3 s before and after for the way to a bay.
    """
    drive, road = DrivenSteps.of(episode), episode.case.road
    names = lane_ids(episode)
    outside = np.array([bool(one) and not road.lanes[one or ""].interpolating for one in names])
    stands = (drive.speed_mps < WAITING_MPS) & own_stops(episode.rollout)[drive.steps]
    apart = np.abs(np.subtract.outer(np.arange(0.0, len(stands)), np.flatnonzero(stands)))
    outside &= apart.min(axis=1, initial=np.inf) * episode.rollout.dt_s > _PARKS_S
    aside = frames.unit(drive.heading_rad + np.pi / 2) * drive.size_m[1] / 2
    sides = np.concatenate([drive.position_m + aside, drive.position_m - aside])
    beyond = _beyond_m(road, sides, np.tile(drive.z_m, 2))
    known = np.isfinite(beyond) & np.tile(outside, 2)
    if not known.any():
        raise NotMeasurable("the AV drove on no lane that is known")
    return float(beyond[known].max())


def _beyond_m(road: RoadMap, points_m: Floats, z_m: Floats) -> Floats:
    """(N) how far points lie beside the nearest lane for cars of their level; inf without one."""
    lanes = lanes_for_cars(road)
    feet = lanes.feet(points_m, 2 * lanes.widest_m)
    half = lanes.reach_m[lanes.lane[feet.segment]] - MARGIN_M
    away = np.maximum(np.hypot(*feet.away_m.T) - half, 0.0)
    level = on_level(road, z_m[feet.point], lanes.heights_m(feet))
    found = np.full(len(points_m), np.inf)
    np.minimum.at(found, feet.point[level], away[level])
    return found


@metric("s", better="higher")
def av_frozen(episode: Episode) -> float:
    """Longest time, of at least 0.3 s, for which the AV's speed stays the same (to 0.5 mm/s a step,
    above 1 m/s) while it brakes with more than 0.7 m/s2 both just before and just after, over the
    simulated steps up to its first contact: as if a command had been repeated.

    A limit, or SUMO while it changes lanes, may well hold a speed between two accelerations. It may
    also brake to the limit of a lane within 100 m and hold that speed: that counts nothing.
    """
    drive, dt_s = DrivenSteps.of(episode), episode.rollout.dt_s
    change = np.diff(drive.speed_mps)
    still = (np.abs(change) < _FROZEN_MPS) & (drive.speed_mps[1:] > 1.0)
    longest = 0
    for run in _slices.runs(still):
        beside = [change[: run.start][-_BESIDE_STEPS:], change[run.stop :][:_BESIDE_STEPS]]
        brakes = all(len(one) and one.max() < -_BRAKES_MPS2 * dt_s for one in beside)
        steps = run.stop - run.start
        if not brakes or steps < _REPEATED_STEPS:
            continue
        off_limits = np.abs(drive.speed_mps[run.start] - limits_ahead(episode, run.start))
        longest = max(longest, steps * bool((off_limits > _AT_LIMIT_MPS).all()))
    return longest * dt_s


def _longest(mask: Bools) -> int:
    """Steps of the longest uninterrupted stretch."""
    return max((run.stop - run.start for run in _slices.runs(mask)), default=0)
