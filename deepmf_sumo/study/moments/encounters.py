"""Which vehicles meet at a junction without an attack, and how closely."""

from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.scene import Bools, Floats, Ints
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.study.moments.moment import SEEN_S, opponents
from deepmf_sumo.sumo.network.sumo_net import NetFile, Way, junctions, meeting_ways, waiting_ways
from deepmf_sumo.sumo.simulation.traffic_survey import EVERY_S, Sightings

_ROUNDING_S: Final = 0.05
_FASTER_MPS: Final = 10.0
"""No vehicle gains more speed in a second: one that has gone farther was teleported."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Passages:
    """P vehicles through junctions, in no order.

    Attributes:
        ways: names of the edge before the junction and of the one behind it, each pair once.
        vehicle, way: (P) index.
        entered_s, left_s: (P) good to about half a second. A vehicle that waits inside, to turn
            left, enters when it goes on: one that passes meanwhile does not meet it.
    """

    ways: tuple[tuple[str, str], ...]
    vehicle: Ints
    way: Ints
    entered_s: Floats
    left_s: Floats


def passages(sightings: Sightings, waiting: Set[Way] = frozenset()) -> Passages:
    """Vehicles that were on an edge, and within a second in or behind the junction at its end.

    One that passes two junctions in a second is seen at both, one that passes more not at those
    between. Jumps of teleported vehicles do not count, and of a vehicle that is inside a junction
    when first seen nothing is known. ``waiting`` are paths with a position to wait inside.
    """
    steps = _Steps(sightings)
    over = steps.over
    inside = steps.inside
    # from an edge into the junction at its end, or over it
    enters = np.flatnonzero(steps.joined & ~inside[:-1] & (inside[1:] | over))
    fraction = np.clip(steps.to_end_m[enters] / np.maximum(steps.way_m[enters], 1e-9), 0.0, 1.0)
    took_s = steps.time_s[enters + 1] - steps.time_s[enters]
    first = steps.passed(enters, steps.edge[enters], steps.following[enters])
    entered_s = steps.time_s[enters] + fraction * took_s
    # over a junction and a short edge, and into the next junction or over it
    again = np.flatnonzero(steps.joined & over & inside[1:])
    into = steps.passed(again + 1, steps.edge[again + 1], steps.following[again + 1])
    skips = np.flatnonzero(steps.joined & over & (steps.edge[1:] != steps.following[:-1]))
    short = steps.passed(skips, steps.following[skips], steps.edge[skips + 1])
    late_s = [steps.time_s[again + 1], (steps.time_s[skips] + steps.time_s[skips + 1]) / 2]
    parts = [first, into, short]
    vehicle, before, after, left_s = (np.concatenate(one) for one in zip(*parts, strict=True))
    entered_s = np.concatenate([entered_s, *late_s])
    stood_s = np.full(len(entered_s), -np.inf)
    stood_s[: len(enters)] = steps.stood_s(enters)
    known = (before >= 0) & (after >= 0)
    both = np.column_stack([before, after])[known].reshape(-1, 2)
    pairs, way = np.unique(both, axis=0, return_inverse=True)
    ways = tuple((sightings.edges[one], sightings.edges[two]) for one, two in pairs)
    may_wait = np.array([one in waiting for one in ways], bool)[way.ravel()]
    entered_s = np.where(may_wait, np.maximum(entered_s, stood_s)[known], entered_s[known])
    return Passages(
        ways=ways,
        vehicle=vehicle[known],
        way=way.ravel(),
        entered_s=entered_s,
        left_s=np.maximum(left_s[known], entered_s),
    )


class _Steps:
    """Sightings vehicle by vehicle, and what happens between one and the next (S - 1).

    Attributes:
        joined: it is the same vehicle, a second later at most, and it drove. over: onto another
            edge. inside: (S) a junction.
    """

    def __init__(self, seen: Sightings) -> None:
        order = np.lexsort((seen.time_s, seen.vehicle))
        self.vehicle, self.time_s = seen.vehicle[order], seen.time_s[order]
        self.edge, self.following = seen.edge[order], seen.following[order]
        self.to_end_m = seen.to_end_m[order]
        self.inside: Bools = self.to_end_m <= 0.0
        self.way_m: Floats = np.hypot(*np.diff(seen.position_m[order], axis=0).T)
        took_s = np.diff(self.time_s)
        self._speed_mps = speed = seen.speed_mps[order]
        drove = self.way_m <= took_s * (np.maximum(speed[:-1], speed[1:]) + _FASTER_MPS)
        same = self.vehicle[1:] == self.vehicle[:-1]
        self.joined: Bools = same & drove & (took_s <= EVERY_S + _ROUNDING_S)
        self.over: Bools = self.edge[1:] != self.edge[:-1]
        ends = np.flatnonzero(np.append(~same | self.over, True)) if len(order) else order
        self._last = ends

    def stood_s(self, rows: Ints) -> Floats:
        """When the vehicles before a junction in these rows last stood inside it; -inf: never."""
        stood = np.where(
            self.inside & (self._speed_mps < WAITING_MPS), np.arange(len(self.inside)), -1
        )
        latest = np.maximum.accumulate(stood)[self._last[np.searchsorted(self._last, rows)]]
        then = np.minimum(latest + 1, len(self.time_s) - 1)
        until: Floats = np.where(
            latest > rows, (self.time_s[latest] + self.time_s[then]) / 2, -np.inf
        )
        return until

    def passed(self, rows: Ints, before: Ints, after: Ints) -> tuple[Ints, Ints, Ints, Floats]:
        """Vehicle, edges and when it left: midway between its last sighting there and the next."""
        last = self._last[np.searchsorted(self._last, rows)]
        then = np.minimum(last + 1, len(self.time_s) - 1)
        goes_on = self.vehicle[then] == self.vehicle[last]
        left_s = np.where(goes_on, (self.time_s[last] + self.time_s[then]) / 2, self.time_s[last])
        return self.vehicle[rows], before, after, left_s


NEAR_S: Final = 5.0
"""Longest time between a vehicle leaving the junction and another entering it."""
STEP_S: Final = 1.0
"""Encounters that differ by less are equal: they are not known better."""
LEAD_S: Final = (3.0, 8.0)
"""After an attack's beginning: sooner it cannot be influenced, later the traffic is different."""
FROM_M: Final = 80.0
"""A vehicle that meets the AV within seconds may be this far away; beyond it none is chosen."""
_STEPS: Final = int(NEAR_S / STEP_S)
_RANKS: Final = 2 * _STEPS
NONE: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encounters:
    """Of each of K sightings the encounter that an attack beginning there would have.

    Attributes:
        rank: (K) 0 is the best; those without an encounter have the last rank.
        apart_s: (K) time between the two, 0 where both are in the junction together; nan
            where there is none.
        other: (K) index of the vehicle that is met; -1 where there is none, or it is not there yet
            or farther away than `FROM_M`.
        junctions: by edge, as of `sumo.network.sumo_net`.
    """

    rank: Ints
    apart_s: Floats
    other: Ints
    junctions: Mapping[str, str]

    @property
    def kind(self) -> Ints:
        """(K) 0 comes when it suits, 1 at another time of the attack, `NONE` not at all."""
        return self.rank // _RANKS


