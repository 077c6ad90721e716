"""Conflicts between any two road users of plain traffic, with the measures of a conflict study.

Measures and classes are those of FHWA's Surrogate Safety Assessment Model (Gettman, Pu, Sayed,
Shelby: Surrogate Safety Assessment Model and Validation, FHWA-HRT-08-051, 2008): a conflict is a
time to collision below a limit and a post-encroachment time below another one.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple, get_args

import numpy as np
import shapely

from deepmf_sumo.judge.metrics.conflict import MovingBox, time_to_collision
from deepmf_sumo.scene import Bools, Floats, Ints
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.ground import clear

SsamType = Literal["rear end", "lane change", "crossing"]
SSAM_TYPES: Final[tuple[SsamType, ...]] = get_args(SsamType)
REAR_END_DEG: Final = 30.0
CROSSING_DEG: Final = 85.0
NOT_SHARED: Final = "that passed no common place within the limit of PET"
CUT_OFF: Final = "too near to the end for both to pass"
_BEFORE_S: Final = 1.0
"""Lanes are compared with those of this time before the conflict: without a model of changing
lanes SUMO changes within a step, and the time to collision is short only after it."""
_SPAN_S: Final = 0.2
"""Over which a deceleration is taken, as `conflict.slowing`."""
_BLOCK: Final = 100_000
"""Pairs that are looked at together."""
_REACH_M: Final = 0.01
"""Added to the areas that may meet, against rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RoadUserMotions:
    """V road users at steps of an equal length: K sightings.

    Attributes:
        dt_s: length of a step.
        size_m: (V, 2) length and width.
        parts: (V) the road user that each is a part of, else its own index: ascending. A vehicle
            that bends is several boxes. None: no road user has parts.
        on_foot: (V) whether it walks: two of these have no conflict. None: none of them walks.
        step: (K) not decreasing. body: (K) index of the road user, ascending within a step.
        position_m: (K, 2) box centres. heading_rad, speed_mps, z_m: (K).
        lane: (K) index of a lane. edge_of_lane: (L) index of the lane's edge.
    """

    dt_s: float
    size_m: Floats
    step: Ints
    body: Ints
    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    z_m: Floats
    lane: Ints
    edge_of_lane: Ints
    parts: Ints | None = None
    on_foot: Bools | None = None

    @cached_property
    def whole(self) -> Ints:
        """(V) ``parts``."""
        return np.arange(len(self.size_m)) if self.parts is None else self.parts

    @cached_property
    def velocity_mps(self) -> Floats:
        """(K, 2) along the headings."""
        velocity: Floats = self.speed_mps[:, None] * frames.unit(self.heading_rad)
        return velocity

    @cached_property
    def _order(self) -> Ints:
        return np.lexsort((self.step, self.body))

    @cached_property
    def _begins(self) -> Ints:
        bodies = np.arange(len(self.size_m) + 1)
        return np.searchsorted(self.body[self._order], bodies)

    def rows(self, body: int, first: int, last: int) -> Ints:
        """Sightings of a road user at the steps from ``first`` to ``last``, in order."""
        own = self._order[self._begins[body] : self._begins[body + 1]]
        begin, end = np.searchsorted(self.step[own], [first, last + 1])
        found: Ints = own[begin:end]
        return found

    def moving(self, rows: Ints) -> MovingBox:
        """The road users of sightings (K)."""
        return MovingBox(
            self.position_m[rows],
            self.heading_rad[rows],
            self.velocity_mps[rows],
            self.size_m[self.body[rows]],
            self.z_m[rows],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConflictLimits:
    """Largest time to collision and post-encroachment time of a conflict; SSAM's defaults."""

    ttc_s: float = 1.5
    pet_s: float = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficConflict:
    """One conflict of two road users; ``first`` passed their common place before ``second``.

    Attributes:
        first, second: indices of the road users.
        begin, end: first and last step with a time to collision within the limit.
        ttc_s: the least one. ttc_step: when.
        pet_s: least time between the first leaving a place and the second coming onto it.
        pet_rows: sightings of the first and the second at that place.
        ttc_rows: sightings at ``ttc_step``.
        type: SSAM's. angle_deg: of the second's heading to the first's at ``ttc_step``,
            counter-clockwise; positive where it comes from the right.
        max_s_mps: MaxS, largest speed of the two from begin to end.
        delta_s_mps: DeltaS, difference of the velocities at ``ttc_step``.
        max_d_mps2: MaxD, hardest braking of the second from begin to end; 0 if it did not brake.
        delta_v_mps: of the first and the second, if they had collided plastically with the
            velocities of ``ttc_step``; masses are proportional to the areas of the boxes.
        lanes: of the first and the second from begin until the common place was passed.
    """

    first: int
    second: int
    begin: int
    end: int
    ttc_s: float
    ttc_step: int
    pet_s: float
    pet_rows: tuple[int, int]
    ttc_rows: tuple[int, int]
    type: SsamType
    angle_deg: float
    max_s_mps: float
    delta_s_mps: float
    max_d_mps2: float
    delta_v_mps: tuple[float, float]
    lanes: tuple[tuple[int, ...], tuple[int, ...]]


class FoundConflicts(NamedTuple):
    """Conflicts by begin and road users; encounters that are not, by reason."""

    conflicts: tuple[TrafficConflict, ...]
    left_out: Mapping[str, int]


class _Encounter(NamedTuple):
    """Two road users whose time to collision was within the limit."""

    a: int
    b: int
    begin: int
    end: int
    ttc_s: float
    ttc_step: int


def find(motions: RoadUserMotions, limits: ConflictLimits) -> FoundConflicts:
    """All conflicts of all pairs but two on foot; of vehicles of several boxes, of the nearest.

    Steps with a time to collision within the limit belong to one conflict of the pair unless more
    than ``limits.pet_s`` lie between them.
    """
    conflicts: list[TrafficConflict] = []
    left_out: Counter[str] = Counter()
    for one in _encounters(motions, limits):
        found = _conflict(motions, limits, one)
        if found is not None:
            conflicts.append(found)
        else:
            left_out[CUT_OFF if _unfinished(motions, limits, one) else NOT_SHARED] += 1
    conflicts.sort(key=lambda one: (one.begin, one.first, one.second))
    return FoundConflicts(tuple(conflicts), dict(left_out))


def courses(motions: RoadUserMotions, limits: ConflictLimits) -> tuple[Ints, Ints, Floats]:
    """(M) pairs of sightings of one step with a time to collision within the limit, and that time.

    The lower index of a road user comes first.
    """
    found = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))]
    for mine, theirs in _near(motions, limits.ttc_s):
        ttc = time_to_collision(motions.moving(mine), motions.moving(theirs))
        close = ttc <= limits.ttc_s
        found.append((mine[close], theirs[close], ttc[close]))
    mine, theirs, ttc = (np.concatenate(part) for part in zip(*found, strict=True))
    return mine, theirs, ttc


