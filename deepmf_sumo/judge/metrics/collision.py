"""Collisions: time, speed and kind."""

from typing import Final

import numpy as np

from deepmf_sumo.judge.accident_types import ACCIDENT_TYPES, accident_type_of
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, metric
from deepmf_sumo.scene.geometry import frames

_LEAST_MPS: Final = 1e-6


@metric("1", better="higher")
def collision(episode: Episode) -> float:
    """1 where the boxes of AV and opponent overlap at a simulated step, but not since the start,
    since one appeared or since its driver changed; else 0. Its mean is the collision rate.
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
    theirs = [one for one in rollout.contacts if one.kind != "supporter_other"]
    return hit is not None and not any(contact.step < hit.step for contact in theirs)


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


@metric("number", better="neither")
def accident_type(episode: Episode) -> float:
    """0 cut-in, 1 rear-end, 2 T-bone, 3 head-on, 4 sideswipe: ends (front or rear) or sides of the
    AV meet the other; headings parallel within 45 degrees (sides: 30), else a T-bone; ends:
    rear-end or head-on, sides: sideswipe; cut-in: a rear-end collision whose one in front was
    entirely beside the path of the other within the 3 s before.

    `ACCIDENT_TYPES` has the names; count the numbers, do not average them.
    """
    _slices.collision(episode.rollout)
    return ACCIDENT_TYPES.index(accident_type_of(episode.rollout))
