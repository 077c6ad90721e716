"""The cause of a hit: the smallest change of the AV that would have avoided it.

The opponent keeps its path, and the AV, on its own path, is changed one thing at a time. A change
avoids the hit if nothing touches the AV until 4 s after it, and no third party that is known. The
changes have an order, and the first that avoids the hit is its cause:

1. What the rules of the road ask of every driver before there is a danger: it asks for no effort,
   only for patience. It stops at the light, stays in its lane, waits for the gap, keeps to the
   limit, keeps its distance; and it does not brake in front of a vehicle behind it.
2. What a reference driver does once there is a danger, the milder first: it brakes on, where it
   accelerated again on a course to the collision, brakes up to 4 m/s2 (comfortable), reacts 0.5 s
   earlier, brakes up to 6 m/s2 (as hard as two of the three reference drivers), reacts 1 s earlier;
   an AV that never braked reacts at all. No reaction comes sooner than 0.75 s after the onset,
   which is the drivers' own.
3. More than drivers do: a reaction sooner than that, braking up to 8 m/s2 (grip), and 2 s of
   distance where the AV kept 0.9 s or more, as most drivers do.
4. It drives 20 % slower. Driving at the limit is not an error, and a later AV also avoids by chance
   what crosses its path.
5. Another driver takes over at the onset: a reference driver sees the danger, or a manoeuvre that
   starts without delay evades it.

An AV that never braked has no reaction that could begin earlier; then its reaction is the stop of
the careful driver (0.75 s after the onset, up to 7.6 m/s2).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from deepmf_sumo.judge.accident_types import CUT_IN_S
from deepmf_sumo.judge.avoidability import reference_drivers
from deepmf_sumo.judge.avoidability.av_path import AvPath, along_lanes
from deepmf_sumo.judge.avoidability.encounter import (
    Encounter,
    MovingVehicle,
    ThirdParties,
    encounter_of,
    hit_by,
    on_collision_course,
    third_parties_of,
)
from deepmf_sumo.judge.avoidability.grading import Judgement, evasive_manoeuvres
from deepmf_sumo.judge.avoidability.intention import is_person, models_for
from deepmf_sumo.judge.avoidability.manoeuvres import Drive
from deepmf_sumo.judge.avoidability.reference_drivers import DELAY_S
from deepmf_sumo.judge.hits import Hit, hit_of
from deepmf_sumo.judge.metrics import Episode, once
from deepmf_sumo.judge.metrics.avoidability import judgement
from deepmf_sumo.judge.metrics.driving import crossed_late, may_turn_on_red
from deepmf_sumo.scene import Floats
from deepmf_sumo.scene.geometry import boxes, frames, road

Change = Literal[
    "stops at the light", "stays in its lane", "waits for the gap", "keeps to the limit",
    "keeps its distance", "does not brake", "brakes on", "reacts 0.5 s earlier",
    "reacts 1 s earlier", "brakes harder", "reacts", "drives 20 % slower", "sees the danger",
    "evades", "none",
]  # fmt: skip
CHANGES: Final[tuple[Change, ...]] = get_args(Change)

TIME_GAP_S: Final = 2.0
CLOSE_S: Final = 0.9
"""Less is fined (in Germany from 0.9 s downwards); 1 to 2 s are usual."""
SLOWER: Final = 0.8
BRAKING_MPS2: Final = (4.0, 6.0, 8.0)
_MARGIN_M: Final = 1.0
"""Between the AV that waits and what passes in front of it."""
_STATION_M: Final = 0.25
_REACHES_M: Final = 10.0
"""So far beyond the contact the conflict area is looked for."""
_PHANTOM_S: Final = 2.0
"""Braking this long before the onset may be what the vehicle behind has to answer."""
_LEADS_MPS: Final = 1.0
"""A slower vehicle is no leader to keep a distance from: it stands in the way."""
_BEYOND: Final = 10
"""In the order: after all that reference drivers do."""
_OVER_LIMIT: Final = 1.05
"""A speedometer shows no less."""
_HARDER_MPS2: Final = 0.5
"""Braking that is harder by less is the same."""
_WAITING: Final = {"merging", "lane change"}


class Tried(NamedTuple):
    """A change at its place in the order, what it asks of the AV, and (K) arc lengths on a path."""

    place: int
    change: Change
    what: str
    along_m: Floats
    path: AvPath


_Found = tuple[int, Change, str, Floats | None]
"""As `Tried`, on the AV's own path; no arc lengths where the change does not apply."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """The smallest change of the AV that avoids a hit.

    Attributes:
        change: its name; "none" if no change avoids it.
        what: it asks of the AV: "to wait for the gap".
        last_moment_s: name of a reference driver or "search" -> how long before the hit it had to
            take over at the latest to avoid it; None where no moment was early enough.
        changes: each change that applies -> whether it avoids the hit.
    """

    change: Change
    what: str
    last_moment_s: dict[str, float | None]
    changes: dict[str, bool]


@once
def cause_of(episode: Episode) -> Cause | None:
    """The cause of a hit; None for a miss."""
    encounter, hit = encounter_of(episode.rollout, episode.case), hit_of(episode)
    if encounter is None or hit is None:
        return None
    steps = encounter.approach.steps
    others = third_parties_of(episode.rollout, episode.case, encounter.first_step, steps)
    judged: list[tuple[Change, str, bool]] = [
        (one.change, one.what, _avoids(encounter, others, one))
        for one in _tried(episode, encounter, hit)
    ]
    judged += _by_others(judgement(episode))
    change, what = next(((name, what) for name, what, avoids in judged if avoids), ("none", ""))
    names = dict.fromkeys(name for name, _, _ in judged)
    return Cause(
        change=change,
        what=what,
        last_moment_s=last_moments_s(episode, encounter),
        changes={name: any(ok for one, _, ok in judged if one == name) for name in names},
    )


def _avoids(encounter: Encounter, others: ThirdParties, tried: Tried) -> bool:
    """Whether nothing touches the AV, up to 4 s after the hit."""
    approach = encounter.approach
    centre, heading = (each[None] for each in tried.path.at(tried.along_m))
    if reference_drivers.overlaps(approach, centre, heading).any():
        return False
    return not hit_by(centre, heading, others, approach.av_size_m, np.ones(1, bool)).any()


def _tried(episode: Episode, encounter: Encounter, hit: Hit) -> list[Tried]:
    """The changes that apply, in their order."""
    drive = Drive(
        along_m=encounter.av_along_m,
        onset=encounter.onset,
        contact=encounter.contact,
        dt_s=episode.rollout.dt_s,
    )
    found = [
        Tried(place, change, what, along, encounter.path)
        for place, change, what, along in (
            *_by_rules(episode, encounter, hit, drive),
            *_by_reaction(drive),
            (19, "brakes on", "to go on braking", _on(encounter, drive)),
            (40, "drives 20 % slower", "to drive 20 % slower", drive.slower(SLOWER)),
        )
        if along is not None
    ]
    if hit.conflict == "lane change" and hit.turned == "AV":
        lane = _lane(episode, encounter)
        found.append(Tried(11, "stays in its lane", "to stay in its lane", drive.along_m, lane))
    return sorted(found, key=lambda one: one.place)


def _by_rules(episode: Episode, encounter: Encounter, hit: Hit, drive: Drive) -> Iterator[_Found]:
    """What is asked of the AV before there is a danger."""
    yield (
        10,
        "stops at the light",
        "to stop at the light",
        _at_light(episode, encounter, hit, drive),
    )
    if _has_to_wait(hit):
        entry_m = _entry_m(encounter)
        stop = None if entry_m is None else drive.stopping_before(entry_m - _MARGIN_M)
        yield 12, "waits for the gap", "to wait for the gap", stop
    limit, speed = _limit_mps(episode, encounter), drive.at(drive.onset)
    if speed > _OVER_LIMIT * limit:
        what = f"to keep to the limit of {limit:.1f} m/s (it drove at {speed:.1f} m/s)"
        yield 13, "keeps to the limit", what, drive.slower(limit / speed)
    gap_m = _following_m(encounter)
    if gap_m is not None and gap_m < TIME_GAP_S * speed:
        what = f"to keep a time gap of {TIME_GAP_S:.0f} s (it kept {gap_m / speed:.1f} s)"
        place = 14 if gap_m < CLOSE_S * speed else 33
        yield place, "keeps its distance", what, drive.farther_back(TIME_GAP_S * speed - gap_m)
    since = drive.braking_from(drive.onset - round(_PHANTOM_S / drive.dt_s))
    if hit.conflict == "rear-end" and hit.side == "behind" and since is not None:
        yield 15, "does not brake", "not to brake", drive.not_braking(since)


def _by_reaction(drive: Drive) -> Iterator[_Found]:
    """What is asked of the AV once there is a danger."""
    earlier: tuple[tuple[int, float, Change], ...] = (
        (21, 0.5, "reacts 0.5 s earlier"), (23, 1.0, "reacts 1 s earlier"),
    )  # fmt: skip
    for place, by_s, name in earlier:
        begun_s = ((drive.reaction or 0) - drive.onset) * drive.dt_s - by_s
        beyond = _BEYOND if begun_s < DELAY_S - drive.dt_s / 2 else 0
        yield place + beyond, name, f"to react {by_s:g} s earlier", drive.reacting_earlier(by_s)
    for place, hardest in zip((20, 22, 31), BRAKING_MPS2, strict=True):
        if drive.braking_mps2 + _HARDER_MPS2 <= hardest:
            what = f"to brake with {hardest:.0f} m/s2 instead of {drive.braking_mps2:.0f}"
            yield place, "brakes harder", what, drive.braking_harder(hardest)
    what = f"to brake fully {DELAY_S:g} s after the danger showed"
    yield 24, "reacts", what, drive.reacting()


def _by_others(judged: Judgement) -> Iterator[tuple[Change, str, bool]]:
    """Other drivers in the AV's place, from the onset on."""
    names = ", ".join(name for name, avoids in judged.avoided_by.items() if avoids)
    what = f"to brake as a reference driver ({names}) does from the first sign of danger on"
    yield "sees the danger", what, bool(names)
    yield (
        "evades",
        "to brake or steer immediately at the first sign of danger",
        judged.manoeuvres > 0,
    )


