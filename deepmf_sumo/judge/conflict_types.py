"""What kind of conflict two road users had, in the words of conflict studies.

The kinds are those of Parker and Zegeer (FHWA-IP-88-027, 1989) and of Gettman et al.
(FHWA-HRT-08-051, 2008). A kind follows from the directions in which the two came, from those in
which they were about to leave, and from whether their roads join. How they drove tells the
directions: an opponent need not keep to its lanes. The lanes of a map tell whether roads join, and
how far a vehicle that has begun to turn would have turned.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import dropwhile, takewhile
from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.judge.accident_types import CUT_IN_S, came_from_beside
from deepmf_sumo.scene import DT_S, Floats, Ints, Lane, RoadMap, Tracks
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.lane_map import width_m
from deepmf_sumo.sumo.network.matching import match

ConflictType = Literal[
    "rear-end", "crossing", "left turn across path", "right turn across path", "merging",
    "lane change", "head-on",
]  # fmt: skip
TYPES: Final[tuple[ConflictType, ...]] = get_args(ConflictType)
DEFINITIONS: Final[Mapping[ConflictType, str]] = {
    "rear-end": "from one direction, one behind the other for the last 3 s",
    "crossing": "from two sides, onto different roads (right angle)",
    "left turn across path": "a left turn across the way of a vehicle that is oncoming or beside",
    "right turn across path": "a right turn across the way of a vehicle that is oncoming or beside",
    "merging": "from two roads onto one",
    "lane change": "from one direction, one into the way or the side of the other",
    "head-on": "in opposite directions when they met, and neither turned across",
}
Side = Literal["left", "right", "ahead", "behind"]
Who = Literal["AV", "opponent", ""]
ACROSS: Final = frozenset({"left turn across path", "right turn across path"})

_BEFORE_STEPS: Final = 40
"""Directions are those of 4 s before the meeting, or of the first step with both."""
_TURNING_RAD: Final = float(np.radians(0.5))
"""Where a vehicle turns more in a step, its turn is looked at from the start."""
_SAME_RAD, _OPPOSITE_RAD, _JOINED_RAD = np.radians([30.0, 135.0, 45.0])
_TURNED_RAD, _AT_JUNCTION_RAD, _BEGUN_RAD, _BEND_RAD = np.radians([45.0, 30.0, 5.0, 45.0])
"""A turn is one of 45 degrees, in a junction of 30, or a begun one on a lane that bends by 45."""
_JUNCTION_M: Final = 60.0
_RECENT_STEPS: Final = 20
"""A junction that was left longer ago does not tell any more where a vehicle came from."""
_ASKEW_RAD: Final = float(np.radians(20.0))
"""A vehicle that is turned more against its lane is about to leave it."""
_OVER_M, _OVER_AT_JUNCTION_M = 0.25, 1.0
"""Beyond the edge of its lane; nothing marks the ways over a junction."""
_BESIDE_M: Final = 1.0
_MOVED_M: Final = 0.3
"""A vehicle that moved less in 3 s stood: it did not change lanes."""
_HOPS: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """How a road user came to where it met the other.

    Attributes:
        lanes: that it drove on, in order, the last one at the meeting; empty where unknown.
        came_rad: direction before it turned.
        position_m, heading_rad, size_m: at the meeting; size: length and width.
        at_lane: whether it was on the last of its lanes at the meeting.
        begun: whether it is known to follow that lane, although it may hardly have turned yet.
    """

    lanes: tuple[str, ...]
    came_rad: float
    position_m: Floats
    heading_rad: float
    size_m: Floats
    at_lane: bool = True
    begun: bool = False

    @classmethod
    def on_lanes(
        cls, road: RoadMap, lanes: Sequence[str], position_m: Floats, heading_rad: float,
        size_m: Floats,
    ) -> "Course":  # fmt: skip
        """Of a vehicle that keeps to its lanes; lanes that the map does not have are left out."""
        known = tuple(lane for lane in lanes if lane in road.lanes)
        inside = next((lane for lane in known if _of_junction(road, lane)), None)
        came = heading_rad if inside is None else _into_rad(road, inside)
        return cls(
            lanes=known,
            came_rad=came,
            position_m=position_m,
            heading_rad=heading_rad,
            size_m=size_m,
            begun=True,
        )


def conflict_type(
    av: Course, opponent: Course, road: RoadMap | None,
    *, from_beside: bool = False, on_foot: bool = False,
) -> ConflictType:  # fmt: skip
    """The kind of a conflict.

    Args:
        av: the one whose axis tells whether the other is behind or beside.
        opponent: the other.
        road: the map that the lanes are of.
        from_beside: whether the one in front came from beside the path of the other just before.
        on_foot: one of them is a pedestrian, who neither changes lanes nor merges but crosses.
    """
    found = _of_vehicles(av, opponent, road, from_beside=from_beside)
    return "crossing" if on_foot and found in {"lane change", "merging"} else found


def _of_vehicles(
    av: Course, opponent: Course, road: RoadMap | None, *, from_beside: bool
) -> ConflictType:
    came = _angle(av.came_rad, opponent.came_rad)
    if came < _SAME_RAD:
        in_line = not from_beside and boxes.end_to_end(*_box(av), *_box(opponent))
        return "rear-end" if in_line else _side_by_side(road, av, opponent)
    turns = _turn_rad(av, road), _turn_rad(opponent, road)
    leaving = _angle(av.came_rad + turns[0], opponent.came_rad + turns[1])
    turned = [turn for turn in turns if turn]
    met = _angle(av.heading_rad, opponent.heading_rad)
    if came > _OPPOSITE_RAD and len(turned) < 2:
        if not turned:
            return "head-on"
        return _across(turned[0])
    if leaving < _JOINED_RAD or _meet(road, av, opponent):
        return "merging"
    return "head-on" if met > _OPPOSITE_RAD else "crossing"


def _across(turn_rad: float) -> ConflictType:
    return "left turn across path" if turn_rad > 0 else "right turn across path"


def _side_by_side(road: RoadMap | None, av: Course, opponent: Course) -> ConflictType:
    """Of two that came from one direction, neither behind the other."""
    if _joins(road, av, opponent):
        return "merging"
    if road is None or _meet(road, av, opponent):
        return "lane change"
    for one, other in ((av, opponent), (opponent, av)):
        turn = _turn_rad(one, road)
        if turn and other.lanes:
            onward = (*other.lanes, *road.lanes[other.lanes[-1]].next)
            if gives_way(road, one.lanes, onward):
                return _across(turn)
    return "lane change"


def gives_way(road: RoadMap, lanes: Iterable[str], others: Iterable[str]) -> bool:
    """Whether any of some lanes gives way to any of others, by the map."""
    first = set(others)
    return any(not first.isdisjoint(road.lanes[lane].gives_way_to) for lane in lanes)


def _angle(one_rad: float, other_rad: float) -> float:
    return abs(float(frames.difference(one_rad, other_rad)))


def _box(one: Course) -> tuple[Floats, float, Floats]:
    return one.position_m, one.heading_rad, one.size_m


def _turn_rad(one: Course, road: RoadMap | None) -> float:
    """By how much it turned, or was about to, left is positive; 0 where it went straight on."""
    driven = float(frames.difference(one.heading_rad, one.came_rad))
    planned = _planned_rad(one, road)
    begun = one.begun or driven * np.sign(planned) >= _BEGUN_RAD
    if abs(planned) >= _BEND_RAD and begun:
        return planned
    least = _AT_JUNCTION_RAD if _inside(one, road) else _TURNED_RAD
    return driven if abs(driven) >= least else 0.0


def _inside(one: Course, road: RoadMap | None) -> bool:
    """Whether its last lane is one of a junction; without a map it may be."""
    return road is None or not one.lanes or _of_junction(road, one.lanes[-1])


def _of_junction(road: RoadMap, lane: str) -> bool:
    """Whether a lane is one of a junction. Recordings do not say so: short lanes that bend are."""
    if road.lanes[lane].interpolating:
        return True
    begin, end = _ends_rad(road, lane)
    if _angle(begin, end) < _BEND_RAD:
        return False
    return float(polylines.arc_lengths(road.lanes[lane].centre_m)[-1]) < _JUNCTION_M


def _planned_rad(one: Course, road: RoadMap | None) -> float:
    """The whole turn of the way inside the junction that a vehicle was on; 0 where it was not."""
    if road is None or not one.lanes or not one.at_lane or not _inside(one, road):
        return 0.0
    return float(frames.difference(_ends_rad(road, _way(one, road)[-1])[1], one.came_rad))


def _way(one: Course, road: RoadMap) -> list[str]:
    """The last of its lanes and those of the junction that follow."""
    way = [one.lanes[-1]]
    for _ in range(_HOPS):
        onward = [name for name in road.lanes[way[-1]].next if _of_junction(road, name)]
        if not onward:
            break
        way.append(onward[0])
    return way


def _into_rad(road: RoadMap, lane: str) -> float:
    """Direction of the road that leads into a lane of a junction, else that lane's at its begin."""
    before = [name for name in road.lanes[lane].previous if not _of_junction(road, name)]
    return _ends_rad(road, before[0])[1] if before else _ends_rad(road, lane)[0]


