"""How the AV drove, among all that was around it and not against the opponent alone.

A hit says little about a planner where few attacks can be avoided. These say how close it came, how
late it braked and which rules it broke in every episode, hit or not.
"""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode, NotMeasurable, driving, metric, once
from deepmf_sumo.judge.metrics._surroundings import CEILING_MPS2, driven_steps
from deepmf_sumo.judge.metrics.conflict import (
    MovingBox,
    braking_to_stay_behind,
    slowing,
    time_to_collision,
)
from deepmf_sumo.scene import Floats, RecordedCase
from deepmf_sumo.scene.geometry import frames, road

CEILING_S: Final = 10.0
"""Of times: what is farther in the future says nothing about the driving."""
_NEAR_M: Final = 150.0
_SLOWS_MPS2: Final = 1.0


class Meetings(NamedTuple):
    """The AV and each agent ahead of it, at each simulated step up to the AV's first contact.

    Attributes:
        ttc_s: (K) until the boxes touch if both keep velocity and heading; inf if they never do.
        gap_s: (K) until the AV, with its velocity and heading, touches the box where it is now.
        braking_mps2: (K) as `conflict.PairedMotion.braking_mps2`.
    """

    ttc_s: Floats
    gap_s: Floats
    braking_mps2: Floats


@once
def meetings(episode: Episode) -> Meetings:
    """Of an episode. Raises NotMeasurable where the AV was not simulated."""
    rollout = episode.rollout
    tracks, me = rollout.tracks, rollout.tracks.row(rollout.av_id)
    steps = np.flatnonzero(driven_steps(rollout))
    found = [Meetings(*(np.empty(0) for _ in Meetings._fields))]
    for row in range(tracks.agents):
        at = steps[tracks.valid[row, steps]] if row != me else steps[:0]
        offset = tracks.position_m[row, at] - tracks.position_m[me, at]
        ahead = (offset * frames.unit(tracks.heading_rad[me, at])).sum(-1)
        at = at[(ahead > 0) & (np.hypot(*offset.T) < _NEAR_M)]
        if len(at):
            brakes = slowing(tracks, row, rollout.dt_s)[at]
            found.append(
                _meeting(MovingBox.of(tracks, me, at), MovingBox.of(tracks, row, at), brakes)
            )
    return Meetings(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _meeting(av: MovingBox, other: MovingBox, slowing_mps2: Floats) -> Meetings:
    ttc = time_to_collision(av, other)
    still = other._replace(velocity_mps=np.zeros_like(other.velocity_mps))
    braking = braking_to_stay_behind(av, other, slowing_mps2, ttc)
    return Meetings(ttc, time_to_collision(av, still), braking)


@metric("s", better="lower")
def av_ttc_min(episode: Episode) -> float:
    """Least time until the AV touches any agent ahead of it if both keep velocity and heading, over
    the simulated steps up to the AV's first contact; at most 10 s, 0 in contact.
    """
    return float(meetings(episode).ttc_s.min(initial=CEILING_S))


@metric("s", better="lower")
def av_time_gap_min(episode: Episode) -> float:
    """Least time until the AV, with its velocity and heading, reaches the place where any agent
    ahead is at that moment, over the simulated steps up to the AV's first contact; at most 10 s.
    """
    return float(meetings(episode).gap_s.min(initial=CEILING_S))


@metric("m/s2", better="higher")
def av_required_braking(episode: Episode) -> float:
    """Largest constant braking, along the heading of the AV and immediately, that keeps it behind
    every agent ahead which keeps its heading and its speed or braking, over the simulated steps up
    to the AV's first contact; at most 10 m/s2 (more than a car can brake), 0 without a collision
    course.
    """
    hardest = float(meetings(episode).braking_mps2.max(initial=0.0))
    return min(hardest, CEILING_MPS2)


@metric("m", better="neither")
def av_progress(episode: Episode) -> float:
    """Distance that the AV drove in the simulated steps, up to its first contact."""
    rollout = episode.rollout
    row, steps = rollout.tracks.row(rollout.av_id), driven_steps(rollout)
    position = rollout.tracks.position_m[row, steps]
    return float(np.hypot(*np.diff(position, axis=0).T).sum())


@metric("m/s", better="higher")
def av_over_limit(episode: Episode) -> float:
    """Largest speed of the AV above the limit of the lane that it is on, over the simulated steps
    up to its first contact; 0 where it keeps all limits. What is faster when the simulation takes
    over slows down with 1 m/s2, and as fast as a recorded AV ever was is allowed.
    """
    rollout = episode.rollout
    tracks, row, steps = rollout.tracks, rollout.tracks.row(rollout.av_id), driven_steps(rollout)
    limit = road.limit_mps(
        episode.case.road,
        tracks.position_m[row, steps],
        tracks.heading_rad[row, steps],
        tracks.z_m[row, steps],
    )
    if np.isnan(limit).all():
        raise NotMeasurable("no limit is known where the AV drove")
    since_s = (np.flatnonzero(steps) - rollout.now) * rollout.dt_s
    begun = tracks.speed_mps[row, rollout.now] - _SLOWS_MPS2 * since_s
    if isinstance(episode.case, RecordedCase):
        log = episode.case.scene.tracks
        mine = log.row(rollout.av_id)
        begun = np.maximum(begun, log.speed_mps[mine, log.valid[mine]].max(initial=0.0))
    over = tracks.speed_mps[row, steps] - np.fmax(limit, begun)
    return max(0.0, float(np.nanmax(np.where(np.isnan(limit), np.nan, over))))


@metric("s", better="higher")
def av_late_at_signal(episode: Episode) -> float:
    """Longest time for which a light had been yellow or red (as far as the simulated steps show)
    when the middle of the AV's front bumper crossed its stop line; 0 without such a line. Of lines
    side by side the least counts.
    """
    rollout = episode.rollout
    if not rollout.signals:
        raise NotMeasurable("the rollout has no states of traffic lights")
    row = rollout.tracks.row(rollout.av_id)
    return driving.late_at_signal_s(rollout, episode.case, row, driven_steps(rollout))