def encounters(sightings: Sightings, net: NetFile, duration_s: float) -> Encounters:
    """Look ahead from each sighting, as far as an attack lasts.

    First come those at a time within `LEAD_S`, of them those with the least time between the two,
    and of these the AVs that come second: an AV that waits for the other vehicle meets it at
    whatever speed its planner drives, one that comes first only if its planner is as fast as SUMO's
    driver.
    """
    passed = passages(sightings, waiting_ways(net))
    place = _places(net, passed)
    able = _able(sightings)[passed.vehicle]
    roles, others = _apart(passed, place, meeting_ways(net, passed.ways), able)
    met = np.flatnonzero(np.isfinite(roles).any(axis=0))
    met = met[np.lexsort((passed.entered_s[met], passed.vehicle[met]))]
    vehicle, entered, roles = passed.vehicle[met], passed.entered_s[met], roles[:, met]
    order, apart = _order(roles), roles.min(axis=0)
    other = others[roles.argmin(axis=0), met]
    near = _Near(sightings)
    span = float(sightings.until_s - min(sightings.begin_s, 0.0)) + duration_s + 1.0
    key = np.append(vehicle * span + entered, np.inf)
    rank = np.full(len(sightings.time_s), NONE * _RANKS)
    found, met_by = np.full(len(rank), np.nan), np.full(len(rank), -1)
    ahead = np.searchsorted(key, sightings.vehicle * span + sightings.time_s, "right")
    rows = np.arange(len(rank))
    while len(rows):
        reached = key[ahead] <= sightings.vehicle[rows] * span + sightings.time_s[rows] + duration_s
        rows, ahead = rows[reached], ahead[reached]
        lead_s = entered[ahead] - sightings.time_s[rows]
        there = near(rows, other[ahead])
        suits = there & (lead_s >= LEAD_S[0]) & (lead_s <= LEAD_S[1])
        new = order[ahead] + _RANKS * ~suits
        better = new < rank[rows]
        rank[rows[better]] = new[better]
        found[rows[better]] = apart[ahead[better]]
        met_by[rows[better]] = np.where(there, other[ahead], -1)[better]
        ahead = ahead + 1
    return Encounters(rank=rank, apart_s=found, other=met_by, junctions=junctions(net))