def _at_light(episode: Episode, encounter: Encounter, hit: Hit, drive: Drive) -> Floats | None:
    """(K) arc lengths of the AV that stops where its light was yellow or red.

    None where it was not, where it may turn on red, or no comfortable stop was possible once it had
    left green.
    """
    rollout, first = episode.rollout, encounter.first_step
    if not rollout.signals or may_turn_on_red(episode.case, hit.meeting.turn_rad(0)):
        return None
    steps = np.arange(rollout.tracks.steps)
    seen = (steps > max(first, rollout.now)) & (steps <= first + encounter.contact)
    late = crossed_late(rollout, episode.case, hit.meeting.av, seen)
    if not late:
        return None
    crossed = max(late)
    before_m = float(encounter.av_along_m[crossed - 1 - first])
    return drive.stopping_before(before_m, max(0, crossed - late[crossed] - first))


def _on(encounter: Encounter, drive: Drive) -> Floats | None:
    """(K) arc lengths of the AV that brakes on; None where no collision showed when it ceased."""
    if drive.release is None:
        return None
    at, approach = slice(drive.release, drive.release + 1), encounter.approach
    centre, heading = encounter.path.at(encounter.av_along_m[at])
    velocity = drive.at(drive.release) * frames.unit(heading)
    av = MovingVehicle(centre, velocity, heading, approach.av_size_m)
    opponent = MovingVehicle(
        approach.position_m[0, at], approach.velocity_mps[0, at], approach.heading_rad[0, at],
        approach.size_m,
    )  # fmt: skip
    return drive.braking_on() if on_collision_course(av, opponent).any() else None


