"""AV and opponent over time: how near, how soon, how hard to avoid."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import Floats, Ints, Rollout
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import clear, distance_m
from deepmf_sumo.metrics.episode import conflict, parts

NEVER_TOGETHER = "AV and opponent were never there together"
REACTION_S = 1.0
"""What a driver has to do is judged up to so long before a contact: then it is too late anyway."""
TOO_SOON = f"AV and opponent collided within {REACTION_S:g} s"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conflict:
    """AV and opponent at the K simulated steps at which both are there.

    Attributes:
        step: (K) of the rollout. time_s: (K) since the current step.
        gap_m: (K) between the boxes; a difference in height counts beyond 2.5 m.
        ttc_s: (K) until the boxes touch if both keep velocity and heading; inf where they do not,
            or one passes over the other.
        drac_mps2: (K) relative speed over twice the time to collision; 0 off a collision course,
            inf in contact. Of a follower and its leader this is (speed difference)^2 / (2 gap).
        braking_mps2: (K) least constant braking, along the AV's heading and at once, that keeps the
            AV behind an opponent which keeps its heading and its speed, or its braking; 0 off a
            collision course, inf where no braking is enough.
    """

    step: Ints
    time_s: Floats
    gap_m: Floats
    ttc_s: Floats
    drac_mps2: Floats
    braking_mps2: Floats


def over_time(rollout: Rollout) -> Conflict | str:
    """The series of one rollout, or the reason why there is none."""
    row = parts.opponent_row(rollout)
    if row is None:
        return parts.NO_OPPONENT
    av, together = parts.together(rollout, row)
    step = np.flatnonzero(together)
    if not len(step):
        return NEVER_TOGETHER
    tracks = rollout.tracks
    me = conflict.Moving.of(tracks, av, step)
    other = conflict.Moving.of(tracks, row, step)
    ttc = conflict.time_to_collision(me, other)
    relative = np.hypot(*(me.velocity_mps - other.velocity_mps).T)
    slowing = conflict.slowing(tracks, row, rollout.dt_s)[step]
    drac = np.divide(relative, 2 * ttc, out=np.full_like(ttc, np.inf), where=ttc > 0)
    gap = boxes.gap(
        me.position_m,
        me.heading_rad,
        me.size_m,
        other.position_m,
        other.heading_rad,
        other.size_m,
    )
    return Conflict(
        step=step,
        time_s=np.asarray((step - rollout.now) * rollout.dt_s, float),
        gap_m=distance_m(gap, me.z_m, other.z_m),
        ttc_s=ttc,
        drac_mps2=drac,
        braking_mps2=conflict.braking_to_stay_behind(me, other, slowing, ttc),
    )


def in_time(rollout: Rollout) -> Conflict | str:
    """The series up to 1 s before the contact, to its end where there is none."""
    found, hit = over_time(rollout), rollout.first("av_opponent")
    if isinstance(found, str) or hit is None:
        return found
    early = found.step <= hit.step - round(REACTION_S / rollout.dt_s)
    if not early.any():
        return TOO_SOON
    return Conflict(
        step=found.step[early],
        time_s=found.time_s[early],
        gap_m=found.gap_m[early],
        ttc_s=found.ttc_s[early],
        drac_mps2=found.drac_mps2[early],
        braking_mps2=found.braking_mps2[early],
    )


def encroachment_s(rollout: Rollout) -> float | str:
    """Least time between AV and opponent being at one place, or the reason why there is none.

    Over all pairs of steps at which the AV's box at one and the opponent's box at the other
    overlap: 0 in contact.
    """
    row = parts.opponent_row(rollout)
    if row is None:
        return parts.NO_OPPONENT
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    later = np.arange(tracks.steps) > rollout.now
    mine, theirs = (np.flatnonzero(tracks.valid[one] & later) for one in (av, row))
    shared = boxes.overlap(
        tracks.position_m[av, mine, None],
        tracks.heading_rad[av, mine, None],
        tracks.size_m[av, :2],
        tracks.position_m[row, theirs],
        tracks.heading_rad[row, theirs],
        tracks.size_m[row, :2],
    )
    shared &= ~clear(tracks.z_m[av, mine, None], tracks.z_m[row, theirs])
    if not shared.any():
        return "AV and opponent came over no common place"
    return float(np.abs(mine[:, None] - theirs)[shared].min()) * rollout.dt_s