def _ends_rad(road: RoadMap, lane: str) -> tuple[float, float]:
    """Directions in which a lane begins and ends."""
    step = np.diff(road.lanes[lane].centre_m, axis=0)
    step = step[np.hypot(*step.T) > 0] if len(step) else step
    if not len(step):
        return 0.0, 0.0
    begin, end = np.arctan2(step[[0, -1], 1], step[[0, -1], 0]).tolist()
    return begin, end


def _joins(road: RoadMap | None, av: Course, opponent: Course) -> bool:
    """Whether the two came on different roads, neither of which leads into the other."""
    if road is None or not av.lanes or not opponent.lanes:
        return False
    own, other = (_from(road, one.lanes[0]) for one in (av, opponent))
    return other not in _ahead(road, own) and own not in _ahead(road, other)


def _from(road: RoadMap, lane: str) -> str:
    """The lane of a road that leads to a lane of a junction; itself where none is known."""
    back = lane
    for _ in range(_HOPS):
        before = road.lanes[back].previous if _of_junction(road, back) else ()
        known = [name for name in before if name in road.lanes]
        if not known:
            break
        back = known[0]
    return lane if _of_junction(road, back) else back


def _meet(road: RoadMap | None, av: Course, opponent: Course) -> bool:
    """Whether both are in a junction, on ways onto one road."""
    if road is None:
        return False
    targets = []
    for one in (av, opponent):
        if not one.lanes or not one.at_lane or not _inside(one, road):
            return False
        onto = road.lanes[_way(one, road)[-1]].next
        targets.append(_wide(road, onto))
    return not targets[0].isdisjoint(targets[1])


