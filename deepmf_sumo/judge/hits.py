"""A hit in the words of traffic safety: its conflict, priority, and what the AV did.

A hit is described by its conflict, by where the opponent came from, by priority, by what the AV
did, and by when the AV could first have reacted. The kind of conflict is that of `conflict_types`.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from deepmf_sumo.judge import crossings
from deepmf_sumo.judge.avoidability.counterfactual import Counterfactual, counterfactual
from deepmf_sumo.judge.avoidability.encounter import onset_of
from deepmf_sumo.judge.avoidability.intention import emerged_from, is_person
from deepmf_sumo.judge.conflict_types import (
    ACROSS,
    ConflictType,
    Meeting,
    Side,
    Who,
    gives_way,
)
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, once
from deepmf_sumo.judge.metrics.driving import lights_passed, red_light
from deepmf_sumo.scene import Floats, RoadMap, Rollout, Tracks
from deepmf_sumo.scene.geometry.slow import STANDING_MPS, WAITING_MPS
from deepmf_sumo.scene.road_users import road_user
from deepmf_sumo.scene.signals import FORBIDS, GOES, STOP_FIRST
from deepmf_sumo.sumo.network.matching import match

Action = Literal[
    "braked", "stopped", "accelerated", "set off", "stood", "held speed", "steered"
]  # fmt: skip

_ON_LANES: Final = {"crossing", "merging", "head-on", *ACROSS}
"""Conflicts of vehicles that keep to their lanes, unless one of them strays."""
_CHANGED_MPS: Final = 1.0
"""Less change of speed is holding it."""
_STEERED_M: Final = 0.75
"""Farther from the middle of the lane than before is steering."""
_STOPPED_STEPS: Final = 10
"""A vehicle has stopped if it is never faster than 0.5 m/s in the last 10 steps."""
_LATE_S: Final = 1.0
"""Braking is late if it begins later than 1 s after the onset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hit:
    """A contact of AV and opponent.

    Attributes:
        meeting: the two up to the contact. onset: first step at which the AV may react to it.
        side: where the opponent came from, seen from the AV.
        priority: which of the two had it; empty where that is not known.
        turned: which of the two turned, changed lanes, or drove ahead; empty where neither did.
        strayed: whether the opponent alone left its lane, in a conflict without a lane change.
        action: of the AV, from the onset to the contact.
        late: whether it braked, and began to do so more than 1 s after the onset.
        braking_mps2: its hardest braking from the onset on, mean over 0.5 s.
        onset_s: from the onset to the contact.
        delta_v_mps: severity.
        opponent: "car", "truck or bus" or another class of road users.
        ran_red: whether the opponent passed a red light.
        stood: whether the opponent stood in the step before the contact.
        person: whether it is a pedestrian or a cyclist.
        emerged: what hid a person from the AV just before the onset: "a standing car"; else empty.
        on_crossing: whether a person was on a pedestrian crossing.
    """

    meeting: Meeting
    onset: int
    conflict: ConflictType
    side: Side
    priority: Who
    turned: Who
    strayed: bool
    action: Action
    late: bool
    braking_mps2: float
    onset_s: float
    delta_v_mps: float
    opponent: str
    ran_red: bool
    stood: bool
    person: bool = False
    emerged: str = ""
    on_crossing: bool = False

    @property
    def av_crosses(self) -> bool:
        """Whether the AV turns across the way of the other, and does not have priority.

        It gives way then, also to an oncoming vehicle that leaves its lane.
        """
        return self.conflict in ACROSS and self.turned == "AV" and self.priority != "AV"


@once
def hit_of(episode: Episode) -> Hit | None:
    """The hit of an attack; None for a miss."""
    rollout, case = episode.rollout, episode.case
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    try:
        ran_red = bool(red_light.compute(episode))
    except NotMeasurable:  # no lights are known, or the policy never drove
        ran_red = False
    alone = counterfactual(rollout, case, contact.second_id)
    return described(rollout, case.road, alone, begin=rollout.now, ran_red=ran_red)