def _near(motions: RoadUserMotions, seconds: float) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of sightings of one step whose boxes may meet within the seconds, in blocks.

    An index of the rectangles, parallel to the axes, around what each box passes over.
    """
    low, high = _swept(motions, seconds)
    ends = (np.flatnonzero(np.diff(motions.step, append=-1)) + 1).tolist()
    held: list[Ints] = []
    begin, count = 0, 0
    for end in ends:
        areas = shapely.box(low[begin:end, 0], low[begin:end, 1], *high[begin:end].T)
        pairs = shapely.STRtree(areas).query(areas)
        of = motions.whole[motions.body[begin:end]]
        others = (pairs[0] < pairs[1]) & (of[pairs[0]] != of[pairs[1]])
        if motions.on_foot is not None:  # people walk close, and SUMO lets them stand in each other
            on_foot = motions.on_foot[motions.body[begin:end]]
            others &= ~(on_foot[pairs[0]] & on_foot[pairs[1]])
        held.append(np.sort(pairs[:, others], axis=0) + begin)
        begin, count = end, count + held[-1].shape[1]
        if count > _BLOCK:
            yield _joined(held)
            held, count = [], 0
    if held:
        yield _joined(held)


def _joined(held: list[Ints]) -> tuple[Ints, Ints]:
    mine, theirs = np.concatenate(held, axis=1)
    return mine, theirs


def _swept(motions: RoadUserMotions, seconds: float) -> tuple[Floats, Floats]:
    """(K, 2) lower and upper corners of rectangles around the boxes' ways."""
    ahead = np.abs(frames.unit(motions.heading_rad))
    half = motions.size_m[motions.body] / 2
    reach = half[:, :1] * ahead + half[:, 1:] * ahead[:, ::-1] + _REACH_M
    moved = motions.velocity_mps * seconds
    low: Floats = motions.position_m - reach + np.minimum(moved, 0.0)
    high: Floats = motions.position_m + reach + np.maximum(moved, 0.0)
    return low, high


