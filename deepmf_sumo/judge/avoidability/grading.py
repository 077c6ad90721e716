"""Grades of contacts: whether the AV could have avoided them, and whether it was at fault.

`judge` grades a contact: unavoidable, avoidable by a manoeuvre but by no reference driver, by some
or by all of them. `avoidable` tests many futures of the opponent before any of them is driven: the
AV keeps its speed along its path until the driver in its place reacts.

`av_at_fault` follows the classes of nuPlan's at-fault collisions (Caesar et al., 2021, metric
``no_ego_at_fault_collisions``): the AV is at fault if it hits something that stands, or hits with
its front, or touches sideways while it is not within one lane. It is not at fault while it stands
itself, or if it is hit from behind. The classes contain neither right of way nor cut-ins: a car
that cuts in close ahead of the AV and is hit there counts against the AV; the grade says whether
the AV could have avoided it. A vehicle stands at less than 0.1 m/s (nuPlan: 0.05, which recorded
velocities of standing vehicles exceed).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from deepmf_sumo.judge import impact
from deepmf_sumo.judge.avoidability import manoeuvres, reference_drivers
from deepmf_sumo.judge.avoidability.av_path import AvPath, VehicleState, keeps_lane, stays_on_road
from deepmf_sumo.judge.avoidability.encounter import (
    DEPARTURE_M,
    Encounter,
    MovingVehicle,
    encounter_of,
    hit_by,
    on_collision_course,
    third_parties_of,
)
from deepmf_sumo.judge.avoidability.intention import MODELS_FOR_PEOPLE, is_person, models_for
from deepmf_sumo.judge.avoidability.reference_drivers import MODELS, Approach, DriverModel
from deepmf_sumo.scene import Bools, Case, Contact, Floats, Ints, Rollout
from deepmf_sumo.scene.geometry.slow import STANDING_MPS

Grade = Literal["no driver", "emergency manoeuvre", "some drivers", "all drivers"]
GRADES: Final[tuple[Grade, ...]] = get_args(Grade)
"""What avoids a contact: nothing; a manoeuvre, but no driver; at least one driver; each of them."""
By = Literal["any", "all", "cc", "fsm", "rss", "vru"]
Collision = Literal["av_stopped", "other_stopped", "active_rear", "active_front", "active_lateral"]
BEHIND_RAD: Final = np.radians(30)
_EVERY: Final = {**MODELS, **MODELS_FOR_PEOPLE}
_QUICKEST: Final = ("cc", "rss", "fsm")
"""The drivers by the time that their decisions take to compute."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The drivers and manoeuvres that would have avoided a contact.

    Attributes:
        avoided_by: name of each reference driver -> whether that driver avoids it: those of
            `reference_drivers.MODELS`, of a pedestrian or cyclist the one of
            `intention.MODELS_FOR_PEOPLE`, to whom one who has stopped counts, too.
        standing: the same -> whether the opponent hits that driver's car after it has stopped.
        manoeuvres: number of `manoeuvres.GRID` that avoid it, started at the onset.
        onset_step: of the rollout.
    """

    avoided_by: dict[str, bool]
    standing: dict[str, bool]
    manoeuvres: int
    onset_step: int

    @property
    def physically(self) -> bool:
        """Whether any manoeuvre or driver would have avoided the contact."""
        return self.manoeuvres > 0 or any(self.avoided_by.values())

    @property
    def avoidable(self) -> bool:
        """Whether one of the drivers would have avoided the contact."""
        return any(self.avoided_by.values())

    @property
    def hit_standing(self) -> bool:
        """Whether no driver avoids the contact, but one has stopped before it."""
        return not self.avoidable and any(self.standing.values())

    @property
    def grade(self) -> Grade:
        """See `GRADES`."""
        if all(self.avoided_by.values()):
            return "all drivers"
        if self.avoidable:
            return "some drivers"
        return "emergency manoeuvre" if self.physically else "no driver"


def judge(rollout: Rollout, case: Case) -> Judgement | None:
    """The judgement, or None if AV and opponent did not touch."""
    encounter = encounter_of(rollout, case)
    if encounter is None:
        return None
    opponent = rollout.tracks.row(encounter.opponent_id)
    models = models_for(rollout.tracks, opponent)
    outcome = reference_drivers.outcome(
        list(models.values()),
        encounter.path,
        encounter.approach,
        encounter.av_along_m,
        encounter.onset,
    )
    avoided, standing = outcome.avoided[:, 0], outcome.standing[:, 0]
    if is_person(rollout.tracks, opponent):  # nobody was hit by a car that stood
        avoided = avoided | standing
    avoided &= ~_hits_supporter(encounter, rollout, case, list(models.values()))
    return Judgement(
        avoided_by={name: bool(avoided[d]) for d, name in enumerate(models)},
        standing={name: bool(standing[d]) for d, name in enumerate(models)},
        manoeuvres=int(evasive_manoeuvres(encounter, rollout, case).sum()),
        onset_step=encounter.first_step + encounter.onset,
    )


def _hits_supporter(
    encounter: Encounter, rollout: Rollout, case: Case, models: Sequence[DriverModel]
) -> Bools:
    """(D) whether each of D drivers touches a supporter of the attack instead.

    Drivers know nothing of third parties, and brake; these vehicles were put in their way, or
    behind them.
    """
    if not rollout.supporters:
        return np.zeros(len(models), bool)
    along = reference_drivers.drive(
        models, encounter.approach, encounter.av_along_m, encounter.onset
    )
    centre_m, heading = encounter.path.at(along[:, 0, encounter.onset :])
    first = encounter.first_step + encounter.onset
    others = third_parties_of(rollout, case, first, centre_m.shape[1], rollout.supporters)
    stays = np.zeros(len(models), bool)
    return hit_by(centre_m, heading, others, encounter.approach.av_size_m, stays)


def evasive_manoeuvres(encounter: Encounter, rollout: Rollout, case: Case) -> Bools:
    """(M) whether each of `manoeuvres.GRID` avoids all contacts and stays on the road."""
    approach, start = encounter.approach, encounter.onset
    steps = approach.steps - start
    driven = manoeuvres.drive(encounter.path, encounter.av_along_m[start:], rollout.dt_s)
    poses = driven.centre_m, driven.heading_rad
    free = driven.holds & ~reference_drivers.overlaps(approach, *poses, start).any(axis=1)
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
        others = third_parties_of(rollout, case, first, steps)
        straight = manoeuvres.GRID.lateral_mps2 == 0
        free &= ~hit_by(*poses, others, approach.av_size_m, straight)
    return free


class PastPoses(NamedTuple):
    """(H, 3) poses x, y, heading of the AV and of the opponent in the steps before now."""

    av: Floats
    opponent: Floats

    @classmethod
    def none(cls) -> "PastPoses":
        """No steps."""
        return cls(np.empty((0, 3)), np.empty((0, 3)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AvAhead:
    """The AV now, and how it drives on until a driver in its place reacts.

    Attributes:
        size_m: (2) length, width.
        path_m: (P, 2), P >= 0, the known points ahead of it; then it goes straight on.
        along_m: (K + 1) its arc lengths now and at the opponent's steps; None: it keeps its speed.
    """

    now: VehicleState
    size_m: Floats
    path_m: Floats
    along_m: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpponentFutures:
    """The opponent now, and N futures of it from the next step on.

    ``size_m`` (2) length, width. ``position_m`` (N, K, 2). ``heading_rad`` (N, K).
    """

    now: VehicleState
    size_m: Floats
    position_m: Floats
    heading_rad: Floats


class TakeOver(NamedTuple):
    """From when on a reference driver drives: from the first step of ``past``, or later.

    Attributes:
        past: what both did before now.
        expected_m: (H + 1 + K, 2) where the opponent would have been without the attack, from the
            first step of ``past`` on, nan where that is not known. The driver then takes over at
            the first sign of the attack, as in `judge` (`encounter.onset_step`).
        since: (N) steps, counted from the first one of ``past``, before which the driver does not
            take over: a person has not shown its intention.
    """

    past: PastPoses = PastPoses.none()
    expected_m: Floats | None = None
    since: Ints | None = None


def avoidable(
    av: AvAhead,
    opponent: OpponentFutures,
    dt_s: float,
    by: By = "any",
    take_over: TakeOver | None = None,
) -> Bools:
    """(N) whether a reference driver in the AV's place avoids contact with the opponent's futures.

    Args:
        av: the AV until the driver reacts.
        opponent: what it meets.
        dt_s: of a step.
        by: the driver that has to avoid contact: one of `reference_drivers.MODELS`, ``any`` of them
            or ``all``; or ``vru``, which is for pedestrians and cyclists.
        take_over: None: now.
    """
    past, expected_m, since = take_over or TakeOver()
    av_m = np.concatenate([past.av[:, :2], [av.now.position_m]])
    path = AvPath.through(av_m, np.append(past.av[:, 2], av.now.heading_rad), av.path_m)
    futures, steps = np.shape(opponent.heading_rad)
    now = np.append(opponent.now.position_m, opponent.now.heading_rad)
    before = np.concatenate([past.opponent, [now]])
    before = np.broadcast_to(before, (futures, *before.shape))
    position = np.concatenate([before[..., :2], opponent.position_m], axis=1)
    heading = np.concatenate([before[..., 2], opponent.heading_rad], axis=1)
    approach = Approach.of(path, position, heading, opponent.size_m, av.size_m, dt_s)
    steady_m = av.now.speed_mps * dt_s * np.arange(steps + 1)
    ahead_m = steady_m if av.along_m is None else av.along_m
    past_m = np.append(0.0, np.hypot(*np.diff(av_m, axis=0).T).cumsum())
    driven_m = np.concatenate([past_m[:-1], past_m[-1] + ahead_m])
    start = np.zeros(futures, np.int64)
    if expected_m is not None:
        start = _onsets(path, approach, driven_m, expected_m)
    if since is not None:
        start = np.clip(since, start, approach.steps - 1)
    avoided = np.full(futures, by == "all")
    for name in _QUICKEST if by in ("any", "all") else (by,):
        open_ = np.flatnonzero(avoided == (by == "all"))  # the others are decided
        if len(open_):
            those = approach.among(open_), driven_m, start[open_]
            found = reference_drivers.outcome([_EVERY[name]], path, *those)
            avoided[open_] = found.avoided[0] | (found.standing[0] & (name in MODELS_FOR_PEOPLE))
    return avoided


def _onsets(path: AvPath, approach: Approach, driven_m: Floats, expected_m: Floats) -> Ints:
    """(N) first steps with a sign of the attack (`encounter.onset_step`); 0 without a sign."""
    away = np.hypot(*np.moveaxis(approach.position_m - expected_m, -1, 0))
    signs: Bools = away > DEPARTURE_M
    first = np.where(signs.any(axis=1), signs.argmax(axis=1), approach.steps)
    row, step = np.nonzero(np.arange(approach.steps) < first[:, None])
    centre_m, heading = path.at(driven_m)
    av = MovingVehicle(
        centre_m[step],
        np.gradient(centre_m, approach.dt_s, axis=0)[step],
        heading[step],
        approach.av_size_m,
    )
    opponent = MovingVehicle(
        approach.position_m[row, step],
        approach.velocity_mps[row, step],
        approach.heading_rad[row, step],
        approach.size_m,
    )
    signs[row, step] |= on_collision_course(av, opponent)
    return np.asarray(signs.argmax(axis=1))


def collision_class(rollout: Rollout, contact: Contact) -> Collision:
    """Class of a contact of the AV; speeds are those of the step before it."""
    tracks, before = rollout.tracks, max(contact.step - 1, 0)
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    if tracks.speed_mps[av, before] <= STANDING_MPS:
        return "av_stopped"
    if tracks.speed_mps[other, before] <= STANDING_MPS:
        return "other_stopped"
    touch = impact.first_touch(rollout, contact)
    if abs(touch.bearing_rad) >= np.pi - BEHIND_RAD:
        return "active_rear"
    return "active_front" if touch.front is not None else "active_lateral"


def av_at_fault(rollout: Rollout, case: Case) -> bool | None:
    """Whether the contact with the opponent is the AV's fault; None if they did not touch."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    found = collision_class(rollout, contact)
    if found == "active_lateral":
        pose, tracks = contact.pose_first, rollout.tracks
        av = tracks.row(contact.first_id)
        width, z_m = float(tracks.size_m[av, 1]), float(tracks.z_m[av, contact.step])
        return not keeps_lane(case.road, pose[:2], float(pose[2]), width, z_m)
    return found in ("other_stopped", "active_front")
