"""Everybody else: whom an evasive manoeuvre must not hit instead."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.avoidance.manoeuvres import GRID, Driven
from deepmf_sumo.datatypes import Bools, Case, Floats, Rollout
from deepmf_sumo.geometry import angles
from deepmf_sumo.geometry.ground import off_level
from deepmf_sumo.geometry.touching import touching


class Bystanders(NamedTuple):
    """B agents over K steps: (B, K, 2) position, (B, K) heading and presence, (B, 2) size."""

    position_m: Floats
    heading_rad: Floats
    valid: Bools
    size_m: Floats


def bystanders_of(rollout: Rollout, case: Case, first: int, steps: int) -> Bystanders:
    """All agents but AV and opponent, from a step of the rollout on, on the AV's level.

    As simulated while the rollout lasts; then as recorded, if the recording drove them, else at
    the velocity that they had at its end.
    """
    tracks = rollout.tracks
    rows = [
        r for r, name in enumerate(tracks.ids) if name not in {rollout.av_id, rollout.opponent_id}
    ]
    known = min(tracks.steps - first, steps)
    shown = slice(first, first + known)
    position = np.zeros((len(rows), steps, 2))
    heading, valid = np.zeros((len(rows), steps)), np.zeros((len(rows), steps), bool)
    position[:, :known] = tracks.position_m[rows, shown]
    heading[:, :known] = tracks.heading_rad[rows, shown]
    valid[:, :known] = tracks.valid[rows, shown]
    after = np.arange(1, steps - known + 1) * rollout.dt_s
    velocity = tracks.velocity_mps[rows, first + known - 1]
    position[:, known:] = position[:, known - 1 : known] + velocity[:, None] * after[:, None]
    heading[:, known:] = heading[:, known - 1 : known]
    valid[:, known:] = valid[:, known - 1 : known]
    found = Bystanders(position, heading, valid, tracks.size_m[rows, :2])
    if case.scene is not None and case.traffic == "log":
        _as_recorded(found, [tracks.ids[row] for row in rows], case, first, known)
    av = tracks.row(rollout.av_id)
    heights = np.repeat(tracks.z_m[rows, first + known - 1, None], steps, axis=1)
    heights[:, :known] = tracks.z_m[rows, shown]
    found.valid[:] &= ~off_level(
        case.road,
        tracks.position_m[av, first],
        float(tracks.z_m[av, first]),
        found.position_m.reshape(-1, 2),
        heights.reshape(-1),
    ).reshape(found.valid.shape)
    return found


def _as_recorded(found: Bystanders, ids: list[str], case: Case, first: int, known: int) -> None:
    """Put what the recording says in the place of constant velocities, where it says something."""
    assert case.scene is not None
    recorded = case.scene.tracks
    begin, end = first + known, min(first + found.valid.shape[1], recorded.steps)
    if end <= begin:
        return
    rows = [(mine, recorded.row(name)) for mine, name in enumerate(ids) if name in recorded.ids]
    if not rows:
        return
    mine, theirs = np.array(rows).T
    here, there = slice(known, known + end - begin), slice(begin, end)
    found.position_m[mine, here] = recorded.position_m[theirs, there]
    found.heading_rad[mine, here] = recorded.heading_rad[theirs, there]
    found.valid[mine, here] = recorded.valid[theirs, there]


def hit_by(driven: Driven, others: Bystanders, av_size_m: Floats) -> Bools:
    """(M) whether a manoeuvre of `manoeuvres.GRID` hits a bystander.

    Who overlaps the AV at the first step is left out: they do not stand where the data says. Who
    is behind it when they are there first does not count against braking alone: recorded followers
    do not brake, others would.
    """
    hit = np.zeros(len(driven.holds), bool)
    straight = GRID.lateral_mps2 == 0
    reach = (np.hypot(*av_size_m) + np.hypot(*others.size_m.T)) / 2
    low = driven.centre_m.min(axis=(0, 1)) - reach[:, None]
    high = driven.centre_m.max(axis=(0, 1)) + reach[:, None]
    inside = ((others.position_m >= low[:, None]) & (others.position_m <= high[:, None])).all(-1)
    for other in np.flatnonzero((inside & others.valid).any(axis=1)):
        size, where = others.size_m[other], others.position_m[other]
        seen = int(others.valid[other].argmax())
        offset, course = where[seen] - driven.centre_m[:, seen], driven.heading_rad[:, seen]
        ahead = (offset * angles.unit(course)).sum(-1) > -av_size_m[0] / 2
        rows = np.flatnonzero(~hit & (ahead | ~straight))
        steps = np.flatnonzero(inside[other] & others.valid[other])
        overlaps = touching(
            driven.centre_m[np.ix_(rows, steps)],
            driven.heading_rad[np.ix_(rows, steps)],
            av_size_m,
            where[steps],
            others.heading_rad[other, steps],
            size,
        )
        if len(steps) and steps[0] == 0 and overlaps[:, 0].any():
            continue
        hit[rows] |= overlaps.any(axis=1)
    return hit
