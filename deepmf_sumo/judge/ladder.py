"""What a hit is worth: four rungs, of which the first two are findings.

- **A**, the AV's error: it took the other's priority, ran a light, struck what stood or drove
  ahead, moved over into a vehicle or left its lane, while the opponent kept the rules as long as
  that could matter.
- **B**, avoidable: the opponent made an error that drivers make, or neither erred, and a reference
  driver avoids it. If the AV erred, too, a manoeuvre of the search is enough: without its error
  there was no hit.
- **C**, contrived: it says little about the AV, see `_contrived`.
- **D**, unavoidable: no reference driver avoids it. The search may, because it knows the future.

Hits by pedestrians and cyclists have rules of their own where those of vehicles make no sense:

- **Errors of the AV**: it strikes a person who stood on the road, in sight, for 2.5 s; it runs a
  red light; it left the road and hits a person there; it hits a person on a pedestrian crossing,
  unless its light let it go straight on (what a crossing's light was is inferred from the AV's, see
  `crossings`). A cyclist who rode on the road has the rights of a vehicle, too. Not giving way at a
  crossing is an error only where the driver of `avoidability.intention` would have: a driver
  cannot give way to a person that it cannot see.
- **Errors of the person**: a pedestrian stepped, a cyclist rode, onto the road where there is no
  crossing, or against a light; a cyclist rode against the traffic. Pedestrians have no direction of
  traffic, and no place is off the road for them: beside it is where they belong.
- **Contrived**: the AV stood or crept; its speed at the impact was below 5 km/h (its own change of
  velocity says nothing: people are light); the person ran into its side or rear; no person moves
  like that; one of the two had touched another before.

C comes first: an error of the AV in a contrived hit is not a finding. All that a rung is made of is
driven motion and the map; which method attacked has no influence. The rules were compared with what
two readers said of 62 hits by eye (`studies/notebook/findings.md`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.judge import impact
from deepmf_sumo.judge.accident_types import CUT_IN_S
from deepmf_sumo.judge.avoidability import intention
from deepmf_sumo.judge.avoidability.intention import is_person
from deepmf_sumo.judge.conflict_types import Meeting
from deepmf_sumo.judge.crossings import before_hit, light_let_it_go, on_crossing, on_road, rides
from deepmf_sumo.judge.hits import Hit, hit_of
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, _slices, once
from deepmf_sumo.judge.metrics.avoidability import judgement
from deepmf_sumo.judge.metrics.collision import collision_clean
from deepmf_sumo.judge.metrics.driving import (
    against_traffic,
    feasible,
    lights_passed,
    may_turn_on_red,
)
from deepmf_sumo.scene import Bools, Floats, Ints, RoadMap, Rollout
from deepmf_sumo.scene.geometry import road
from deepmf_sumo.scene.geometry.slow import STOOD_MPS, WALKING_MPS
from deepmf_sumo.scene.signals import FORBIDS

Rung = Literal["A", "B", "C", "D"]
RUNGS: Final[tuple[Rung, ...]] = get_args(Rung)
FINDINGS: Final[frozenset[Rung]] = frozenset({"A", "B"})
DRIVERS: Final = ("cc", "fsm", "rss", "vru", "search")
"""What may avoid a hit: three models of drivers, of hits by people one of their own (``vru``), and
about a hundred manoeuvres."""

LEAST_M: Final = 1.0
"""An AV that moved less than this in its last second stood, even if it was setting off."""
LEAST_DELTA_V_MPS: Final = 5.0 / 3.6
"""A smaller change of velocity injures no occupant, and often damages no car."""
MOMENT_S: Final = 1.0
"""Drivers that cut a corner or drift over the middle are back by then, or have met somebody."""
LAST_S: Final = 1.0
STOOD_S: Final = 2.5
"""A road user that was slower than `STOOD_MPS` for this time could be seen standing: long enough to
react and to stop from 50 km/h."""
HARDEST_MPS2: Final = 6.0
"""Drivers hardly ever brake harder; a careful one is prepared for it (UN R157)."""
LIMIT: Final = 1.3
"""Times the limit; SUMO's drivers exceed it by a tenth or two."""
MOVED_OVER_M: Final = 0.5
_REAR: Final = {3, 4, 5}
"""Impact sectors of the rear end and its corners."""
_LEAST_IMPACT_MPS: Final = 5.0 / 3.6
"""Walking speed: cars that roll against people as slowly push them."""
_RIDING_MPS: Final = 1.0
_MOSTLY_RIDING: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The rung of a hit, and what decided.

    Attributes:
        reasons: what decided the rung: of C each thing that is contrived, else the error.
        av_error, opponent_error: what each did wrong; empty where nothing is known.
        avoided_by: those of `DRIVERS`, in the AV's place, that avoid it, in that order.
    """

    rung: Rung
    reasons: tuple[str, ...]
    av_error: str
    opponent_error: str
    avoided_by: tuple[str, ...]

    @property
    def finding(self) -> bool:
        """Whether an engineer can act on it."""
        return self.rung in FINDINGS


@once
def verdict(episode: Episode) -> Verdict | None:
    """The verdict on the contact of AV and opponent; None if they did not touch."""
    hit = hit_of(episode)
    if hit is None:
        return None
    judged = judgement(episode)
    able = {**judged.avoided_by, "search": judged.manoeuvres > 0}
    avoided_by = tuple(name for name in DRIVERS if able.get(name))
    contrived = tuple(_contrived(episode, hit))
    av = _av_error(episode, hit)
    if av == "took_crossing" and not judged.avoidable:
        av = ""  # the AV cannot give way to a person that it could not see
    # what it did before it stood for long enough to be seen does not matter
    opponent = "" if av == "struck_standing" else _opponent_error(episode, hit)
    rung: Rung
    if contrived:
        rung, reasons = "C", contrived
    elif av and not opponent:
        rung, reasons = "A", (av,)
    elif judged.avoidable or (av and avoided_by):
        rung, reasons = "B", (opponent or "neither_erred",)
    else:
        rung, reasons = "D", ("only_search" if avoided_by else "unavoidable",)
    return Verdict(
        rung=rung, reasons=reasons, av_error=av, opponent_error=opponent, avoided_by=avoided_by
    )


def stood_or_crept(speed_mps: Floats) -> Bools:
    """(...) whether an AV with speeds (..., K) in its last second (`LAST_S`) stood or crept."""
    slow: Bools = (speed_mps.max(axis=-1) < WALKING_MPS) | (
        speed_mps.mean(axis=-1) * LAST_S < LEAST_M
    )
    return slow


def _contrived(episode: Episode, hit: Hit) -> Iterator[str]:
    """What makes a hit say little about the AV.

    - It stood or crept during the last second: others drive into it, and it can do nothing.
    - Nobody is hurt.
    - The opponent rams it from behind, or moves over or merges into its rear end: that can be done
      anywhere, and the AV hardly sees it.
    - The opponent drives against the traffic, or leaves the road, for more than a moment. That is
      where no lane of its direction is under its middle: a car that cuts a corner within its half
      is on such a lane, and in junctions lanes lie in most directions. Overtaking on the oncoming
      lane counts too: a map does not tell where it is allowed, and an opponent that may use that
      lane can meet an AV head-on anywhere.
    - No vehicle of its class can move as the opponent did.
    - The AV or the opponent had touched another road user before.
    - A supporter touched anybody: it was to take ways out from the AV by its place alone.

    For people `_contrived_by_person` replaces the second to the fourth.
    """
    rollout, meeting = episode.rollout, hit.meeting
    if stood_or_crept(_speeds(rollout, meeting.av, meeting.step, LAST_S)):
        yield "av_stood"
    if is_person(rollout.tracks, meeting.other):
        yield from _contrived_by_person(episode, hit)
    else:
        if hit.delta_v_mps < LEAST_DELTA_V_MPS:
            yield "low_delta_v"
        if _rams(episode.rollout, hit):
            yield "rammed"
        yield from _astray(episode)
    try:
        if not feasible.compute(episode):
            yield "infeasible"
    except NotMeasurable:  # the policy never drove the opponent: others decided its motion
        pass
    if not collision_clean.compute(episode):
        yield "touched_another"
    if any({one.first_id, one.second_id} & {*rollout.supporters} for one in rollout.contacts):
        yield "supporter_touched"


def _rams(rollout: Rollout, hit: Hit) -> bool:
    """Whether the opponent, which came from the AV's direction, drives into its rear end."""
    if hit.conflict == "rear-end":
        return hit.turned == "AV"
    contact = rollout.first("av_opponent")
    assert contact is not None
    joins = hit.conflict in {"lane change", "merging"} and hit.turned == "opponent"
    return joins and contact.sector in _REAR


