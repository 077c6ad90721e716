"""Where the AV of a run, or its opponent, was on the network, step by step."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from deepmf_sumo.benchmark.risk.driven import Driven
from deepmf_sumo.benchmark.risk.places import Movement, Places, Spot
from deepmf_sumo.datatypes import Floats

OFF: Final = Spot()
"""On no lane and in no junction."""
_SAME_PLACE_M: Final = 3.0
"""Lanes inside a junction that are nearer than this to the AV may be the one that it is on."""
_ALONG: Final = "along"
"""In ``moments.csv``: the AV comes to no junction while it is attacked."""


class Spots:
    """The places of an AV, or of an opponent.

    Args:
        tracks: of the run.
        lanes: (T) under it, of `Driven.lanes`.
        every: the network's places.
        moment: row of ``moments.csv``: the edge at the start, the one that follows on the route,
            and the turn between them; empty where no moments were chosen, and for opponents.
        who: id of the opponent; empty for the AV.
    """

    def __init__(
        self,
        tracks: Driven,
        lanes: Sequence[str | None],
        every: Places,
        moment: Mapping[str, str],
        who: str = "",
    ) -> None:
        self._tracks, self._lanes, self._places = tracks, lanes, every
        self._row = tracks.ids.index(who)
        route = moment.get("edge", ""), moment.get("following", "")
        self._next = every.movement(*route)
        self._turns = self._next is not None and moment.get("turn") != _ALONG

    def at(self, step: int) -> Spot:
        """Where the centre was at a step."""
        if not self._tracks.valid[self._row, step]:
            return OFF
        lane = self._lanes[step]
        place_m: Floats = self._tracks.position_m[self._row, step]
        if lane is None:
            junction = self._places.within(place_m)
            return self._places.in_junction(junction, self._passed(step)) if junction else OFF
        return self._on_route(self._places.spot(lane), place_m)

    def began(self, step: int) -> Spot:
        """Where it was at a step, and the movement that was next on its way."""
        spot = self.at(step)
        if spot.movement:
            return spot
        chosen = self._turns and step == self._tracks.now
        ahead = self._next if chosen else self._driven_next(step)
        if ahead is None:
            return spot
        return Spot(lane=spot.lane, edge=spot.edge, junction=ahead.junction, movement=ahead.id)

    def _passed(self, step: int) -> Movement | None:
        """Where a network has no lanes in junctions: by the edges before and behind."""
        edges = [self._places.spot(lane).edge if lane else "" for lane in self._lanes]
        before = next((edge for edge in reversed(edges[:step]) if edge), "")
        behind = next((edge for edge in edges[step:] if edge), "")
        known = self._places.movement(before, behind)
        return self._next if known is None else known

    def _driven_next(self, begin: int) -> Movement | None:
        """The first movement that the AV came to by itself."""
        for lane in self._lanes[begin:]:
            name = self._places.spot(lane).movement if lane else ""
            if name:
                return self._places.movements[name]
        return None

    def _on_route(self, spot: Spot, place_m: Floats) -> Spot:
        """Lanes inside a junction lie over each other: of those at hand, the route's is meant."""
        known, planned = self._places.movements.get(spot.movement), self._next
        if known is None or planned is None or known.origin != planned.origin:
            return spot
        if known.id == planned.id:
            return spot
        for lane in planned.lanes:
            if _distance_m(self._places.lanes[lane].shape_m[:, :2], place_m) <= _SAME_PLACE_M:
                return self._places.spot(lane)
        return spot


def _distance_m(line_m: Floats, place_m: Floats) -> float:
    """Of a place (2,) from a line (P, 2)."""
    start, way = line_m[:-1], np.diff(line_m, axis=0)
    square = np.maximum((way**2).sum(axis=1), 1e-12)
    share = np.clip(((place_m - start) * way).sum(axis=1) / square, 0.0, 1.0)
    nearest = start + share[:, None] * way - place_m
    return float(np.hypot(nearest[:, 0], nearest[:, 1]).min())