def _wide(road: RoadMap, lanes: Iterable[str]) -> set[str]:
    """Lanes and those beside them."""
    wide = set(lanes)
    for _ in range(_HOPS):
        wide |= {
            beside.lane_id
            for one in wide
            for beside in (*road.lanes[one].left, *road.lanes[one].right)
        }
    return wide


def _ahead(road: RoadMap, lane: str) -> set[str]:
    """A lane, those beside it, and those that they lead to within a few lanes."""
    found, front = set(), {lane}
    for _ in range(_HOPS + 1):
        wide = _wide(road, front)
        found |= wide
        front = {after for one in wide for after in road.lanes[one].next} - found
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Meeting:
    """AV and opponent up to where they met: a contact, or where the gap was least.

    Attributes:
        av, other: rows of the tracks. step: of the meeting.
        since: step from which on both are there. first: from which on directions are looked at.
        lanes: of AV and opponent, one a step from ``first`` to ``step``; None: on none, or no map.
        courses: of AV and opponent.
        type: of the conflict.
    """

    tracks: Tracks
    av: int
    other: int
    since: int
    first: int
    step: int
    road: RoadMap | None
    lanes: tuple[tuple[str | None, ...], tuple[str | None, ...]]
    courses: tuple[Course, Course]
    type: ConflictType

    @classmethod
    def of(cls, tracks: Tracks, ids: tuple[str, str], step: int, road: RoadMap | None) -> "Meeting":
        """Of the AV and an opponent, by id. Both have to be there at the step."""
        rows = tracks.row(ids[0]), tracks.row(ids[1])
        both = np.asarray(tracks.valid[list(rows)].all(axis=0))
        missing = np.flatnonzero(~both[:step])
        since = int(missing[-1]) + 1 if len(missing) else 0
        change = frames.wrap(np.diff(tracks.heading_rad[list(rows), since : step + 1], axis=1))
        first = since + _before_turns(change)
        lanes = [_lanes(tracks, row, first, step, road) for row in rows]
        before = max(since, step - 1)  # two boxes that touch are neither behind nor beside
        av, other = (
            _course(tracks, row, first, one[: before + 1 - first], road)
            for row, one in zip(rows, lanes, strict=True)
        )
        return cls(
            tracks=tracks,
            av=rows[0],
            other=rows[1],
            since=since,
            first=first,
            step=step,
            road=road,
            lanes=(lanes[0], lanes[1]),
            courses=(av, other),
            type=conflict_type(
                av,
                other,
                road,
                from_beside=_from_beside(tracks, rows, step),
                on_foot=tracks.kinds[rows[1]] == "pedestrian",
            ),
        )

    def local(self, step: int) -> Floats:
        """(2) the opponent ahead of the AV, and to its left."""
        return _local(self.tracks, self.other, self.av, step)

    def side(self, onset: int) -> Side:
        """Where the opponent came from, seen from the AV at the onset of the conflict."""
        ahead, left = self.local(max(onset, self.first))
        if self.type == "rear-end":
            return "ahead" if self.local(self.step)[0] > 0 else "behind"
        av, opponent = self.courses
        came = float(frames.difference(opponent.came_rad, av.came_rad))
        if self.type == "head-on" or abs(came) > _OPPOSITE_RAD:
            return self._kerb() if self.tracks.kinds[self.other] == "pedestrian" else "ahead"
        if abs(came) > _SAME_RAD:
            return "left" if came < 0 else "right"
        if abs(left) > _BESIDE_M:
            return "left" if left > 0 else "right"
        return "ahead" if ahead > 0 else "behind"

    def _kerb(self) -> Side:
        """Side of a pedestrian that comes toward the AV: from beside its way, or along it."""
        tracks, at = self.tracks, (self.av, self.step)
        was_m = tracks.position_m[self.other, self.first : self.step + 1]
        left = frames.to_local(was_m, tracks.position_m[at], float(tracks.heading_rad[at]))[:, 1]
        most = float(left[np.abs(left).argmax()])
        if abs(most) <= _BESIDE_M + tracks.size_m[self.av, 1] / 2:
            return "ahead"
        return "left" if most > 0 else "right"

    def turned(self) -> Who:
        """Which vehicle turned across, changed lanes, or drove ahead; empty where neither did."""
        if self.type == "rear-end":
            return "opponent" if self.local(self.step)[0] > 0 else "AV"
        if self.type in {"crossing", "head-on"}:
            return ""
        if self.type in ACROSS:
            sign = 1.0 if self.type.startswith("left") else -1.0
            turn = [sign * _turn_rad(one, self.road) for one in self.courses]
            return "AV" if turn[0] > turn[1] else "opponent"
        aside = [self.toward_m(which) for which in (0, 1)]
        return "opponent" if aside[1] >= aside[0] else "AV"

    def turn_rad(self, which: int) -> float:
        """By how much AV (0) or opponent (1) turned, left is positive; 0 for straight on."""
        return _turn_rad(self.courses[which], self.road)

    def toward_m(self, which: int) -> float:
        """How far AV (0) or opponent (1) moved sideways of its lane, toward the other, in 3 s.

        Minus infinity for a vehicle that stood.
        """
        row, facing = (self.av, self.other) if which == 0 else (self.other, self.av)
        begin = max(self.first, self.step - round(CUT_IN_S / DT_S))
        steps = np.arange(begin, self.step + 1)
        along = self._directions_rad(which, steps)
        moved = np.diff(self.tracks.position_m[row, steps], axis=0)
        if np.hypot(*moved.T).sum() < _MOVED_M:
            return -np.inf
        left = moved[:, 1] * np.cos(along[1:]) - moved[:, 0] * np.sin(along[1:])
        beside = [_local(self.tracks, facing, row, step)[1] for step in (begin, self.step)]
        toward = beside[0] if abs(beside[0]) > _BESIDE_M / 2 else beside[1]
        return float(left.sum() * np.sign(toward))

    def _directions_rad(self, which: int, steps: Ints) -> Floats:
        """(K) of the lane of one of the two; where it is on none, its first heading goes on."""
        row = self.other if which else self.av
        along = np.full(len(steps), float(self.tracks.heading_rad[row, steps[0]]))
        for at, step in enumerate(steps):
            lane = self.lanes[which][step - self.first]
            if lane is not None and self.road is not None:
                place = self.tracks.position_m[row, step]
                line = self.road.lanes[lane].centre_m
                if len(line) > 1:
                    along[at:] = polylines.project(line, place[None]).heading_rad[0]
        return along

    def strayed(self, which: int = 1) -> bool:
        """Whether the opponent (1) was not on its lane when they met, and the AV (0) on its own.

        Or the other way round. Ways over a junction are taken loosely, by that which did not stray
        in any case, by the other where both are in one.
        """
        before, other = max(self.first, self.step - 1), 1 - which
        if self.road is None or self._off_lane(other, before, loosely=True):
            return False
        lane = self.lanes[other][before - self.first]
        in_junction = lane is not None and _of_junction(self.road, lane)
        return self._off_lane(which, before, loosely=in_junction)

    def _off_lane(self, which: int, step: int, *, loosely: bool) -> bool:
        """Of AV (0) or opponent (1); ``loosely``: on ways over a junction."""
        lane = self.lanes[which][step - self.first]
        if lane is None or self.road is None:
            return True
        row, known = self.other if which else self.av, self.road.lanes[lane]
        if len(known.centre_m) < 2:
            return False
        place = polylines.project(known.centre_m, self.tracks.position_m[row, step][None])
        askew = _angle(self.tracks.heading_rad[row, step], float(place.heading_rad[0]))
        aside_m = float(place.distance_m[0])
        beyond_m = aside_m + (self.tracks.size_m[row, 1] - width_m(known)) / 2
        if beyond_m > _OVER_M and self._beside(known, self.tracks.position_m[row, step]):
            beyond_m = 0.0  # it changes between lanes of one direction
        if loosely and _of_junction(self.road, lane):
            return askew > _TURNED_RAD or beyond_m > _OVER_AT_JUNCTION_M
        return askew > _ASKEW_RAD or beyond_m > _OVER_M

    def _beside(self, lane: Lane, place_m: Floats) -> bool:
        """Whether a place beside a lane is towards one beside it, and not beyond that."""
        road = self.road
        for one in (*lane.left, *lane.right):
            other = None if road is None else road.lanes.get(one.lane_id)
            if other is None or len(other.centre_m) < 2:
                continue
            away = [
                float(polylines.project(each.centre_m, place_m[None]).distance_m[0])
                for each in (lane, other)
            ]
            if sum(away) <= (width_m(lane) + width_m(other)) / 2 + _OVER_M:
                return True
        return False

    def driven(self, which: int) -> list[str]:
        """The lanes of AV (0) or opponent (1), in order, and those that follow the last."""
        lanes = [lane for lane in dict.fromkeys(self.lanes[which]) if lane is not None]
        onward = self.road.lanes[lanes[-1]].next if lanes and self.road is not None else ()
        return [*lanes, *onward]


