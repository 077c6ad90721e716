"""Sightings -> who passed which junction when."""

from collections.abc import Set
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints
from deepmf_sumo.geometry.slow import WAITING_MPS
from deepmf_sumo.network.sumo_net import Way
from deepmf_sumo.simulation.traffic_survey import EVERY_S, Sightings

_ROUNDING_S: Final = 0.05
_FASTER_MPS: Final = 10.0
"""In a second nobody gets faster by more: who has gone farther was teleported."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Passages:
    """P vehicles through junctions, in no order.

    Attributes:
        ways: names of the edge before the junction and of the one behind it, each pair once.
        vehicle, way: (P) index.
        entered_s, left_s: (P) good to about half a second. Who waits inside, to turn left, enters
            when it goes on: who passes meanwhile does not meet it.
    """

    ways: tuple[tuple[str, str], ...]
    vehicle: Ints
    way: Ints
    entered_s: Floats
    left_s: Floats


def passages(sightings: Sightings, waiting: Set[Way] = frozenset()) -> Passages:
    """Who was on an edge, and within a second in or behind the junction at its end.

    Who passes two junctions in a second is seen at both, who passes more not at those between.
    Jumps of teleported vehicles are none, and of who is inside a junction when first seen nothing
    is known. ``waiting`` are ways with a place to wait inside.
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
        """Until when who is before a junction in these rows stood inside it; -inf if it did not."""
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
