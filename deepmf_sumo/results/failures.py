"""What went wrong in a run, in the words of traffic safety; and what is wrong with a planner.

A failure is a hit of the opponent, or an error of the planner: one that crashed, hung, or answered
nonsense. A hit is described by its conflict, by where the opponent came from, by priority,
what the AV did, and when the AV could first have reacted. The conflict's type is taken from the
directions in which both came, and from the metric ``accident_type``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from deepmf_sumo.avoidability.encounter import onset_of
from deepmf_sumo.avoidability.grading import GRADES, Grade
from deepmf_sumo.datatypes import Contact, Floats, RoadMap, Rollout, SignalState, Tracks
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.geometry import frames
from deepmf_sumo.geometry.slow import WAITING_MPS
from deepmf_sumo.metrics.collision import AccidentType, accident_type_of
from deepmf_sumo.metrics.driving import lights_passed
from deepmf_sumo.network.matching import match
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Results, Run

Kind = Literal[
    "hit", "planner crashed", "planner hung", "planner or attack hung", "planner answered nonsense"
]  # fmt: skip
Conflict = Literal[
    "rear-end", "crossing", "left turn across path", "right turn across path", "merging",
    "cut-in / lane change", "head-on",
]  # fmt: skip
Side = Literal["left", "right", "ahead", "behind"]
Action = Literal["braked", "accelerated", "stood", "held speed", "steered"]
Who = Literal["AV", "opponent", ""]

_BEFORE_STEPS: Final = 40
"""Directions are those of 4 s before the contact, or of the first step with both."""
_TURNING_RAD: Final = float(np.radians(0.5))
"""Where a vehicle turns more in a step, its turn is looked at from the start."""
_SAME_RAD, _OPPOSITE_RAD, _JOINED_RAD, _TURNED_RAD = np.radians([30.0, 135.0, 45.0, 20.0])
_BESIDE_M: Final = 1.0
_CHANGED_MPS: Final = 1.0
"""Less change of speed is holding it."""
_STEERED_M: Final = 0.75
"""Farther from the middle of the lane than before is steering."""
_HOPS: Final = 3
_LONG_M: Final = 6.5
_HUNG: Final = ("did not answer", "TimeoutError")
_CRASHED: Final = ("ended its process", "before it answered", "(see log.txt)")
_PLANNER: Final = "planner_error:"


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A run that failed. Of planner errors only ``run``, ``kind`` and ``reason`` say something.

    Attributes:
        reason: what the planner did wrong.
        side: where the opponent came from, seen from the AV.
        priority: which of the two had it; empty where that is not known.
        turned: which of the two turned, changed lanes, or drove ahead; empty where neither did.
        action: of the AV, from the onset to the contact.
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
    conflict: Conflict | None = None
    side: Side | None = None
    priority: Who = ""
    turned: Who = ""
    action: Action | None = None
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


def conflict_of(rollout: Rollout, road: RoadMap) -> tuple[Conflict, Side, Who]:
    """Of an episode with a hit: its conflict, the opponent's side, and which of the two turned.

    Raises ValueError without a hit.
    """
    contact = rollout.first("av_opponent")
    if contact is None:
        raise ValueError("the opponent did not hit the AV")
    pair = _Pair.of(rollout.tracks, contact)
    conflict = pair.conflict(accident_type_of(rollout), _joins(road, pair))
    priority = _by_map(pair, road) if conflict == "merging" else ""
    turned = _joining(pair.turned(conflict), conflict, priority)
    return conflict, pair.side(conflict, max(rollout.now, pair.first)), turned


def _joining(turned: Who, conflict: Conflict, priority: Who) -> Who:
    """Of merging roads the one without priority joins the other, where that is known."""
    if conflict != "merging" or not priority:
        return turned
    return "opponent" if priority == "AV" else "AV"


def _of_planner(run: Run) -> Failure | None:
    """A planner's error. Of a run that was out of time it is not known whether the planner hung."""
    error = run.row.get("error", "")
    if run.status == "timeout":
        reason = f"the run took {error}"
        return Failure(run=run, kind="planner or attack hung", reason=reason)
    if not error.startswith(_PLANNER):
        return None
    reason = error.removeprefix(_PLANNER).strip()
    kind: Kind = "planner answered nonsense"
    if any(mark in reason for mark in _HUNG):
        kind = "planner hung"
    elif any(mark in reason for mark in _CRASHED):
        kind = "planner crashed"
    return Failure(run=run, kind=kind, reason=reason)