def _astray(episode: Episode) -> Iterator[str]:
    """Where the opponent drove for more than a moment, although vehicles do not drive there."""
    rollout = episode.rollout
    try:
        driving = _slices.driving(rollout)
    except NotMeasurable:
        return
    most = MOMENT_S / rollout.dt_s
    if against_traffic(episode, driving).sum() > most:
        yield "against_traffic"
    inside = road.on_road(episode.case.road, *_slices.places(rollout, driving))
    # what begins beside the lanes comes out of a drive or a car park
    if (~inside & np.maximum.accumulate(inside)).sum() > most:
        yield "off_road"


def _av_error(episode: Episode, hit: Hit) -> str:
    """What the AV did wrong; empty where nothing is known."""
    rollout, meeting = episode.rollout, hit.meeting
    person = is_person(rollout.tracks, meeting.other)
    if _stood(rollout, meeting) and (
        not person
        or _person_stood(episode, meeting, _last(rollout, meeting.other, meeting.step, STOOD_S))
    ):
        return "struck_standing"
    if _ran_light(episode, meeting):
        return "ran_light"
    error = _error_to_person(episode, hit) if person else None
    return _av_error_by_conflict(hit) if error is None else error


def _av_error_by_conflict(hit: Hit) -> str:
    if hit.conflict == "rear-end":
        return "struck_ahead" if hit.turned == "opponent" else ""
    if hit.conflict == "lane change":
        return "moved_over" if hit.turned == "AV" else ""
    if hit.conflict == "head-on":
        return "left_lane" if hit.meeting.strayed(0) else ""
    return "took_priority" if hit.priority == "opponent" or hit.av_crosses else ""