def described(
    rollout: Rollout, road: RoadMap | None, alone: Counterfactual | None, *, begin: int,
    ran_red: bool,
) -> Hit:  # fmt: skip
    """The hit of a rollout.

    Args:
        rollout: with a contact of AV and opponent. Raises ValueError without.
        road: its map, where that is known.
        alone: where the opponent would have been without the attack, where that is known.
        begin: step at which the attack began.
        ran_red: whether the opponent passed a red light.
    """
    contact = rollout.first("av_opponent")
    if contact is None:
        raise ValueError("the opponent did not hit the AV")
    tracks = rollout.tracks
    meeting = Meeting.of(tracks, (contact.first_id, contact.second_id), contact.step, road)
    kind = tracks.kinds[meeting.other]
    onset = first = max(begin, meeting.since)
    if first < contact.step:
        onset = onset_of(rollout, alone, meeting.other, first, contact.step, road)
    turned = meeting.turned()
    by_foot, person = kind == "pedestrian", is_person(tracks, meeting.other)
    ran_red = ran_red and not by_foot
    strayed = not by_foot and meeting.type in _ON_LANES and meeting.strayed()
    judged = not strayed or ran_red
    priority = _priority(rollout, meeting, turned, ran_red=ran_red) if judged else ""
    if person and road is not None and not ran_red:
        first_goes = crossings.priority(rollout, road, meeting)
        priority = priority if first_goes is None else first_goes
    late, braking_mps2 = _braking(tracks, meeting.av, onset, contact.step, rollout.dt_s)
    return Hit(
        meeting=meeting,
        onset=onset,
        conflict=meeting.type,
        side=meeting.side(onset),
        priority=priority,
        turned=_joining(turned, meeting.type, priority),
        strayed=strayed,
        action=_action(tracks, meeting.av, onset, contact.step, road),
        late=late,
        braking_mps2=braking_mps2,
        onset_s=round((contact.step - onset) * rollout.dt_s, 3),
        delta_v_mps=contact.delta_v_mps,
        opponent=road_user(kind, tracks.size_m[meeting.other]).noun,
        ran_red=ran_red,
        stood=bool(tracks.speed_mps[meeting.other, max(contact.step - 1, 0)] <= STANDING_MPS),
        person=person,
        emerged=emerged_from(rollout, road, meeting.other, onset) if person else "",
        on_crossing=person and road is not None and crossings.on_crossing(rollout, road, meeting),
    )


def _joining(turned: Who, conflict: ConflictType, priority: Who) -> Who:
    """Of merging roads the one without priority joins the other, where that is known."""
    if conflict != "merging" or not priority:
        return turned
    return "opponent" if priority == "AV" else "AV"


def _action(tracks: Tracks, av: int, onset: int, contact: int, road: RoadMap | None) -> Action:
    """What the AV did from the onset up to the step before the contact."""
    speed = tracks.speed_mps[av, onset : max(contact, onset + 1)]
    if speed.max() <= STANDING_MPS:
        return "stood"
    last = tracks.speed_mps[av, max(contact - _STOPPED_STEPS, 0) : contact]
    if speed.max() > _CHANGED_MPS and last.max(initial=0.0) <= WAITING_MPS:
        return "stopped"
    if road is not None and _steers(tracks, av, onset, contact, road):
        return "steered"
    return _by_speed(speed)


def _by_speed(speed: Floats) -> Action:
    """Of speeds (K) without a stop: what changed most up to the end."""
    lost = float(speed.max() - speed[-1])
    won = float(speed[-1] - speed[speed.argmax() :].min())  # it may brake, and then drive on
    if lost > _CHANGED_MPS and lost >= won:
        return "braked"
    if speed[0] <= STANDING_MPS:
        return "set off"
    return "accelerated" if max(won, speed[-1] - speed[0]) > _CHANGED_MPS else "held speed"


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


def _priority(rollout: Rollout, meeting: Meeting, turned: Who, *, ran_red: bool) -> Who:
    """Which had priority: by the lights, or that which does not turn, change lanes or follow.

    Else by the map.
    """
    kind, road = meeting.type, meeting.road
    if ran_red:
        return "AV"
    if kind == "rear-end":
        return turned  # the follower has to keep its distance
    by_lights = _by_lights(rollout, meeting, road) if road and kind in _AT_LIGHTS else ""
    if by_lights:
        return by_lights
    if kind in {"lane change", *ACROSS}:
        return "AV" if turned == "opponent" else "opponent"
    return _by_map(meeting) if kind != "head-on" else ""


_AT_LIGHTS: Final = {"crossing", "merging", *ACROSS}


def _by_lights(rollout: Rollout, meeting: Meeting, road: RoadMap) -> Who:
    """The one whose light let it go, where that of the other did not."""
    place = meeting.tracks.position_m[meeting.av, meeting.step]
    mine, theirs = (lights_passed(rollout, road, row, place) for row in (meeting.av, meeting.other))
    stops = FORBIDS | STOP_FIRST
    if mine & GOES and theirs and theirs <= stops:
        return "AV"
    return "opponent" if theirs & GOES and mine and mine <= stops else ""


def _by_map(meeting: Meeting) -> Who:
    road = meeting.road
    if road is None:
        return ""
    mine, theirs = meeting.driven(0), meeting.driven(1)
    yields = gives_way(road, mine, theirs), gives_way(road, theirs, mine)
    if yields[0] == yields[1]:
        return ""
    return "opponent" if yields[0] else "AV"
