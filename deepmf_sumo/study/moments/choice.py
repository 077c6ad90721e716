"""Sightings -> moments, spread over edges, junction movements and time.

A network is attacked only after its traffic has built up.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.spec.profiles import LONG_S
from deepmf_sumo.study.moments.area import gets_there
from deepmf_sumo.study.moments.encounters import FROM_M, NONE, Encounters, nobody_met
from deepmf_sumo.study.moments.moment import (
    REACH_M,
    FoundMoments,
    Moment,
    WantedMoments,
    around,
    drives,
    opponents,
    suitable,
)
from deepmf_sumo.sumo.network.sumo_net import TURNS, NetFile
from deepmf_sumo.sumo.simulation.traffic_survey import EVERY_S, Ints, Sightings, growth

ALONG: Final = "along"
_CLOSER: Final = 1e-3
"""Weight of how close an encounter is: among equals alone."""

Place = tuple[int, int]
"""An edge, and the next one if the vehicle gets there, else -1."""
Turns = Mapping[tuple[str, str], str]
_WINDOW_S: Final = 60.0
"""Counts are smoothed over this time, or over a tenth of the traffic's time if that is shorter."""
_REACHED: Final = 0.9
"""The number has settled when it comes to this share of its level."""


def choose(
    sightings: Sightings,
    turns: Turns,
    wish: WantedMoments,
    met: Encounters | None = None,
    within: Bools | None = None,
) -> FoundMoments:
    """Draw moments; the same for the same sightings, wish and seed.

    Args:
        sightings: which vehicle is where at which time.
        turns: what it is to drive from an edge to another.
        wish: the moments that are asked for.
        met: encounters that attacks would begin with; None where no vehicles meet, and of attacks
            by people.
        within: (K) whether it is in the area that is attacked; None: it is the whole network.

    Raises UsageError where the wish names a vehicle, a type or a time that is not in the traffic.
    """
    begin = _beginning(sightings, wish)
    from_s, why = begin or (None, "")
    rows, none_at_all = suitable(sightings, wish, from_s, why, within)
    reason = none_at_all
    rows = _again(sightings, wish, rows) if wish.again else _staying(sightings, wish, rows)
    moments: list[Moment] = []
    if len(rows):
        spread = _Spread(sightings, turns, wish, rows, met or nobody_met(sightings))
        moments = spread.draw()
        alone = rows[drives(sightings, wish.duration_s)[rows]] if wish.made_too else rows[:0]
        if not moments and len(alone):  # people are made near it
            by_people = replace(wish, people="made")
            spread = _Spread(sightings, turns, by_people, alone, met or nobody_met(sightings))
            moments = spread.draw()
        if len(moments) < wish.count and wish.people:
            reason = "at other times all vehicles that people could attack are under attack already"
        elif len(moments) < wish.count:
            reason = (
                f"no {'other ' if moments else ''}vehicle that could be the AV has another vehicle"
                f" within {REACH_M:g} m"
            )
    if wish.again and len(moments) < wish.count and not none_at_all:
        reason = "the other vehicles are not there at their times, or no vehicle is near them"
    said = sightings.warnings
    by_time = sorted(range(len(moments)), key=lambda at: (moments[at].start_s, moments[at].av))
    return FoundMoments(
        moments=tuple(moments[at] for at in by_time),
        order=tuple(by_time),
        suitable=len(rows),
        vehicles=len(sightings.bodies),
        begin_s=sightings.begin_s,
        until_s=sightings.until_s,
        complete=sightings.complete,
        reason=reason,
        from_s=from_s,
        from_why=why,
        notes=(*(_notes(sightings, wish, rows, met) if moments and met else ()), *said),
    )


def _notes(
    sightings: Sightings, wish: WantedMoments, rows: Ints, met: Encounters
) -> tuple[str, ...]:
    """What a user should know before anything is attacked."""
    if not met.junctions:
        return ("no two edges meet at any junction of the network: no moment has an encounter",)
    if wish.prefer == "spread":
        return ()
    meeting = len(np.unique(sightings.vehicle[rows[met.kind[rows] != NONE]]))
    if meeting >= wish.count:
        return ()
    if not meeting:
        return ("no vehicle meets another at a junction: all moments are without an encounter",)
    have = "1 vehicle meets" if meeting == 1 else f"{meeting} vehicles meet"
    sentence = (
        f"only {have} another at a junction: some of the {wish.count} moments may be without an"
        " encounter"
    )
    return (sentence,)


