"""The contact of a rollout in the frame of the AV's path, for asking whether the AV can avoid it.

An `Encounter` consists of the AV's path and of the opponent's motion relative to it. Its onset is
the first step at which the AV may react. Third parties are the agents that an evasive manoeuvre
must not hit instead.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.judge.avoidability.av_path import AvPath, route_ahead
from deepmf_sumo.judge.avoidability.counterfactual import Counterfactual, counterfactual
from deepmf_sumo.judge.avoidability.intention import is_person, shown_since
from deepmf_sumo.judge.avoidability.reference_drivers import Approach
from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Case,
    Contact,
    Floats,
    Ints,
    RecordedCase,
    RoadMap,
    Rollout,
    Tracks,
)
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear, off_level

AFTER_S: Final = 4.0
"""Time after the contact in which no other contact may happen: by then a car has stopped."""
DEPARTURE_M: Final = 0.5
_ON_WAY_M: Final = 0.5
"""A road user that is nearer to the way that it takes without the attack is on it."""
_MOVED_M: Final = 0.01
CONFLICT_S: Final = 3.0
_TESTED_S = np.arange(0.0, CONFLICT_S + 0.05, 0.1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encounter:
    """A contact of AV and opponent along the AV's path. K steps, the first is the current one.

    Attributes:
        path: of the AV, as driven until the contact, then its route ahead.
        av_along_m: (K) the AV's arc length on the path; after the contact at constant speed.
        approach: of the opponent (N = 1), as driven until the contact, then by its last plan, then
            at constant velocity.
        first_step: step of the rollout that is step 0 of the encounter.
        onset: step of the encounter from which the AV may react.
        contact: step of the encounter at which they touch.
        opponent_id: the other.
    """

    path: AvPath
    av_along_m: Floats
    approach: Approach
    first_step: int
    onset: int
    contact: int
    opponent_id: AgentId


def encounter_of(rollout: Rollout, case: Case) -> Encounter | None:
    """The encounter, or None if the AV and the opponent did not touch."""
    hit = rollout.first("av_opponent")
    if hit is None or rollout.opponent_id is None:
        return None
    tracks = rollout.tracks
    av, opponent = tracks.row(rollout.av_id), tracks.row(rollout.opponent_id)
    first = _together_since(rollout, av, opponent, hit)
    steps = slice(first, hit.step + 1)
    path = AvPath.through(
        tracks.position_m[av, steps],
        tracks.heading_rad[av, steps],
        route_ahead(rollout, case, hit.step),
    )
    after = round(AFTER_S / rollout.dt_s)
    position, heading = _opponent_motion(rollout, opponent, first, hit.step + after)
    return Encounter(
        path=path,
        av_along_m=_driven(tracks.position_m[av, steps], after),
        approach=Approach.of(
            path,
            position[None],
            heading[None],
            tracks.size_m[opponent, :2],
            tracks.size_m[av, :2],
            rollout.dt_s,
        ),
        first_step=first,
        onset=onset_step(rollout, case, opponent, first, hit.step) - first,
        contact=hit.step - first,
        opponent_id=rollout.opponent_id,
    )


def _together_since(rollout: Rollout, av: int, opponent: int, hit: Contact) -> int:
    """First step, at or after the current one, since when both are present until the contact."""
    both = rollout.tracks.valid[av] & rollout.tracks.valid[opponent]
    away = np.flatnonzero(~both[: hit.step + 1])
    since = int(away[-1]) + 1 if len(away) else 0
    return min(max(since, rollout.now), hit.step - 1)


def _driven(position_m: Floats, after: int) -> Floats:
    """Arc lengths at the poses (K, 2) driven, and at ``after`` steps more at constant speed."""
    moved = np.hypot(*np.diff(position_m, axis=0).T)
    rest = np.full(after, moved[-1])
    return np.concatenate([[0.0], np.cumsum(np.concatenate([moved, rest]))])


def _opponent_motion(rollout: Rollout, row: int, first: int, last: int) -> tuple[Floats, Floats]:
    """Positions and headings at the steps first..last."""
    end = int(np.flatnonzero(rollout.tracks.valid[row])[-1]) + 1
    position = rollout.tracks.position_m[row, first:end]
    heading = rollout.tracks.heading_rad[row, first:end]
    plans = rollout.plans_of(rollout.tracks.ids[row])
    if plans:
        plan = plans[-1]
        rest = slice(max(0, end - plan.first_step), None)
        position = np.concatenate([position, plan.position_m[rest]])
        heading = np.concatenate([heading, plan.heading_rad[rest]])
    missing = last - first + 1 - len(position)
    if missing > 0:
        step_m = np.hypot(*(position[-1] - position[-2]))
        ahead = step_m * np.arange(1, missing + 1)[:, None]
        position = np.concatenate([position, position[-1] + ahead * frames.unit(heading[-1])])
        heading = np.concatenate([heading, np.full(missing, heading[-1])])
    return position[: last - first + 1], heading[: last - first + 1]


def onset_step(rollout: Rollout, case: Case, opponent: int, first: int, contact: int) -> int:
    """First step of first..contact - 1 with a sign of the attack; ``first`` without a sign.

    A sign is that the opponent is more than 0.5 m from its position without the attack
    (`counterfactual`), or that the two would collide within 3 s at constant velocities. Of a
    pedestrian or cyclist it is not before the driver understands it (`intention.shown_since`): at
    the latest at the contact.
    """
    alone = counterfactual(rollout, case, rollout.tracks.ids[opponent])
    return onset_of(rollout, alone, opponent, first, contact, case.road)


def onset_of(
    rollout: Rollout, alone: Counterfactual | None, opponent: int, first: int, contact: int,
    road_map: RoadMap | None = None,
) -> int:  # fmt: skip
    """As `onset_step`, where it is known already where the opponent would have been.

    ``road_map``: None where it is not known.
    """
    steps = np.arange(first, contact)
    departed = np.zeros(len(steps), bool)
    if alone is not None:
        where = rollout.tracks.position_m[opponent, first:contact]
        departed = alone.away_m(where, first) > DEPARTURE_M
    signs = np.flatnonzero(departed | _on_course(rollout, opponent, steps))
    sign = int(steps[signs[0]]) if len(signs) else first
    if not is_person(rollout.tracks, opponent):
        return sign
    return max(sign, shown_since(rollout, road_map, opponent, first, contact))


class MovingVehicle(NamedTuple):
    """A vehicle at K moments: (K, 2) position and velocity, (K) heading, (2) length, width."""

    position_m: Floats
    velocity_mps: Floats
    heading_rad: Floats
    size_m: Floats


def on_collision_course(av: MovingVehicle, opponent: MovingVehicle) -> Bools:
    """(K) whether the two boxes overlap within 3 s if both keep velocity and heading."""

    def ahead(one: MovingVehicle) -> tuple[Floats, Floats, Floats]:
        moved = one.velocity_mps[:, None] * _TESTED_S[:, None]
        return one.position_m[:, None] + moved, one.heading_rad[:, None], one.size_m

    return np.asarray(boxes.touching(*ahead(av), *ahead(opponent)).any(axis=1))


def _on_course(rollout: Rollout, opponent: int, steps: Ints) -> Bools:
    """(K) `on_collision_course` of AV and opponent at the steps, on one level."""
    tracks, av = rollout.tracks, rollout.tracks.row(rollout.av_id)
    first, second = (
        MovingVehicle(
            tracks.position_m[row, steps],
            tracks.velocity_mps[row, steps],
            tracks.heading_rad[row, steps],
            tracks.size_m[row, :2],
        )
        for row in (av, opponent)
    )
    level = ~clear(tracks.z_m[av, steps], tracks.z_m[opponent, steps])
    return on_collision_course(first, second) & level


class ThirdParties(NamedTuple):
    """B agents over K steps: (B, K, 2) position, (B, K) heading and presence, (B, 2) size."""

    position_m: Floats
    heading_rad: Floats
    valid: Bools
    size_m: Floats


def third_parties_of(
    rollout: Rollout, case: Case, first: int, steps: int, only: Collection[AgentId] | None = None
) -> ThirdParties:
    """Agents but AV and opponent, from a step of the rollout on, on the AV's level.

    Of these ``only`` some; None: all.

    They move as simulated until the rollout ends; then as recorded, if the recording drives the
    traffic and they do not support the attack; else at their last speed, on the way that they take
    without the attack where they still are on it, or straight on.
    """
    tracks = rollout.tracks
    wanted = {*(tracks.ids if only is None else only)} - {rollout.av_id, rollout.opponent_id}
    rows = [row for row, name in enumerate(tracks.ids) if name in wanted]
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
    found = ThirdParties(position, heading, valid, tracks.size_m[rows, :2])
    if isinstance(case, RecordedCase) and case.traffic == "log":
        astray = rollout.supporters
        ids = [None if (name := tracks.ids[row]) in astray else name for row in rows]
        _as_recorded(found, ids, case.scene.tracks, first, known)
    elif case.unattacked is not None:
        gone_m = np.hypot(*velocity.T)[:, None] * after
        names = [tracks.ids[row] for row in rows]
        _on_their_way(found, names, case.unattacked, gone_m, known)
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


def _as_recorded(
    found: ThirdParties, ids: Sequence[str | None], recorded: Tracks, first: int, known: int
) -> None:
    """Replace motion at constant velocity by recorded poses, where they exist; None: by none."""
    begin, end = first + known, min(first + found.valid.shape[1], recorded.steps)
    if end <= begin:
        return
    rows = [
        (mine, recorded.row(name))
        for mine, name in enumerate(ids)
        if name is not None and name in recorded.ids
    ]
    if not rows:
        return
    mine, theirs = np.array(rows).T
    here, there = slice(known, known + end - begin), slice(begin, end)
    found.position_m[mine, here] = recorded.position_m[theirs, there]
    found.heading_rad[mine, here] = recorded.heading_rad[theirs, there]
    found.valid[mine, here] = recorded.valid[theirs, there]


def _on_their_way(
    found: ThirdParties, ids: Sequence[AgentId], alone: Tracks, gone_m: Floats, known: int
) -> None:
    """Replace straight motion after ``known`` steps, by (B, K') metres, where the way bends."""
    for one, name in enumerate(ids):
        if name not in alone.ids or not found.valid[one, known - 1]:
            continue
        there = alone.row(name)
        way = alone.position_m[there][alone.valid[there]]
        way = way[np.r_[True, np.hypot(*np.diff(way, axis=0).T) > _MOVED_M]] if len(way) else way
        if len(way) < 2:
            continue
        foot = polylines.project(way, found.position_m[one, known - 1])
        if float(foot.distance_m) < _ON_WAY_M:
            place, heading = polylines.points_at(way, float(foot.along_m) + gone_m[one])
            found.position_m[one, known:], found.heading_rad[one, known:] = place, heading


def hit_by(
    centre_m: Floats, heading_rad: Floats, others: ThirdParties, av_size_m: Floats, stays: Bools
) -> Bools:
    """(M) whether AV boxes (M, K, 2), (M, K) hit a third party.

    An agent that overlaps the AV at the first step is left out: its recorded position is wrong. An
    agent that is behind the AV when it appears does not count against an AV that ``stays`` (M) on
    its path and brakes: recorded followers do not brake, real ones would.
    """
    hit = np.zeros(len(centre_m), bool)
    reach = (np.hypot(*av_size_m) + np.hypot(*others.size_m.T)) / 2
    low = centre_m.min(axis=(0, 1)) - reach[:, None]
    high = centre_m.max(axis=(0, 1)) + reach[:, None]
    inside = ((others.position_m >= low[:, None]) & (others.position_m <= high[:, None])).all(-1)
    for other in np.flatnonzero((inside & others.valid).any(axis=1)):
        size, where = others.size_m[other], others.position_m[other]
        seen = int(others.valid[other].argmax())
        offset, course = where[seen] - centre_m[:, seen], heading_rad[:, seen]
        ahead = (offset * frames.unit(course)).sum(-1) > -av_size_m[0] / 2
        rows = np.flatnonzero(~hit & (ahead | ~stays))
        steps = np.flatnonzero(inside[other] & others.valid[other])
        overlaps = boxes.touching(
            centre_m[np.ix_(rows, steps)],
            heading_rad[np.ix_(rows, steps)],
            av_size_m,
            where[steps],
            others.heading_rad[other, steps],
            size,
        )
        if len(steps) and steps[0] == 0 and overlaps[:, 0].any():
            continue
        hit[rows] |= overlaps.any(axis=1)
    return hit