def _of_hit(run: Run, rollout: Rollout, contact: Contact, road: RoadMap | None) -> Failure:
    tracks = rollout.tracks
    pair = _Pair.of(tracks, contact)
    conflict = pair.conflict(accident_type_of(rollout), _joins(road, pair))
    first = max(rollout.now, pair.since)
    onset = first
    if first < contact.step:
        onset = onset_of(rollout, run.expected(), pair.other, first, contact.step)
    turned = pair.turned(conflict)
    priority = _priority(run, rollout, pair, conflict, turned, road)
    grade = run.metric("avoidance_grade")
    return Failure(
        run=run,
        kind="hit",
        conflict=conflict,
        side=pair.side(conflict, onset),
        priority=priority,
        turned=_joining(turned, conflict, priority),
        action=_action(tracks, pair.av, onset, contact.step, road),
        onset_s=round((contact.step - onset) * rollout.dt_s, 3),
        grade=None if grade is None else GRADES[int(grade)],
        delta_v_mps=contact.delta_v_mps,
        ordinary_mps2=run.metric("opponent_rms_acceleration"),
        opponent="car" if tracks.size_m[pair.other, 0] < _LONG_M else "truck or bus",
        ran_red=bool(run.metric("red_light")),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """AV and opponent before their contact.

    Attributes:
        av, other: rows. since: step from which on both are there. contact: step.
        first: step from which on their directions are looked at.
        relative: (2) heading of the opponent relative to the AV at first and contact.
        turn: (2) by how much AV and opponent turn in between, left is positive.
    """

    tracks: Tracks
    av: int
    other: int
    since: int
    first: int
    contact: int
    relative: Floats
    turn: Floats

    @classmethod
    def of(cls, tracks: Tracks, contact: Contact) -> "_Pair":
        rows = [tracks.row(contact.first_id), tracks.row(contact.second_id)]
        both = tracks.valid[rows[0]] & tracks.valid[rows[1]]
        missing = np.flatnonzero(~both[: contact.step])
        since = int(missing[-1]) + 1 if len(missing) else 0
        heading = tracks.heading_rad[rows, since : contact.step + 1]
        change = frames.wrap(np.diff(heading, axis=1))
        begin = _before_turns(change)
        first, heading, turn = since + begin, heading[:, begin:], change[:, begin:].sum(axis=1)
        relative = frames.wrap(heading[1, [0, -1]] - heading[0, [0, -1]])
        return cls(
            tracks=tracks,
            av=rows[0],
            other=rows[1],
            since=since,
            first=first,
            contact=contact.step,
            relative=relative,
            turn=turn,
        )

    def conflict(self, accident: AccidentType, joins: bool) -> Conflict:
        """The type; ``joins``: the two came from roads that join."""
        came, met = (abs(float(one)) for one in self.relative)
        turn = max(self.turn.tolist(), key=abs)
        if came > _OPPOSITE_RAD and abs(turn) > _TURNED_RAD:
            return "left turn across path" if turn > 0 else "right turn across path"
        if accident == "rear_end":
            return "rear-end"
        if came < _SAME_RAD:
            return "merging" if joins else "cut-in / lane change"
        if accident == "head_on" or came > _OPPOSITE_RAD:
            return "head-on"
        return "merging" if met < _JOINED_RAD else "crossing"

    def local(self, step: int) -> Floats:
        """(2) the opponent ahead of the AV, and to its left."""
        position, heading = self.tracks.position_m[:, step], self.tracks.heading_rad[:, step]
        found: Floats = frames.to_local(
            position[self.other], position[self.av], float(heading[self.av])
        )
        return found

    def side(self, conflict: Conflict, onset: int) -> Side:
        """Where the opponent came from."""
        ahead, left = self.local(max(onset, self.first))
        if conflict in {"head-on", "left turn across path", "right turn across path"}:
            return "ahead"
        if conflict == "rear-end":
            return "ahead" if self.local(self.contact)[0] > 0 else "behind"
        if abs(self.relative[0]) > _SAME_RAD:
            return "left" if self.relative[0] < 0 else "right"
        if abs(left) > _BESIDE_M:
            return "left" if left > 0 else "right"
        return "ahead" if ahead > 0 else "behind"

    def turned(self, conflict: Conflict) -> Who:
        """Which vehicle turned across, changed lanes, or drove ahead."""
        if conflict == "rear-end":
            return "opponent" if self.local(self.contact)[0] > 0 else "AV"
        if conflict in {"cut-in / lane change", "merging"}:
            return "opponent" if self._aside(self.other) >= self._aside(self.av) else "AV"
        if conflict == "crossing":
            return ""
        return "AV" if abs(self.turn[0]) > abs(self.turn[1]) else "opponent"

    def _aside(self, row: int) -> float:
        """How far a vehicle moved sideways of the direction that it had first."""
        moved = self.tracks.position_m[row, [self.first, self.contact]]
        heading = float(self.tracks.heading_rad[row, self.first])
        return abs(float(frames.to_local(moved[1], moved[0], heading)[1]))


def _before_turns(change_rad: Floats) -> int:
    """The column of changes (2, K) to begin at: 4 s before the end, or before a turn there."""
    begin = max(0, change_rad.shape[1] - _BEFORE_STEPS)
    while begin > 0 and abs(change_rad[:, begin - 1]).max() > _TURNING_RAD:
        begin -= 1
    return begin


def _action(tracks: Tracks, av: int, onset: int, contact: int, road: RoadMap | None) -> Action:
    """What the AV did from the onset up to the step before the contact."""
    speed = tracks.speed_mps[av, onset : max(contact, onset + 1)]
    if speed.max() <= WAITING_MPS:
        return "stood"
    if road is not None and _steers(tracks, av, onset, contact, road):
        return "steered"
    if speed.max() - speed[-1] > _CHANGED_MPS:
        return "braked"
    return "accelerated" if speed[-1] - speed[0] > _CHANGED_MPS else "held speed"


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


def _priority(
    run: Run,
    rollout: Rollout,
    pair: _Pair,
    conflict: Conflict,
    turned: Who,
    road: RoadMap | None,
) -> Who:
    """Which had priority: by the lights, or that which does not turn, change lanes or follow.

    Else by the map.
    """
    if run.metric("red_light"):
        return "AV"
    if conflict == "rear-end":
        return turned  # the follower has to keep its distance
    by_lights = _by_lights(rollout, pair, road) if road and conflict in _AT_LIGHTS else ""
    if by_lights:
        return by_lights
    if conflict in {"cut-in / lane change", "left turn across path", "right turn across path"}:
        return "AV" if turned == "opponent" else "opponent"
    return _by_map(pair, road) if road and conflict != "head-on" else ""


_JUNCTION_M: Final = 50.0
"""From the contact to the stop lines of its junction, at most."""
_AT_LIGHTS: Final = frozenset(
    {"crossing", "merging", "left turn across path", "right turn across path"}
)


def _by_lights(rollout: Rollout, pair: _Pair, road: RoadMap) -> Who:
    """The one whose light let it go, where that of the other did not."""
    place = pair.tracks.position_m[pair.av, pair.contact]
    mine, theirs = (
        lights_passed(rollout, road, row, place, _JUNCTION_M) for row in (pair.av, pair.other)
    )
    goes, stops = (
        {SignalState.GO, SignalState.ARROW_GO},
        {SignalState.STOP, SignalState.ARROW_STOP},
    )
    if mine & goes and theirs and theirs <= stops:
        return "AV"
    return "opponent" if theirs & goes and mine and mine <= stops else ""


def _by_map(pair: _Pair, road: RoadMap) -> Who:
    mine, theirs = (_lanes(pair, road, row) for row in (pair.av, pair.other))
    yields = [
        any(not set(road.lanes[lane].gives_way_to).isdisjoint(others) for lane in lanes)
        for lanes, others in ((mine, theirs), (theirs, mine))
    ]
    if yields[0] == yields[1]:
        return ""
    return "opponent" if yields[0] else "AV"


def _lanes(pair: _Pair, road: RoadMap, row: int) -> list[str]:
    """The lanes that a vehicle drove on before the contact, and those that follow the last."""
    span, tracks = slice(pair.first, pair.contact + 1), pair.tracks
    found = match(
        road,
        tracks.position_m[row, span],
        tracks.heading_rad[row, span],
        tracks.valid[row, span],
        tracks.z_m[row, span],
    ).lane_ids
    lanes = list(dict.fromkeys(lane for lane in found if lane is not None))
    return [*lanes, *(road.lanes[lanes[-1]].next if lanes else ())]


def _joins(road: RoadMap | None, pair: _Pair) -> bool:
    """Whether the two came on different roads, neither of which leads into the other."""
    if road is None or abs(pair.relative[0]) > _SAME_RAD:
        return False
    firsts = [_lanes(pair, road, row)[:1] for row in (pair.av, pair.other)]
    if not all(firsts):
        return False
    mine, theirs = (_ahead(road, lanes[0]) for lanes in firsts)
    return firsts[1][0] not in mine and firsts[0][0] not in theirs


def _ahead(road: RoadMap, lane: str) -> set[str]:
    """A lane, those beside it, and those that they lead to within a few lanes."""
    found, front = set(), {lane}
    for _ in range(_HOPS + 1):
        wide = set(front)
        for _ in range(_HOPS):
            wide |= {
                beside.lane_id
                for one in wide
                for beside in (*road.lanes[one].left, *road.lanes[one].right)
            }
        found |= wide
        front = {after for one in wide for after in road.lanes[one].next} - found
    return found