def _has_to_wait(hit: Hit) -> bool:
    """Whether the other goes first where the two meet."""
    if hit.av_crosses:
        return True
    if hit.strayed or hit.conflict in {"rear-end", "head-on"}:
        return False
    return hit.priority == "opponent" or (
        not hit.priority and hit.turned == "AV" and hit.conflict in _WAITING
    )


def _entry_m(encounter: Encounter) -> float | None:
    """Arc length at which the AV's box comes into what the opponent's box sweeps.

    None if it is there from the start.
    """
    approach = encounter.approach
    first, last = encounter.av_along_m[[0, encounter.contact]]
    stations = np.arange(first, last + _REACHES_M, _STATION_M)
    centre, heading = encounter.path.at(stations)
    swept = boxes.touching(
        centre[:, None],
        heading[:, None],
        approach.av_size_m,
        approach.position_m[0],
        approach.heading_rad[0],
        approach.size_m,
    ).any(axis=1)
    inside = np.flatnonzero(swept)
    return float(stations[inside[0]]) if len(inside) and inside[0] > 0 else None


def _following_m(encounter: Encounter) -> float | None:
    """The gap at the onset to the opponent that drives ahead on the AV's path; None if not so."""
    approach, at = encounter.approach, (0, encounter.onset)
    front_m = float(encounter.av_along_m[encounter.onset] + approach.av_size_m[0] / 2)
    gap_m = float(approach.rear_m[at]) - front_m
    leads = approach.parallel[at] and approach.along_mps[at] > _LEADS_MPS
    return gap_m if leads and approach.clearance_m[at] < 0 and gap_m > 0 else None


