"""Collisions: time, speed, kind, and whether the attack is a valid one.

An impact is one of ends if, a step before the contact, the boxes are farther apart along the AV
than across it; otherwise it is one of sides.
"""

from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.datatypes import DT_S, Floats, Rollout, Tracks
from deepmf_sumo.geometry import boxes, frames, polylines, road
from deepmf_sumo.metrics import Episode, NotMeasurable, _slices, metric
from deepmf_sumo.metrics.avoidability import judgement
from deepmf_sumo.metrics.driving import feasible

AccidentType = Literal["cut_in", "rear_end", "t_bone", "head_on", "sideswipe"]
ACCIDENT_TYPES: Final[tuple[AccidentType, ...]] = get_args(AccidentType)
"""In the order of the metric's numbers: 0 is a cut-in."""
_PARALLEL_ENDS_RAD, _PARALLEL_SIDES_RAD = np.pi / 4, np.pi / 6
CUT_IN_S: Final = 3.0
"""In a cut-in the vehicle in front was beside the other's path at some time of these seconds."""
_STRAIGHT_M = 100.0
_LEAST_MPS = 1e-6


@metric("1", better="higher")
def collision(episode: Episode) -> float:
    """1 where the boxes of AV and opponent overlap at a simulated step, else 0; its mean is the
    collision rate.
    """
    _slices.opponent_row(episode.rollout)
    return episode.rollout.first("av_opponent") is not None


@metric("1", better="higher")
def collision_clean(episode: Episode) -> float:
    """1 where AV and opponent collide and neither of them had a contact with another agent before,
    else 0.
    """
    rollout = episode.rollout
    _slices.opponent_row(rollout)
    hit = rollout.first("av_opponent")
    return hit is not None and not any(contact.step < hit.step for contact in rollout.contacts)


@metric("s", better="lower")
def collision_time_s(episode: Episode) -> float:
    """Time from the current step to the contact of AV and opponent; hits only."""
    rollout = episode.rollout
    return (_slices.collision(rollout).step - rollout.now) * rollout.dt_s


@metric("s", better="lower")
def collision_time_restricted_s(episode: Episode) -> float:
    """Time from the current step to the contact of AV and opponent; the duration of the case where
    they do not collide.

    All attacked scenes count in its mean: a method that only manages early hits looks no better.
    """
    rollout = episode.rollout
    _slices.opponent_row(rollout)
    contact = rollout.first("av_opponent")
    steps = episode.case.duration_steps if contact is None else contact.step - rollout.now
    return steps * rollout.dt_s


@metric("m/s", better="higher")
def collision_speed(episode: Episode) -> float:
    """Length of the difference of the velocities of AV and opponent at the last step before their
    contact.
    """
    return _slices.collision(episode.rollout).relative_mps


@metric("m/s", better="higher")
def collision_speed_difference(episode: Episode) -> float:
    """Difference of the lengths of the velocities of AV and opponent at the last step before their
    contact (the other reading of the paper's relative velocity).
    """
    contact, tracks = _slices.collision(episode.rollout), episode.rollout.tracks
    pair = [tracks.row(contact.first_id), tracks.row(contact.second_id)]
    first, second = tracks.speed_mps[pair, contact.step - 1]
    return abs(float(first - second))


@metric("m/s", better="higher")
def delta_v(episode: Episode) -> float:
    """Change of the AV's velocity in a plastic impact with the opponent, masses proportional to the
    areas of the boxes.
    """
    return _slices.collision(episode.rollout).delta_v_mps


@metric("rad", better="neither")
def pdof(episode: Episode) -> float:
    """Direction from which the force of the impact comes, in the frame of the AV (0 from ahead,
    pi/2 from the left): that of its velocity relative to the opponent at the last step before the
    contact.
    """
    contact, tracks = _slices.collision(episode.rollout), episode.rollout.tracks
    step = contact.step - 1
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    x, y = tracks.velocity_mps[av, step] - tracks.velocity_mps[other, step]
    if np.hypot(x, y) < _LEAST_MPS:
        raise NotMeasurable("AV and opponent touched without relative speed")
    force = float(np.arctan2(y, x))
    return float(frames.difference(force, tracks.heading_rad[av, step]))


@metric("1", better="lower")
def third_party(episode: Episode) -> float:
    """Number of contacts of the opponent with agents other than the AV."""
    _slices.opponent_row(episode.rollout)
    return sum(contact.kind == "opponent_other" for contact in episode.rollout.contacts)


