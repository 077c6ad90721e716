"""The contact of a rollout as a question: the opponent's motion is given, who drives the AV?"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.avoidance.ahead import way_ahead
from deepmf_sumo.avoidance.approach import Approach
from deepmf_sumo.avoidance.onset import onset_step
from deepmf_sumo.avoidance.path import Path
from deepmf_sumo.datatypes import Case, Contact, Floats, Rollout
from deepmf_sumo.geometry import angles

AFTER_S: Final = 4.0
"""How long after the contact no other contact may happen: a car has stopped by then."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encounter:
    """A contact of AV and opponent, laid out on the AV's path. K steps, the first is the current.

    Attributes:
        path: what the AV drove until the contact, then the way it was going to take.
        av_along_m: (K) where the AV was on it; after the contact at constant speed.
        approach: the opponent (N = 1): what it drove until the contact, then what its last plan
            says, then at constant velocity.
        first_step: step of the rollout that is 0 here.
        onset: step here from which the AV may act.
        contact: step here of the contact.
    """

    path: Path
    av_along_m: Floats
    approach: Approach
    first_step: int
    onset: int
    contact: int


def encounter_of(rollout: Rollout, case: Case) -> Encounter | None:
    """The encounter, or None where the AV and the opponent did not touch."""
    hit = rollout.first("av_opponent")
    if hit is None or rollout.opponent_id is None:
        return None
    tracks = rollout.tracks
    av, opponent = tracks.row(rollout.av_id), tracks.row(rollout.opponent_id)
    first = _together_since(rollout, av, opponent, hit)
    steps = slice(first, hit.step + 1)
    path = Path.through(
        tracks.position_m[av, steps],
        tracks.heading_rad[av, steps],
        way_ahead(rollout, case, hit.step),
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
    )


def _together_since(rollout: Rollout, av: int, opponent: int, hit: Contact) -> int:
    """First step from the current one on since which both have been there until the contact."""
    both = rollout.tracks.valid[av] & rollout.tracks.valid[opponent]
    away = np.flatnonzero(~both[: hit.step + 1])
    since = int(away[-1]) + 1 if len(away) else 0
    return min(max(since, rollout.now), hit.step - 1)


def _driven(position_m: Floats, after: int) -> Floats:
    """Arc lengths at the poses (K, 2) driven, and at so many steps after them at constant speed."""
    moved = np.hypot(*np.diff(position_m, axis=0).T)
    rest = np.full(after, moved[-1])
    return np.concatenate([[0.0], np.cumsum(np.concatenate([moved, rest]))])


def _opponent_motion(rollout: Rollout, row: int, first: int, last: int) -> tuple[Floats, Floats]:
    """Positions and headings at the steps first..last."""
    end = int(np.flatnonzero(rollout.tracks.valid[row])[-1]) + 1
    position = rollout.tracks.position_m[row, first:end]
    heading = rollout.tracks.heading_rad[row, first:end]
    if rollout.plans:
        plan = rollout.plans[-1]
        rest = slice(max(0, end - plan.first_step), None)
        position = np.concatenate([position, plan.position_m[rest]])
        heading = np.concatenate([heading, plan.heading_rad[rest]])
    missing = last - first + 1 - len(position)
    if missing > 0:
        step_m = np.hypot(*(position[-1] - position[-2]))
        ahead = step_m * np.arange(1, missing + 1)[:, None]
        position = np.concatenate([position, position[-1] + ahead * angles.unit(heading[-1])])
        heading = np.concatenate([heading, np.full(missing, heading[-1])])
    return position[: last - first + 1], heading[: last - first + 1]
