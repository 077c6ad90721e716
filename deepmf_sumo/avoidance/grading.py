"""Grades of contacts: whether nobody, a machine, some or all reference drivers had avoided them."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

from deepmf_sumo.avoidance import braking, drivers, manoeuvres
from deepmf_sumo.avoidance.bystanders import bystanders_of, hit_by
from deepmf_sumo.avoidance.encounter import Encounter, encounter_of
from deepmf_sumo.avoidance.lanes import stays_on_road
from deepmf_sumo.datatypes import Bools, Case, Rollout

Grade = Literal["A", "B", "C", "D"]
GRADES: Final[tuple[Grade, ...]] = ("A", "B", "C", "D")
"""A: unavoidable. B: physically avoidable, but by no driver. C: by one at least. D: by all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """Who would have avoided a contact.

    Attributes:
        avoided_by: name of each of `drivers.MODELS` -> whether that driver would.
        standing: the same -> whether the opponent runs into that driver's car, which has stopped.
        manoeuvres: how many of `manoeuvres.GRID` would, begun at the onset.
        onset_step, contact_step: of the rollout.
    """

    avoided_by: dict[str, bool]
    standing: dict[str, bool]
    manoeuvres: int
    onset_step: int
    contact_step: int

    @property
    def physically(self) -> bool:
        """Whether there was any way out."""
        return self.manoeuvres > 0 or any(self.avoided_by.values())

    @property
    def avoidable(self) -> bool:
        """Whether one of the drivers would have avoided the contact: grade C or D."""
        return any(self.avoided_by.values())

    @property
    def hit_standing(self) -> bool:
        """Whether no driver avoids the contact, but one has stopped before it."""
        return not self.avoidable and any(self.standing.values())

    @property
    def grade(self) -> Grade:
        """See `GRADES`."""
        if all(self.avoided_by.values()):
            return "D"
        if self.avoidable:
            return "C"
        return "B" if self.physically else "A"


@lru_cache(maxsize=2)  # several metrics ask for the same rollout in turn
def judge(rollout: Rollout, case: Case) -> Judgement | None:
    """The judgement, or None where AV and opponent did not touch."""
    encounter = encounter_of(rollout, case)
    if encounter is None:
        return None
    outcome = braking.outcome(
        list(drivers.MODELS.values()),
        encounter.path,
        encounter.approach,
        encounter.av_along_m,
        encounter.onset,
    )
    return Judgement(
        avoided_by={name: bool(outcome.avoided[d, 0]) for d, name in enumerate(drivers.MODELS)},
        standing={name: bool(outcome.standing[d, 0]) for d, name in enumerate(drivers.MODELS)},
        manoeuvres=int(ways_out(encounter, rollout, case).sum()),
        onset_step=encounter.first_step + encounter.onset,
        contact_step=encounter.first_step + encounter.contact,
    )


def ways_out(encounter: Encounter, rollout: Rollout, case: Case) -> Bools:
    """(M) which of `manoeuvres.GRID` avoid the contact, hit nobody else, and keep to the road."""
    approach, start = encounter.approach, encounter.onset
    steps = approach.steps - start
    driven = manoeuvres.drive(encounter.path, encounter.av_along_m[start:], rollout.dt_s)
    hit = braking.met(approach.since(start), driven.centre_m, driven.heading_rad).any(axis=1)
    free = driven.holds & ~hit
    free &= stays_on_road(
        case.road,
        encounter.path,
        driven.along_m,
        driven.left_m,
        approach.av_size_m[1] / 2,
        float(rollout.tracks.z_m[rollout.tracks.row(rollout.av_id), encounter.first_step + start]),
    )
    if free.any():
        first = encounter.first_step + start
        others = bystanders_of(rollout, case, first, steps)
        free &= ~hit_by(driven, others, approach.av_size_m)
    return free