def turns_of(net: NetFile) -> dict[tuple[str, str], str]:
    """What it is to drive from an edge to another."""
    return {
        (link.origin.rpartition("_")[0], link.target.rpartition("_")[0]): TURNS[link.direction]
        for link in net.links
        if link.direction in TURNS
    }


@dataclass
class _Used:
    """How often each was chosen."""

    junctions: Counter[str] = field(default_factory=Counter)
    edges: Counter[int] = field(default_factory=Counter)
    turns: Counter[str] = field(default_factory=Counter)
    places: Counter[Place] = field(default_factory=Counter)
    vehicles: dict[int, list[float]] = field(default_factory=lambda: defaultdict(list))


class _Spread:
    """The edge that was chosen least often is next, and of its places one at a rare time.

    With ``both``, junctions that were chosen least often come after edges, and then the place and
    the moment with the least sum of how often that time was chosen and what its encounter lacks: 0
    where it comes when it suits, 1 at another time of the attack, 2 without any.

    Where encounters alone are preferred, the junction that was chosen least often comes first,
    there places with encounters, and at each place the closest encounter; edges of no junction are
    last.
    """

    def __init__(
        self, sightings: Sightings, turns: Turns, wish: WantedMoments, rows: Ints, met: Encounters
    ) -> None:
        rng = np.random.default_rng([wish.seed, 0x5EED])
        self._sightings, self._turns, self._wish = sightings, turns, wish
        self._met, self._prefer = met, wish.prefer
        self._able = opponents(sightings)
        self._used = _Used()
        self._span = _spans(sightings, wish, rows)
        self._taken = np.zeros(wish.found + len(wish.at_s), int)
        self._leaves = _leave(sightings, wish.duration_s)
        self._left: dict[Place, Ints] = {}
        self._spans: dict[Place, Ints] = {}
        self._chances: dict[Place, tuple[Ints, Ints]] = {}  # with `both`: time, kind of encounter
        self._kind: dict[Place, int] = {}
        shuffled = rng.permutation(rows)
        near = gets_there(sightings, wish.duration_s)[shuffled]
        following = np.where(near, sightings.following[shuffled], -1)
        places = np.column_stack([sightings.edge[shuffled], following])
        found, group, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        sorted_by_place = shuffled[np.argsort(group.ravel(), kind="stable")]
        of_place = np.split(sorted_by_place, np.cumsum(count)[:-1])
        for rank in rng.permutation(len(found)):
            (edge, after), mine = found[rank], of_place[rank]
            self._left[int(edge), int(after)] = mine
            self._spans[int(edge), int(after)] = np.unique(self._span[mine])
            self._kind[int(edge), int(after)] = int(met.kind[mine].min())
            self._note_chances((int(edge), int(after)))

    def draw(self) -> list[Moment]:
        """As many moments as are asked for, or all."""
        moments: list[Moment] = []
        while self._left and len(moments) < self._wish.found:
            place = min(self._left, key=self._order)
            moment = self._take(place)
            if moment is not None:
                moments.append(moment)
        return moments

    def _order(self, place: Place) -> tuple[int, ...]:
        used = self._used
        rarest = int(self._taken[self._spans[place]].min())
        spread = used.edges[place[0]], rarest, used.turns[self._turn(place)], used.places[place]
        if self._prefer == "spread":
            return spread
        if self._prefer == "both":
            span, chance = self._chances[place]
            least = int((self._taken[span] + chance).min())
            junction = used.junctions[self._junction(place)]
            return used.edges[place[0]], junction, least, *spread[2:]
        edge, kind = self._sightings.edges[place[0]], self._kind[place]
        says_nothing = kind == NONE and edge not in self._met.junctions
        return says_nothing, used.junctions[self._junction(place)], kind, *spread

    def _take(self, place: Place) -> Moment | None:
        """The next moment of a place; None where it is unsuitable, which leaves it out."""
        rows = self._left[place]
        vehicle = self._sightings.vehicle[rows]
        cost = self._taken[self._span[rows]] + self._leaves[rows].astype(float)
        cost += [len(self._used.vehicles.get(int(one), ())) for one in vehicle]
        rank = self._met.rank[rows]
        if self._prefer == "both":
            cost += self._met.kind[rows] + _CLOSER * rank
        if self._prefer == "encounters":
            cost[rank > rank.min()] = np.inf
        best = int(cost.argmin())
        row = int(rows[best])
        self._left[place] = np.delete(rows, best)
        if len(rows) > 1:
            self._kind[place] = int(self._met.kind[self._left[place]].min())
            self._note_chances(place)
        else:
            del self._left[place]
        if self._too_soon(row):
            return None
        count = around(self._sightings, self._able, row)
        if not count and not self._wish.people and not self._comes_near(row):
            return None
        self._note(row, place)
        return self._moment(row, place, count)

    def _note_chances(self, place: Place) -> None:
        """At which times what kind of encounter is left at a place."""
        if self._prefer == "both":
            rows = self._left[place]
            pairs = np.unique(np.column_stack([self._span[rows], self._met.kind[rows]]), axis=0)
            self._chances[place] = pairs[:, 0], pairs[:, 1]

    def _too_soon(self, row: int) -> bool:
        """Whether the same vehicle is under attack at that time already."""
        starts = self._used.vehicles.get(int(self._sightings.vehicle[row]), ())
        now = self._sightings.time_s[row]
        return any(abs(now - start) < self._wish.duration_s for start in starts)

    def _comes_near(self, row: int) -> bool:
        """Whether a vehicle farther away gets near, because the AV soon meets another one."""
        return (
            (self._prefer != "spread" or bool(self._wish.again))
            and bool(self._met.kind[row] != NONE)
            and around(self._sightings, self._able, row, FROM_M) > 0
        )

    def _note(self, row: int, place: Place) -> None:
        used, sightings = self._used, self._sightings
        used.junctions[self._junction(place)] += 1
        used.edges[place[0]] += 1
        used.turns[self._turn(place)] += 1
        used.places[place] += 1
        used.vehicles[int(sightings.vehicle[row])].append(float(sightings.time_s[row]))
        self._taken[self._span[row]] += 1

    def _moment(self, row: int, place: Place, count: int) -> Moment:
        sightings = self._sightings
        body = sightings.bodies[sightings.vehicle[row]]
        following = int(sightings.following[row])
        apart_s, other = float(self._met.apart_s[row]), int(self._met.other[row])
        return Moment(
            av=body.id,
            av_type=body.type,
            start_s=round(float(sightings.time_s[row]), 1),
            edge=sightings.edges[place[0]],
            following=sightings.edges[following] if following >= 0 else "",
            turn=self._turn(place),
            speed_mps=round(float(sightings.speed_mps[row]), 2),
            around=count,
            encounter_s=None if np.isnan(apart_s) else round(apart_s, 1),
            meets=sightings.bodies[other].id if other >= 0 else None,
        )

    def _junction(self, place: Place) -> str:
        """The one that the edge leads to, or comes from; the edge itself where no vehicles meet."""
        edge = self._sightings.edges[place[0]]
        return self._met.junctions.get(edge, edge)

    def _turn(self, place: Place) -> str:
        if place[1] < 0:
            return ALONG
        names = self._sightings.edges
        return self._turns.get((names[place[0]], names[place[1]]), "straight")