class _Near:
    """Whether a vehicle has been there for a moment, and is near enough to attack another."""

    def __init__(self, sightings: Sightings) -> None:
        self._sightings = sightings
        self._order = np.lexsort((sightings.time_s, sightings.vehicle))
        self._span = float(sightings.until_s - min(sightings.begin_s, 0.0)) + 1.0
        self._key = self._keys(sightings.vehicle, sightings.time_s)[self._order]
        self._first_s = np.full(len(sightings.bodies), np.inf)
        np.minimum.at(self._first_s, sightings.vehicle, sightings.time_s)

    def __call__(self, rows: Ints, others: Ints) -> Bools:
        """(M) of sightings and the vehicles that they are compared with."""
        seen = self._sightings
        time_s = seen.time_s[rows]
        at = np.searchsorted(self._key, self._keys(others, time_s))
        found = self._order[np.minimum(at, len(self._order) - 1)]
        there = (seen.vehicle[found] == others) & (seen.time_s[found] == time_s)
        way_m = np.hypot(*(seen.position_m[found] - seen.position_m[rows]).T)
        near: Bools = there & (way_m < FROM_M) & (self._first_s[others] <= time_s - SEEN_S)
        return near

    def _keys(self, vehicle: Ints, time_s: Floats) -> Floats:
        keys: Floats = vehicle * self._span + time_s
        return keys


def _order(roles: Floats) -> Ints:
    """(M) of `_apart`'s (2, M): 0 is the best."""
    first, second = np.floor(np.minimum(roles, 2 * NEAR_S) / STEP_S)
    closest = np.minimum(np.minimum(first, second), _STEPS - 1)
    order: Ints = (2 * closest + (second > first)).astype(np.int64)
    return order


def nobody_met(sightings: Sightings) -> Encounters:
    """Of sightings on a network without junctions."""
    many = len(sightings.time_s)
    return Encounters(
        rank=np.zeros(many, np.int64),
        apart_s=np.full(many, np.nan),
        other=np.full(many, -1),
        junctions={},
    )


def _able(sightings: Sightings) -> Bools:
    """(V) whether it can be met."""
    able = np.zeros(len(sightings.bodies), bool)
    able[sightings.vehicle[opponents(sightings)]] = True
    return able


def _places(net: NetFile, passed: Passages) -> Ints:
    """(P) index of the junction."""
    number: dict[str, int] = {}
    ends = [net.edges[way[0]].end if way[0] in net.edges else "" for way in passed.ways]
    return np.array([number.setdefault(end, len(number)) for end in ends], np.int64)[passed.way]


def _apart(
    passed: Passages, place: Ints, meeting: Set[tuple[Way, Way]], able: Bools
) -> tuple[Floats, Ints]:
    """(2, P) time between a passage and the nearest one on a path that meets its own, and whose.

    First of those that it comes before, then of those that it comes after; inf without any.
    Each is compared to those that enter the same junction after it, one after the other, until
    they come too late.
    """
    many = len(passed.ways)
    number = {way: index for index, way in enumerate(passed.ways)}
    codes = np.array([number[one] * many + number[two] for one, two in meeting], np.int64)
    order = np.lexsort((passed.entered_s, place))
    place, way, entered = place[order], passed.way[order], passed.entered_s[order]
    vehicle, left, able = passed.vehicle[order], passed.left_s[order], able[order]
    apart, whose = np.full((2, len(order)), np.inf), np.full((2, len(order)), -1)
    first = np.arange(len(order))
    lag = 1
    while len(first):
        first = first[first + lag < len(order)]
        second = first + lag
        near = (place[first] == place[second]) & (entered[second] - left[first] <= NEAR_S)
        first, second = first[near], second[near]
        meet = np.isin(way[first] * many + way[second], codes) & (vehicle[first] != vehicle[second])
        between = np.where(meet, np.maximum(entered[second] - left[first], 0.0), np.inf)
        for role, one, other in ((0, first, second), (1, second, first)):
            known = np.where(able[other], between, np.inf)
            nearer = known < apart[role, one]
            apart[role, one[nearer]] = known[nearer]
            whose[role, one[nearer]] = vehicle[other[nearer]]
        lag += 1
    back = np.argsort(order)
    return apart[:, back], whose[:, back]