def _before_turns(change_rad: Floats) -> int:
    """The column of changes (2, K) to begin at: 4 s before the end, or before a turn there."""
    begin = max(0, change_rad.shape[1] - _BEFORE_STEPS)
    while begin > 0 and abs(change_rad[:, begin - 1]).max() > _TURNING_RAD:
        begin -= 1
    return begin


def _lanes(
    tracks: Tracks, row: int, first: int, step: int, road: RoadMap | None
) -> tuple[str | None, ...]:
    span = slice(first, step + 1)
    if road is None:
        return (None,) * (step + 1 - first)
    return match(
        road,
        tracks.position_m[row, span],
        tracks.heading_rad[row, span],
        tracks.valid[row, span],
        tracks.z_m[row, span],
    ).lane_ids


def _course(
    tracks: Tracks, row: int, first: int, lanes: Sequence[str | None], road: RoadMap | None
) -> Course:
    """Of a vehicle that was on these lanes at the steps from ``first`` to the meeting."""
    at = first + len(lanes) - 1
    came = _came_rad(lanes, tracks.position_m[row, at], road)
    return Course(
        lanes=tuple(lane for lane in dict.fromkeys(lanes) if lane is not None),
        came_rad=float(tracks.heading_rad[row, first]) if came is None else came,
        position_m=tracks.position_m[row, at],
        heading_rad=float(tracks.heading_rad[row, at]),
        size_m=tracks.size_m[row, :2],
        at_lane=lanes[-1] is not None,
    )