def _limit_mps(episode: Episode, encounter: Encounter) -> float:
    """The speed limit where the AV was at the onset; inf where none is known."""
    tracks, row = episode.rollout.tracks, episode.rollout.tracks.row(episode.rollout.av_id)
    at = slice(step := encounter.first_step + encounter.onset, step + 1)
    limit = road.limit_mps(
        episode.case.road, tracks.position_m[row, at], tracks.heading_rad[row, at],
        tracks.z_m[row, at],
    )  # fmt: skip
    return float(np.nan_to_num(limit[0], nan=np.inf))


def _lane(episode: Episode, encounter: Encounter) -> AvPath:
    """The AV's path if it follows the lane on which it was 3 s before the contact."""
    tracks, row = episode.rollout.tracks, episode.rollout.tracks.row(episode.rollout.av_id)
    back = round(CUT_IN_S / episode.rollout.dt_s)
    begin = encounter.first_step + max(encounter.contact - back, 0)
    driven = slice(encounter.first_step, begin + 1)
    lane = along_lanes(
        episode.case.road,
        tracks.position_m[row, begin],
        float(tracks.heading_rad[row, begin]),
        float(tracks.z_m[row, begin]),
    )
    return AvPath.through(tracks.position_m[row, driven], tracks.heading_rad[row, driven], lane)


def last_moments_s(episode: Episode, encounter: Encounter) -> dict[str, float | None]:
    """For each reference driver and the search: the last moment to take over, before the hit.

    None where there is none; nobody takes over for a person before the onset.
    """
    tracks, starts = episode.rollout.tracks, np.arange(encounter.contact)
    opponent = tracks.row(encounter.opponent_id)
    models, person = models_for(tracks, opponent), is_person(tracks, opponent)
    approach = encounter.approach.among(np.zeros(len(starts), np.int64))
    outcome = reference_drivers.outcome(
        list(models.values()), encounter.path, approach, encounter.av_along_m, starts
    )
    able = outcome.avoided | outcome.standing if person else outcome.avoided
    last = {
        name: starts[avoided][-1] if avoided.any() else None
        for name, avoided in zip(models, able, strict=True)
    }
    last["search"] = _last_evasion(episode, encounter)
    dt_s, hit = episode.rollout.dt_s, encounter.contact
    earliest = encounter.onset if person else 0
    return {
        name: None if step is None or step < earliest else round((hit - int(step)) * dt_s, 3)
        for name, step in last.items()
    }


def _last_evasion(episode: Episode, encounter: Encounter) -> int | None:
    """The last step at which a manoeuvre of the search avoids the hit, by halving.

    None if there is none; who can avoid it later can avoid it earlier as well.
    """

    def avoids(step: int) -> bool:
        at = replace(encounter, onset=step)
        return bool(evasive_manoeuvres(at, episode.rollout, episode.case).any())

    early, late = 0, encounter.contact
    if not avoids(early):
        return None
    while late - early > 1:
        middle = (early + late) // 2
        early, late = (middle, late) if avoids(middle) else (early, middle)
    return early