def _stood(rollout: Rollout, meeting: Meeting) -> bool:
    """Whether the opponent stood there to be seen: not if it came into the simulation only then."""
    before = slice(max(0, meeting.step - round(STOOD_S / rollout.dt_s)), meeting.step)
    there = bool(rollout.tracks.valid[meeting.other, before].all())
    speed = _speeds(rollout, meeting.other, meeting.step, STOOD_S)
    return there and bool(speed.max() < STOOD_MPS)


def _ran_light(episode: Episode, meeting: Meeting) -> bool:
    """Whether the AV passed a red light before the contact.

    A turn on red where it is allowed is not an error by itself; priority decides.
    """
    rollout = episode.rollout
    if meeting.road is None or may_turn_on_red(episode.case, meeting.turn_rad(0)):
        return False
    place = rollout.tracks.position_m[meeting.av, meeting.step]
    passed = lights_passed(rollout, meeting.road, meeting.av, place)
    return bool(passed) and passed <= FORBIDS


def _opponent_error(episode: Episode, hit: Hit) -> str:
    """What the opponent did wrong; empty where nothing is known."""
    person = is_person(episode.rollout.tracks, hit.meeting.other)
    error = _error_of_person(episode, hit) if person else None
    return _opponent_error_by_conflict(episode, hit) if error is None else error


def _opponent_error_by_conflict(episode: Episode, hit: Hit) -> str:
    if hit.ran_red:
        return "ran_light"
    if hit.strayed:
        return "left_lane"
    if hit.conflict == "rear-end":
        return _rear_end(episode.rollout, hit)
    if hit.conflict == "lane change":
        moved = hit.turned == "opponent" or hit.meeting.toward_m(1) > MOVED_OVER_M
        return "cut_in" if moved else ""
    if hit.priority == "AV":
        return "took_priority"
    return "sped" if _over_limit(episode, hit.meeting) else ""


def _rear_end(rollout: Rollout, hit: Hit) -> str:
    """Of an opponent behind or ahead of the AV."""
    if hit.turned == "AV":
        return "rammed"
    return "braked_hard" if _braking_mps2(rollout, hit.meeting) > HARDEST_MPS2 else ""


def _braking_mps2(rollout: Rollout, meeting: Meeting) -> float:
    """The opponent's hardest braking in the last seconds, mean over 0.5 s."""
    speed = _speeds(rollout, meeting.other, meeting.step, CUT_IN_S)
    apart = min(round(0.5 / rollout.dt_s), len(speed) - 1)
    if not apart:
        return 0.0
    return float((speed[:-apart] - speed[apart:]).max()) / (apart * rollout.dt_s)


