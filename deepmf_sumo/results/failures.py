"""What went wrong in a run, in the words of traffic safety; and what is wrong with a planner.

A failure is a hit of the opponent, or an error of the planner: one that crashed, hung, or answered
nonsense. A hit is described by its conflict, by where the opponent came from, by priority,
what the AV did, and when the AV could first have reacted. The kind of conflict is that of
`judge.conflict_types`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from deepmf_sumo.datatypes import Contact, RoadMap, Rollout, Tracks
from deepmf_sumo.datatypes.signals import FORBIDS, GOES, STOP_FIRST
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.geometry.slow import STANDING_MPS
from deepmf_sumo.judge.avoidability.encounter import onset_of
from deepmf_sumo.judge.avoidability.grading import GRADES, Grade
from deepmf_sumo.judge.conflict_types import ACROSS, ConflictType, Meeting, Side, Who
from deepmf_sumo.judge.metrics.driving import lights_passed
from deepmf_sumo.network.matching import match
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Results, Run

Kind = Literal[
    "hit", "planner crashed", "planner hung", "planner answered nonsense", "run timed out"
]  # fmt: skip
Action = Literal[
    "braked", "stopped", "accelerated", "set off", "stood", "held speed", "steered"
]  # fmt: skip

_ON_LANES: Final = {"crossing", "merging", "head-on", *ACROSS}
"""Conflicts of vehicles that keep to their lanes, unless one of them strays."""
_CHANGED_MPS: Final = 1.0
"""Less change of speed is holding it."""
_STEERED_M: Final = 0.75
"""Farther from the middle of the lane than before is steering."""
_SLOW_MPS: Final = 0.5
_STOPPED_STEPS: Final = 10
"""A vehicle has stopped if it is never faster than 0.5 m/s in the last 10 steps."""
_LATE_S: Final = 1.0
"""Braking is late if it begins later than 1 s after the onset."""
_LONG_M: Final = 6.5
_PLANNER: Final = "planner_error:"
_FAULTS: Final[dict[str, Kind]] = {
    "crashed": "planner crashed",
    "hung": "planner hung",
    "nonsense": "planner answered nonsense",
}
_HUNG: Final = re.compile(r"did not answer .* within \S+ s\.$")
_CRASHED: Final = re.compile(r"ended its process|before it answered|\(see log\.txt\)")
"""The words of errors in results of earlier versions, which do not name the fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A run that failed. Of planner errors only ``run``, ``kind`` and ``reason`` say something.

    Attributes:
        reason: what the planner did wrong.
        side: where the opponent came from, seen from the AV.
        priority: which of the two had it; empty where that is not known.
        turned: which of the two turned, changed lanes, or drove ahead; empty where neither did.
        strayed: whether the opponent left its lane, where the AV did not and no lane is changed.
        action: of the AV, from the onset to the contact.
        late: whether it braked, and began to do so more than 1 s after the onset.
        braking_mps2: its hardest braking from the onset on, mean over 0.5 s.
        onset_s: from the first step at which the AV may react to the contact.
        grade: whether it could be avoided from there on (`avoidability.grading`); None: not known.
        delta_v_mps: severity.
        ordinary_mps2: rms acceleration of the opponent; None where it is not known.
        opponent: "car" or "truck or bus".
        ran_red: whether the opponent passed a red light.
    """

    run: Run
    kind: Kind
    reason: str = ""
    conflict: ConflictType | None = None
    side: Side | None = None
    priority: Who = ""
    turned: Who = ""
    strayed: bool = False
    action: Action | None = None
    late: bool = False
    braking_mps2: float = 0.0
    onset_s: float | None = None
    grade: Grade | None = None
    delta_v_mps: float = 0.0
    ordinary_mps2: float | None = None
    opponent: str = "car"
    ran_red: bool = False


def failures(results: Results) -> Iterator[tuple[Run, Failure | None, str]]:
    """Each run with its failure, or None; and why a hit could not be described."""
    for run in results.runs:
        try:
            yield run, failure_of(run), ""
        except stored.DAMAGE as error:
            yield run, None, f"{type(error).__name__}: {error}"


def failure_of(run: Run, road: RoadMap | None = None) -> Failure | None:
    """What went wrong in a run; None where nothing did.

    ``road``: its map, where it is known already. Raises `stored.DAMAGE`.
    """
    if run.status in {"failed", "timeout"}:
        return _of_planner(run)
    if run.status != "ok" or not run.hit:
        return None
    rollout = run.rollout
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    if road is None:
        try:
            road = run.road()[0]
        except DeepmfError:
            road = None
    return _of_hit(run, rollout, contact, road)


def conflict_of(rollout: Rollout, road: RoadMap) -> tuple[ConflictType, Side, Who]:
    """Of an episode with a hit: its conflict, the opponent's side, and which of the two turned.

    Raises ValueError without a hit.
    """
    contact = rollout.first("av_opponent")
    if contact is None:
        raise ValueError("the opponent did not hit the AV")
    meeting = Meeting.of(rollout.tracks, (contact.first_id, contact.second_id), contact.step, road)
    priority = _by_map(meeting) if meeting.type == "merging" else ""
    side = meeting.side(max(rollout.now, meeting.first))
    return meeting.type, side, _joining(meeting.turned(), meeting.type, priority)


def _joining(turned: Who, conflict: ConflictType, priority: Who) -> Who:
    """Of merging roads the one without priority joins the other, where that is known."""
    if conflict != "merging" or not priority:
        return turned
    return "opponent" if priority == "AV" else "AV"


def _of_planner(run: Run) -> Failure | None:
    """A planner's error, or a run out of time: by the planner, the attack or a slow machine."""
    error = run.row.get("error", "")
    if run.status == "timeout":
        return Failure(run=run, kind="run timed out", reason=f"it took {error}")
    reason = error.removeprefix(_PLANNER).strip()
    fault = run.result.get("planner_fault") if run.has_result else None
    if fault is None and error.startswith(_PLANNER):
        fault = "nonsense"
        if _CRASHED.search(reason):
            fault = "crashed"
        elif _HUNG.search(reason):
            fault = "hung"
    return Failure(run=run, kind=_FAULTS[fault], reason=reason) if fault in _FAULTS else None