def _encounters(motions: RoadUserMotions, limits: ConflictLimits) -> Iterator[_Encounter]:
    mine, theirs, ttc = courses(motions, limits)
    a, b, step = motions.body[mine], motions.body[theirs], motions.step[mine]
    order = np.lexsort((step, motions.whole[b], motions.whole[a]))
    a, b, step, ttc = a[order], b[order], step[order], ttc[order]
    pause = np.diff(step) > limits.pet_s / motions.dt_s
    changes = [np.diff(motions.whole[one]) != 0 for one in (a, b)]
    breaks = np.flatnonzero(changes[0] | changes[1] | pause) + 1
    for part in np.split(np.arange(len(step)), breaks) if len(step) else ():
        least = part[int(ttc[part].argmin())]
        yield _Encounter(
            a=int(a[least]),
            b=int(b[least]),
            begin=int(step[part[0]]),
            end=int(step[part[-1]]),
            ttc_s=float(ttc[least]),
            ttc_step=int(step[least]),
        )


def _unfinished(motions: RoadUserMotions, limits: ConflictLimits, one: _Encounter) -> bool:
    """Whether the two may yet pass a common place when the motions end.

    Both are there then, and the end is near, or one of them stands where it stood.
    """
    last = int(motions.step[-1])
    ends = [motions.rows(body, last, last) for body in (one.a, one.b)]
    if not all(map(len, ends)):
        return False
    if last - one.end <= _window(motions, limits):
        return True
    begins = [motions.rows(body, one.end, one.end) for body in (one.a, one.b)]
    moved = motions.position_m[np.concatenate(ends)] - motions.position_m[np.concatenate(begins)]
    return bool((np.hypot(*moved.T) < motions.size_m[[one.a, one.b], 0]).any())


def _window(motions: RoadUserMotions, limits: ConflictLimits) -> int:
    """Steps after a conflict within which a common place is looked for first."""
    return round((limits.ttc_s + limits.pet_s) / motions.dt_s)


def _conflict(
    motions: RoadUserMotions, limits: ConflictLimits, one: _Encounter
) -> TrafficConflict | None:
    """None where the two passed no common place within the limit."""
    last = int(motions.step[-1])
    soon = min(one.end + _window(motions, limits), last)
    for until in (soon, last):
        rows = motions.rows(one.a, one.begin, until), motions.rows(one.b, one.begin, until)
        passed = _passed(motions, limits, one, *rows)
        if passed is not None or until >= last:
            break
    if passed is None:
        return None
    steps, pair = motions.step[list(passed)], (one.a, one.b)
    if steps[0] > steps[1] or (steps[0] == steps[1] and _ahead(motions, *passed)):
        pair, rows, passed = pair[::-1], rows[::-1], passed[::-1]
    at = [int(motions.rows(body, one.ttc_step, one.ttc_step)[0]) for body in pair]
    angle = float(np.degrees(frames.difference(*motions.heading_rad[at[::-1]])))
    during = np.concatenate([motions.rows(body, one.begin, one.end) for body in pair])
    delta_s = float(np.hypot(*np.diff(motions.velocity_mps[at], axis=0)[0]))
    area_m2 = np.bincount(motions.whole, weights=motions.size_m.prod(axis=1))
    mass = area_m2[motions.whole[list(pair)]]
    delta_v = (delta_s * mass[::-1] / mass.sum()).tolist()
    return TrafficConflict(
        first=pair[0],
        second=pair[1],
        begin=one.begin,
        end=one.end,
        ttc_s=one.ttc_s,
        ttc_step=one.ttc_step,
        pet_s=float(abs(steps[0] - steps[1]) * motions.dt_s),
        pet_rows=passed,
        ttc_rows=(at[0], at[1]),
        type=_type(motions, pair, one, angle),
        angle_deg=angle,
        max_s_mps=float(motions.speed_mps[during].max()),
        delta_s_mps=delta_s,
        max_d_mps2=_braking(motions, pair[1], one),
        delta_v_mps=(delta_v[0], delta_v[1]),
        lanes=(_lanes(motions, rows[0], passed[0]), _lanes(motions, rows[1], passed[1])),
    )