def _over_limit(episode: Episode, meeting: Meeting) -> bool:
    """Whether the opponent drove far above the limit in the last seconds."""
    rollout = episode.rollout
    tracks, row = rollout.tracks, meeting.other
    steps = _last(rollout, row, meeting.step, CUT_IN_S)
    limit = road.limit_mps(
        episode.case.road,
        tracks.position_m[row, steps],
        tracks.heading_rad[row, steps],
        tracks.z_m[row, steps],
    )
    return bool((tracks.speed_mps[row, steps] > LIMIT * limit).any())  # nan: none is known


def _speeds(rollout: Rollout, row: int, step: int, seconds: float) -> Floats:
    """(K) of an agent in the seconds before a step, as far as it was there."""
    return rollout.tracks.speed_mps[row, _last(rollout, row, step, seconds)]


def _last(rollout: Rollout, row: int, step: int, seconds: float) -> Ints:
    """(K) steps with an agent in the seconds before a step; that step where there are none."""
    steps = np.arange(max(0, step - round(seconds / rollout.dt_s)), step)
    steps = steps[rollout.tracks.valid[row, steps]]
    return steps if len(steps) else np.array([step])


def _contrived_by_person(episode: Episode, hit: Hit) -> Iterator[str]:
    """What makes a hit by a person say little about the AV, besides the reasons of all hits."""
    rollout, contact = episode.rollout, episode.rollout.first("av_opponent")
    assert contact is not None
    if rollout.tracks.speed_mps[hit.meeting.av, max(contact.step - 1, 0)] < _LEAST_IMPACT_MPS:
        yield "low_impact_speed"
    face = impact.first_touch(rollout, contact).ran_into
    if face is not None:
        yield "ran_into_rear" if face == "rear" else "ran_into_side"


def _person_stood(episode: Episode, meeting: Meeting, steps: Ints) -> bool:
    """Whether a person who stood at some steps (K) did so on the road, and in sight."""
    rollout, road_map, row = episode.rollout, episode.case.road, meeting.other
    if not intention.on_road(rollout, road_map, row, steps).all():
        return False
    return intention.in_sight_for(rollout, road_map, row, steps)


def _error_to_person(episode: Episode, hit: Hit) -> str | None:
    """What the AV did wrong to a person who did not stand there; empty for nothing.

    None where the rules for vehicles decide.
    """
    if not on_road(episode.case.road, hit.meeting):
        return "left_road" if _left_road(episode.rollout, episode.case.road, hit.meeting) else ""
    if on_crossing(episode.rollout, episode.case.road, hit.meeting):
        return "" if light_let_it_go(episode.rollout, hit.meeting) else "took_crossing"
    return None if rides(episode.rollout, episode.case.road, hit.meeting) else ""


def _error_of_person(episode: Episode, hit: Hit) -> str | None:
    """What the person did wrong; empty for nothing, None where the rules for vehicles decide."""
    rollout, meeting, road_map = episode.rollout, hit.meeting, episode.case.road
    if not on_road(road_map, meeting):
        return ""
    if on_crossing(rollout, road_map, meeting):
        return "crossed_on_red" if light_let_it_go(rollout, meeting) else ""
    if rollout.tracks.kinds[meeting.other] == "pedestrian":
        return "stepped_out"
    if not rides(rollout, road_map, meeting):
        return "rode_out"
    return "rode_against" if _rode_against(rollout, road_map, meeting) else None


def _left_road(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether the AV was on the road before the hit, and no longer is."""
    steps = before_hit(rollout, meeting)
    tracks, row = rollout.tracks, meeting.av
    there = road.on_road(road_map, tracks.position_m[row, steps], tracks.z_m[row, steps])
    return bool(there.any() and not there[-1])


def _rode_against(rollout: Rollout, road_map: RoadMap, meeting: Meeting) -> bool:
    """Whether a cyclist mostly rode against the direction of its lanes."""
    tracks, row, steps = rollout.tracks, meeting.other, before_hit(rollout, meeting)
    velocity = tracks.velocity_mps[row, steps]
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    against = road.against_traffic(
        road_map, tracks.position_m[row, steps], course, tracks.z_m[row, steps], bicycles=True
    )
    against &= np.hypot(*velocity.T) > _RIDING_MPS
    return bool(len(steps) and against.mean() > _MOSTLY_RIDING)