@metric("1", better="neither")
def av_third_party(episode: Episode) -> float:
    """Number of contacts of the AV with agents other than the opponent."""
    return sum(contact.kind == "av_other" for contact in episode.rollout.contacts)


@metric("1", better="higher")
def valid_collision(episode: Episode) -> float:
    """1 if AV and opponent collided, neither hit another agent before, the opponent drove within
    the limits of a car and did not leave the road, and a reference driver would have avoided the
    collision; else 0.

    A miss counts 0: the mean is a rate over attacked scenes, like that of `collision`.
    """
    if not collision_clean.compute(episode):
        return 0.0
    try:
        possible = bool(feasible.compute(episode))
    except NotMeasurable:  # the policy never drove the opponent: nothing to check
        possible = True
    return judgement(episode).avoidable and possible and not _leaves_road(episode)


def _leaves_road(episode: Episode) -> bool:
    """Whether the opponent leaves the road while the policy drives it."""
    rollout, row = episode.rollout, _slices.opponent_row(episode.rollout)
    places = _slices.places(rollout, (row, _slices.driven(rollout, row)))
    inside = road.on_road(episode.case.road, *places)
    return bool((~inside & np.maximum.accumulate(inside)).any())


@metric("number", better="neither")
def accident_type(episode: Episode) -> float:
    """0 cut-in, 1 rear-end, 2 T-bone, 3 head-on, 4 sideswipe: ends (front or rear) or sides of the
    AV meet the other; headings parallel within 45 degrees (sides: 30), else a T-bone; ends:
    rear-end or head-on, sides: sideswipe; cut-in: a rear-end collision whose one in front was
    entirely beside the path of the other within the 3 s before.

    `ACCIDENT_TYPES` has the names; count the numbers, do not average them.
    """
    return ACCIDENT_TYPES.index(accident_type_of(episode.rollout))


def accident_type_of(rollout: Rollout) -> AccidentType:
    """Name of the collision of AV and opponent. Raises NotMeasurable if there was none.

    Headings at the contact are parallel within 45 degrees for an impact of ends, and within 30 for
    one of sides; otherwise it is a T-bone. In the same direction an impact of ends is a cut-in if
    the vehicle in front was entirely beside the other's path within the 3 s before, else a rear-end
    collision; in opposite directions it is head-on. Impacts of sides are sideswipes.
    """
    contact = _slices.collision(rollout)
    tracks, step = rollout.tracks, contact.step - 1
    rows = [tracks.row(contact.first_id), tracks.row(contact.second_id)]
    turn = abs(float(frames.difference(contact.pose_second[2], contact.pose_first[2])))
    position, heading = tracks.position_m[rows, step], tracks.heading_rad[rows, step].tolist()
    size = tracks.size_m[rows, :2]
    of_ends = boxes.end_to_end(position[0], heading[0], size[0], position[1], heading[1], size[1])
    if min(turn, np.pi - turn) > (_PARALLEL_ENDS_RAD if of_ends else _PARALLEL_SIDES_RAD):
        return "t_bone"
    if not of_ends:
        return "sideswipe"
    if turn > np.pi / 2:
        return "head_on"
    ahead = frames.to_local(position[1], position[0], heading[0])[0]
    follower, leader = rows if ahead > 0 else rows[::-1]
    beside = came_from_beside(tracks, follower, leader, contact.step, rollout.dt_s)
    return "cut_in" if beside else "rear_end"


def came_from_beside(
    tracks: Tracks, follower: int, leader: int, step: int, dt_s: float = DT_S
) -> bool:
    """Whether the leader was entirely beside the follower's path at a time of the last 3 s."""
    first = max(0, step - round(CUT_IN_S / dt_s))
    recent = tracks.position_m[leader, first:step]
    recent = recent[tracks.valid[leader, first:step]]
    apart = np.abs(polylines.project(_path(tracks, follower, step), recent).left_m)
    return bool((apart > (tracks.size_m[follower, 1] + tracks.size_m[leader, 1]) / 2).any())


def _path(tracks: Tracks, row: int, step: int) -> Floats:
    """(P, 2) the path that an agent drove up to a step, extended straight at both ends."""
    steps = np.flatnonzero(tracks.valid[row, :step])
    driven, heading = tracks.position_m[row, steps], tracks.heading_rad[row, steps]
    reach = _STRAIGHT_M * frames.unit(heading[[0, -1]])
    path: Floats = np.concatenate([driven[:1] - reach[:1], driven, driven[-1:] + reach[1:]])
    return path
