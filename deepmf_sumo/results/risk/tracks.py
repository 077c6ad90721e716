"""How the AV and its opponents drove in a run -> the places that they were at."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import stored, tracks
from deepmf_sumo.results.risk.places import Movement, Places, Spot
from deepmf_sumo.results.tracks import RecordedTracks
from deepmf_sumo.scene import Floats, Ints, RoadMap
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import distance_m
from deepmf_sumo.sumo.network import matching


def read_tracks(file: Path) -> RecordedTracks:
    """How all road users drove.

    Raises UsageError where the file is missing or damaged.
    """
    try:
        return tracks.read_tracks(file)
    except FileNotFoundError:
        raise UsageError(f"{file} is missing; run it again.") from None
    except stored.DAMAGE as error:
        raise UsageError(f"{file} is damaged ({error}); run it again.") from None


def nearest_step(found: RecordedTracks, opponent: str, first: int, last: int) -> int | None:
    """When the gap of AV and opponent was least, after the step ``first`` and up to ``last``.

    None where they were never there together.
    """
    driven = found.tracks
    if opponent not in driven.ids:
        return None
    pair = [driven.row(found.av_id), driven.row(opponent)]
    steps: Ints = np.flatnonzero(driven.valid[pair].all(axis=0))
    steps = steps[(steps > first) & (steps <= last)]
    if not len(steps):
        return None
    position, heading = driven.position_m[pair][:, steps], driven.heading_rad[pair][:, steps]
    size_m, z_m = driven.size_m[pair, :2], driven.z_m[pair][:, steps]
    gap_m = boxes.gap(position[0], heading[0], size_m[0], position[1], heading[1], size_m[1])
    return int(steps[distance_m(gap_m, z_m[0], z_m[1]).argmin()])


OFF: Final = Spot()
"""On no lane and in no junction."""
_SAME_PLACE_M: Final = 3.0
"""Lanes inside a junction that are nearer than this to the AV may be the one that it is on."""
_ALONG: Final = "along"
"""In ``moments.csv``: the AV comes to no junction while it is attacked."""


class Spots:
    """The places of an AV, or of an opponent.

    Args:
        found: tracks of the run.
        road: map of its network.
        every: the network's places.
        agent_id: of the AV or the opponent.
        moment: row of ``moments.csv``: the edge at the start, the one that follows on the route,
            and the turn between them; empty where no moments were chosen, and for opponents.
    """

    def __init__(
        self,
        found: RecordedTracks,
        road: RoadMap,
        every: Places,
        agent_id: str,
        moment: Mapping[str, str],
    ) -> None:
        driven = found.tracks
        row = driven.row(agent_id)
        self._position_m, self._valid = driven.position_m[row], driven.valid[row]
        heading, self._z_m = driven.heading_rad[row], driven.z_m[row]
        matched = matching.match(road, self._position_m, heading, self._valid, self._z_m)
        self._lanes, self.places, self._now = matched.lane_ids, every, found.now
        self.road = road
        route = moment.get("edge", ""), moment.get("following", "")
        self._next = every.movement(*route)
        self._turns = self._next is not None and moment.get("turn") != _ALONG

    def at(self, step: int) -> Spot:
        """Where the centre was at a step."""
        if not self._valid[step]:
            return OFF
        lane = self._lanes[step]
        place_m: Floats = self._position_m[step]
        if lane is None:
            junction = self.places.within(place_m, float(self._z_m[step]))
            return self.places.in_junction(junction, self._passed(step)) if junction else OFF
        return self._on_route(self.places.spot(lane), place_m)

    def began(self, step: int) -> Spot:
        """Where it was at a step, and the next movement on its path."""
        spot = self.at(step)
        if spot.movement:
            return spot
        chosen = self._turns and step == self._now
        ahead = self._next if chosen else self._driven_next(step)
        if ahead is None:
            return spot
        return Spot(lane=spot.lane, edge=spot.edge, junction=ahead.junction, movement=ahead.id)

    def _passed(self, step: int) -> Movement | None:
        """Where a network has no lanes in junctions: by the edges before and behind."""
        edges = [self.places.spot(lane).edge if lane else "" for lane in self._lanes]
        before = next((edge for edge in reversed(edges[:step]) if edge), "")
        behind = next((edge for edge in edges[step:] if edge), "")
        known = self.places.movement(before, behind)
        return self._next if known is None else known

    def _driven_next(self, begin: int) -> Movement | None:
        """The first movement that the AV came to by itself."""
        for lane in self._lanes[begin:]:
            name = self.places.spot(lane).movement if lane else ""
            if name:
                return self.places.movements[name]
        return None

    def _on_route(self, spot: Spot, place_m: Floats) -> Spot:
        """Lanes inside a junction lie over each other: of those at hand, the route's is meant."""
        known, planned = self.places.movements.get(spot.movement), self._next
        if known is None or planned is None or known.origin != planned.origin:
            return spot
        if known.id == planned.id:
            return spot
        for lane in planned.lanes:
            if _distance_m(self.places.lanes[lane].shape_m[:, :2], place_m) <= _SAME_PLACE_M:
                return self.places.spot(lane)
        return spot


def _distance_m(line_m: Floats, place_m: Floats) -> float:
    """Of a place (2,) from a line (P, 2)."""
    start, leg = line_m[:-1], np.diff(line_m, axis=0)
    square = np.maximum((leg**2).sum(axis=1), 1e-12)
    share = np.clip(((place_m - start) * leg).sum(axis=1) / square, 0.0, 1.0)
    nearest = start + share[:, None] * leg - place_m
    return float(np.hypot(nearest[:, 0], nearest[:, 1]).min())