def _spans(sightings: Sightings, wish: WantedMoments, rows: Ints) -> Ints:
    """(K) the part of the time, of as many as moments are asked for."""
    time_s = sightings.time_s
    if wish.at_s:
        nearest: Ints = np.abs(time_s[:, None] - np.array(wish.at_s)).argmin(axis=1)
        return nearest
    first, last = time_s[rows].min(), time_s[rows].max()
    share = (time_s - first) / max(last - first, 1.0)
    part: Ints = np.clip((share * wish.found).astype(np.int64), 0, wish.found - 1)
    return part


def _again(sightings: Sightings, wish: WantedMoments, rows: Ints) -> Ints:
    """Of the rows those of the vehicles and times that are wanted again."""
    wanted = set(wish.again)
    ids = [sightings.bodies[vehicle].id for vehicle in sightings.vehicle[rows]]
    times = np.round(sightings.time_s[rows].astype(float), 1).tolist()
    return rows[[pair in wanted for pair in zip(ids, times, strict=True)]]


def _staying(sightings: Sightings, wish: WantedMoments, rows: Ints) -> Ints:
    """Of the rows for a long attack those that stay half as long as the one that stays longest.

    In a scenario of minutes most others would have left before the second opponent's turn.
    """
    if wish.duration_s <= LONG_S or not len(rows):
        return rows
    last = _last_seen_s(sightings)
    stays_s = np.minimum(last[sightings.vehicle] - sightings.time_s, wish.duration_s)[rows]
    # of those at each time that is asked for, so that a late one keeps a vehicle
    times, group = np.unique(sightings.time_s[rows], return_inverse=True)
    if not wish.at_s:
        group = np.zeros(len(rows), np.int64)
    longest_s = np.zeros(len(times))
    np.maximum.at(longest_s, group, stays_s)
    long: Ints = rows[stays_s >= longest_s[group] / 2]
    return long