def _came_rad(
    lanes: Sequence[str | None], position_m: Floats, road: RoadMap | None
) -> float | None:
    """Direction before the junction that a vehicle is in or has just left; else of its lane.

    None where it was on no lane. ``position_m``: (2) at the last of the steps.
    """
    known = [(ago, lane) for ago, lane in enumerate(reversed(lanes)) if lane is not None]
    if road is None or not known:
        return None
    junction = {lane: _of_junction(road, lane) for _, lane in known}
    left = [*dropwhile(lambda one: not junction[one[1]], known)]
    inside = [*takewhile(lambda one: junction[one[1]], left)]
    if inside and inside[0][0] <= _RECENT_STEPS:
        if before := left[len(inside) :]:  # the way over the junction need not be one from there
            return _ends_rad(road, before[0][1])[1]
        return _into_rad(road, inside[-1][1])
    line = road.lanes[known[0][1]].centre_m
    if len(line) < 2:
        return None
    return float(polylines.project(line, position_m[None]).heading_rad[0])


def _from_beside(tracks: Tracks, rows: tuple[int, int], step: int) -> bool:
    """Whether the one in front was entirely beside the other's path in the last seconds."""
    ahead = _local(tracks, rows[1], rows[0], step)[0]
    follower, leader = rows if ahead > 0 else rows[::-1]
    return came_from_beside(tracks, follower, leader, step)


def _local(tracks: Tracks, row: int, of: int, step: int) -> Floats:
    found: Floats = frames.to_local(
        tracks.position_m[row, step],
        tracks.position_m[of, step],
        float(tracks.heading_rad[of, step]),
    )
    return found