def _of_hit(run: Run, rollout: Rollout, contact: Contact, road: RoadMap | None) -> Failure:
    tracks = rollout.tracks
    meeting = Meeting.of(tracks, (contact.first_id, contact.second_id), contact.step, road)
    onset = first = max(_begin(run, rollout), meeting.since)
    if first < contact.step:
        onset = onset_of(rollout, run.unattacked(), meeting.other, first, contact.step)
    turned = meeting.turned()
    strayed = meeting.type in _ON_LANES and meeting.strayed()
    judged = not strayed or bool(run.metric("red_light"))
    priority = _priority(run, rollout, meeting, turned) if judged else ""
    late, braking_mps2 = _braking(tracks, meeting.av, onset, contact.step, rollout.dt_s)
    grade = run.metric("avoidance_grade")
    return Failure(
        run=run,
        kind="hit",
        conflict=meeting.type,
        side=meeting.side(onset),
        priority=priority,
        turned=_joining(turned, meeting.type, priority),
        strayed=strayed,
        action=_action(tracks, meeting.av, onset, contact.step, road),
        late=late,
        braking_mps2=braking_mps2,
        onset_s=round((contact.step - onset) * rollout.dt_s, 3),
        grade=None if grade is None else GRADES[int(grade)],
        delta_v_mps=contact.delta_v_mps,
        ordinary_mps2=run.metric("opponent_rms_acceleration"),
        opponent="car" if tracks.size_m[meeting.other, 0] < _LONG_M else "truck or bus",
        ran_red=bool(run.metric("red_light")),
    )


def _begin(run: Run, rollout: Rollout) -> int:
    """Step at which the attack that hit began: of opponents in turn that of its turn."""
    turns = run.result["turns"] or []
    hit = next((one for one in turns if one["ended"] == "contact"), None)
    return rollout.now + (round(hit["begin_s"] / rollout.dt_s) if hit else 0)