def _last_seen_s(sightings: Sightings) -> Floats:
    """(V) of each vehicle."""
    last = np.zeros(len(sightings.bodies))
    np.maximum.at(last, sightings.vehicle, sightings.time_s)
    return last


def _leave(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether it arrives before the attack is over."""
    last = _last_seen_s(sightings)
    until = np.minimum(sightings.time_s + duration_s, sightings.until_s - 1.0)
    leaves: Bools = last[sightings.vehicle] < until
    return leaves


class _Beginning(NamedTuple):
    """From when on moments are chosen, and why, for the end of a sentence; empty if as asked."""

    time_s: float
    why: str = ""


def _beginning(sightings: Sightings, wish: WantedMoments) -> _Beginning | None:
    """When attacks may begin; None where nothing was asked for, or there is no traffic."""
    if wish.from_s is None:
        return None
    if wish.from_s != "settled":
        return _Beginning(wish.from_s)
    return settled(*_counts(sightings))


def _counts(sightings: Sightings) -> tuple[Floats, Floats]:
    """(N) times a second apart, from the first vehicle to the last, and (N) vehicles on the road.

    Parked vehicles, bicycles and trains are left out.
    """
    seen = sightings.time_s[opponents(sightings)]
    if not len(seen):
        return np.zeros(0), np.zeros(0)
    first, last = float(seen.min()), float(seen.max())
    time_s: Floats = np.arange(first, last + EVERY_S / 2, EVERY_S)
    ends = np.searchsorted(seen, time_s + 1e-6, "right")
    begins = np.searchsorted(seen, time_s - 1e-6, "left")
    return time_s, (ends - begins).astype(float)


def settled(time_s: Floats, number: Floats) -> _Beginning | None:
    """When a number of vehicles (N) at times (N) has settled.

    Its level is the median over the second half; it has settled at the first time from which on
    the mean of a minute is 90 % of that. Where the number still grows, it is the middle of the
    time: see `traffic_survey.growth`.
    """
    if not len(number):
        return None
    change = growth(number)
    if change.goes_on:
        return _Beginning(
            float(time_s[len(time_s) // 2]),
            "half of this time: the number of vehicles still grows"
            f" (on average {change.third:.0f} in the third quarter of it, {change.last:.0f} in the"
            " last)",
        )
    level = float(np.median(number[len(number) // 2 :]))
    window = max(1, round(min(_WINDOW_S, len(number) / 10) / EVERY_S))
    mean = np.convolve(number, np.ones(window) / window, "valid")
    reached = np.flatnonzero(mean >= _REACHED * level)
    at = int(reached[0]) if len(reached) else len(number) // 2
    return _Beginning(
        float(time_s[at]), f"when the number of vehicles has settled at about {level:.0f}"
    )