def _passed(
    motions: RoadUserMotions, limits: ConflictLimits, one: _Encounter, mine: Ints, theirs: Ints
) -> tuple[int, int] | None:
    """Sightings of the two on one place with the least time between; None beyond the limit.

    Of the places that one of them covered while the conflict lasted, or up to the limit of the time
    to collision later. Where the other came to none of them, e.g. in a queue before a red light,
    of the first ones later that both came to, for as long again. Of equals that nearest to the
    least time to collision.
    """
    within = round(limits.pet_s / motions.dt_s)
    i, j = _apart(motions.step[mine], motions.step[theirs], within)
    shared = boxes.touching(
        motions.position_m[mine[i]],
        motions.heading_rad[mine[i]],
        motions.size_m[one.a],
        motions.position_m[theirs[j]],
        motions.heading_rad[theirs[j]],
        motions.size_m[one.b],
    )
    possible: Bools = shared & ~clear(motions.z_m[mine[i]], motions.z_m[theirs[j]])
    if not possible.any():
        return None
    steps = np.stack([motions.step[mine[i]], motions.step[theirs[j]]])
    between, early, late = np.abs(steps[0] - steps[1]), steps.min(axis=0), steps.max(axis=0)
    more = round(limits.ttc_s / motions.dt_s)
    soon = possible & (early <= one.end + more)
    later = possible & (late <= late[possible].min() + more)
    allowed = np.flatnonzero(soon if soon.any() else later)
    order = np.lexsort((early[allowed], np.abs(early - one.ttc_step)[allowed], between[allowed]))
    best = allowed[order[0]]
    return int(mine[i[best]]), int(theirs[j[best]])


def _apart(mine: Ints, theirs: Ints, most: int) -> tuple[Ints, Ints]:
    """(M) indices of all pairs of two ascending lists of steps that are at most ``most`` apart."""
    wanted = mine[:, None] + np.arange(-most, most + 1)
    at = np.minimum(np.searchsorted(theirs, wanted), len(theirs) - 1)
    i, offset = np.nonzero(theirs[at] == wanted)
    return i, at[i, offset]


def _ahead(motions: RoadUserMotions, a: int, b: int) -> bool:
    """Whether b is ahead of a, and a not of b: of two in contact it was there first."""
    offset = motions.position_m[b] - motions.position_m[a]
    ahead = frames.unit(motions.heading_rad[[a, b]])
    return bool(offset @ ahead[0] > 0 and -offset @ ahead[1] <= 0)


def _type(
    motions: RoadUserMotions, pair: tuple[int, int], one: _Encounter, angle_deg: float
) -> SsamType:
    """SSAM's class: by the lanes where the two share one at the begin or the end, else by angle."""
    before = one.begin - round(_BEFORE_S / motions.dt_s)
    ways = [motions.lane[motions.rows(body, before, one.end)] for body in pair]
    begins, ends = (np.array([way[end] for way in ways]) for end in (0, -1))
    together = begins[0] == begins[1], ends[0] == ends[1]
    if all(together):
        return "rear end"
    changed_edge = (motions.edge_of_lane[begins] != motions.edge_of_lane[ends]).any()
    if any(together) and not changed_edge:
        return "lane change"
    if abs(angle_deg) < REAR_END_DEG:
        return "rear end"
    if abs(angle_deg) > CROSSING_DEG and not together[0]:
        return "crossing"
    return "lane change"


def _braking(motions: RoadUserMotions, body: int, one: _Encounter) -> float:
    span = round(_SPAN_S / motions.dt_s)
    rows = motions.rows(body, one.begin - span, one.end)
    step, speed = motions.step[rows], motions.speed_mps[rows]
    known = step[span:] - step[:-span] == span
    lost = (speed[:-span] - speed[span:])[known] / (span * motions.dt_s)
    return max(float(lost.max(initial=0.0)), 0.0)


def _lanes(motions: RoadUserMotions, rows: Ints, last: int) -> tuple[int, ...]:
    some = motions.lane[rows[motions.step[rows] <= motions.step[last]]]
    return tuple(dict.fromkeys(some.tolist()))