def _action(tracks: Tracks, av: int, onset: int, contact: int, road: RoadMap | None) -> Action:
    """What the AV did from the onset up to the step before the contact."""
    speed = tracks.speed_mps[av, onset : max(contact, onset + 1)]
    if speed.max() <= STANDING_MPS:
        return "stood"
    last = tracks.speed_mps[av, max(contact - _STOPPED_STEPS, 0) : contact]
    if speed.max() > _CHANGED_MPS and last.max(initial=0.0) <= _SLOW_MPS:
        return "stopped"
    if road is not None and _steers(tracks, av, onset, contact, road):
        return "steered"
    if speed.max() - speed[-1] > _CHANGED_MPS:
        return "braked"
    if speed[0] <= STANDING_MPS:
        return "set off"
    return "accelerated" if speed[-1] - speed[0] > _CHANGED_MPS else "held speed"


def _braking(tracks: Tracks, av: int, onset: int, contact: int, dt_s: float) -> tuple[bool, float]:
    """Whether the AV began to brake late, and its hardest braking, m/s2, from the onset on."""
    speed = tracks.speed_mps[av, onset : max(contact, onset + 1)]
    apart = min(round(0.5 / dt_s), len(speed) - 1)
    if not apart:
        return False, 0.0
    lost = (speed[:-apart] - speed[apart:]) / (apart * dt_s)
    slower = np.flatnonzero(lost > _CHANGED_MPS)
    late = len(slower) > 0 and slower[0] * dt_s > _LATE_S
    return bool(late), max(0.0, float(lost.max()))


def _steers(tracks: Tracks, row: int, first: int, last: int, road: RoadMap) -> bool:
    """Whether a vehicle leaves the middle of its lane, or changes to the lane beside it."""
    span = slice(first, max(last, first + 1))
    found = match(
        road,
        tracks.position_m[row, span],
        tracks.heading_rad[row, span],
        tracks.valid[row, span],
        tracks.z_m[row, span],
    )
    off = found.distance_m[np.isfinite(found.distance_m)]
    for before, lane in pairwise(found.lane_ids):
        if before is not None and lane is not None and lane != before:
            beside = (*road.lanes[before].left, *road.lanes[before].right)
            if lane in {one.lane_id for one in beside}:
                return True
    return bool(len(off) and np.ptp(off) > _STEERED_M)


def _priority(run: Run, rollout: Rollout, meeting: Meeting, turned: Who) -> Who:
    """Which had priority: by the lights, or that which does not turn, change lanes or follow.

    Else by the map.
    """
    kind, road = meeting.type, meeting.road
    if run.metric("red_light"):
        return "AV"
    if kind == "rear-end":
        return turned  # the follower has to keep its distance
    by_lights = _by_lights(rollout, meeting, road) if road and kind in _AT_LIGHTS else ""
    if by_lights:
        return by_lights
    if kind in {"lane change", *ACROSS}:
        return "AV" if turned == "opponent" else "opponent"
    return _by_map(meeting) if kind != "head-on" else ""


_JUNCTION_M: Final = 50.0
"""From the contact to the stop lines of its junction, at most."""
_AT_LIGHTS: Final = {"crossing", "merging", *ACROSS}


def _by_lights(rollout: Rollout, meeting: Meeting, road: RoadMap) -> Who:
    """The one whose light let it go, where that of the other did not."""
    place = meeting.tracks.position_m[meeting.av, meeting.step]
    mine, theirs = (
        lights_passed(rollout, road, row, place, _JUNCTION_M) for row in (meeting.av, meeting.other)
    )
    stops = FORBIDS | STOP_FIRST
    if mine & GOES and theirs and theirs <= stops:
        return "AV"
    return "opponent" if theirs & GOES and mine and mine <= stops else ""


def _by_map(meeting: Meeting) -> Who:
    road = meeting.road
    if road is None:
        return ""
    mine, theirs = meeting.driven(0), meeting.driven(1)
    yields = [
        any(not set(road.lanes[lane].gives_way_to).isdisjoint(others) for lane in lanes)
        for lanes, others in ((mine, theirs), (theirs, mine))
    ]
    if yields[0] == yields[1]:
        return ""
    return "opponent" if yields[0] else "AV"
