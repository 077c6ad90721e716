"""``tracks.csv.gz`` of a run -> how AV and opponents drove, and which lanes the AV was on."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints, RoadMap
from deepmf_sumo.errors import UsageError
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import distance_m
from deepmf_sumo.network import matching
from deepmf_sumo.results import stored
from deepmf_sumo.risk.places import Movement, Places, Spot

_NUMBERS: Final = ("step", "time_s", "x_m", "y_m", "heading_rad", "length_m", "width_m", "z_m")
_PIECE: Final = 1 << 20
"""Characters that are looked at in one go."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Driven:
    """AV (row 0) and opponents (the others) at T steps.

    Attributes:
        ids: (A) of the opponents; the AV's, before them, is empty.
        position_m: (A, T, 2) box centres. heading_rad, z_m: (A, T). size_m: (A, 2).
        valid: (A, T) False where one is not there. now: step at which the simulation took over.
    """

    ids: tuple[str, ...]
    position_m: Floats
    heading_rad: Floats
    z_m: Floats
    size_m: Floats
    valid: Bools
    now: int

    def nearest_step(self, opponent: str, first: int, last: int) -> int | None:
        """When the gap to an opponent was least, after one step and up to another.

        None where they were never there together.
        """
        if opponent not in self.ids:
            return None
        row = self.ids.index(opponent)
        steps: Ints = np.flatnonzero(self.valid[0] & self.valid[row])
        steps = steps[(steps > first) & (steps <= last)]
        if not len(steps):
            return None
        position, heading = self.position_m[:, steps], self.heading_rad[:, steps]
        gap_m = boxes.gap(
            position[0], heading[0], self.size_m[0], position[row], heading[row], self.size_m[row]
        )
        gap_m = distance_m(gap_m, self.z_m[0, steps], self.z_m[row, steps])
        return int(steps[gap_m.argmin()])

    def lanes(self, road: RoadMap, who: str = "") -> tuple[str | None, ...]:
        """(T) the lane under the centre of an opponent, or the AV; None where it is on none."""
        row = self.ids.index(who)
        found = matching.match(
            road, self.position_m[row], self.heading_rad[row], self.valid[row], self.z_m[row]
        )
        return found.lane_ids


def read_tracks(file: Path, opponents: Sequence[str]) -> Driven:
    """How the AV and its opponents drove.

    Raises UsageError where the file is missing or damaged.
    """
    rows: dict[str, list[list[float]]] = {one: [] for one in ("", *opponents)}
    try:
        with stored.tracks(file) as stream:
            for row in csv.DictReader(_of_interest(stream, opponents)):
                one = "" if row["role"] == "av" else row["id"]
                if one in rows:
                    row.setdefault("z_m", "0")  # results of older versions have no heights
                    rows[one].append([float(row[name]) for name in _NUMBERS])
        return _driven({one: np.array(found) for one, found in rows.items() if found})
    except FileNotFoundError:
        raise UsageError(f"{file} is missing; run it anew.") from None
    except (OSError, ValueError, LookupError, TypeError, MemoryError, csv.Error) as error:
        raise UsageError(f"{file} is damaged ({error}); run it anew.") from None


def _of_interest(stream: TextIO, opponents: Sequence[str]) -> Iterator[str]:
    """The first line, and those that may be of the AV or an opponent: most are of others."""
    marks = (",av,", *(one.replace('"', '""') for one in opponents))
    yield stream.readline()
    rest = ""
    while piece := stream.read(_PIECE):
        whole, newline, rest = (rest + piece).rpartition("\n")
        yield from _marked(whole + newline, marks)
    yield from _marked(rest, marks)


def _marked(text: str, marks: Iterable[str]) -> Iterator[str]:
    """The lines with any of the marks, in order: most lines are never looked at one by one."""
    begins = set()
    for mark in marks:
        at = text.find(mark)
        while at >= 0:
            begins.add(text.rfind("\n", 0, at) + 1)
            end = text.find("\n", at)
            at = text.find(mark, end) if end >= 0 else -1
    for begin in sorted(begins):
        end = text.find("\n", begin)
        yield text[begin:] if end < 0 else text[begin : end + 1]


def _driven(tables: Mapping[str, Floats]) -> Driven:
    """Of the rows (K, columns) of each; the AV is there at the start."""
    every = np.concatenate([table[:, 0] for table in tables.values()])
    if not (every.min() >= 0 and every.max() < stored.MOST_STEPS):
        raise ValueError(f"a step is not within 0 and {stored.MOST_STEPS}")
    steps = 1 + int(every.max())
    shape = len(tables), steps
    position, heading, z_m = np.zeros((*shape, 2)), np.zeros(shape), np.zeros(shape)
    size, valid = np.zeros((len(tables), 2)), np.zeros(shape, bool)
    for row, table in enumerate(tables.values()):
        at = table[:, 0].astype(int)
        position[row, at], heading[row, at] = table[:, 2:4], table[:, 4]
        size[row], valid[row, at], z_m[row, at] = table[0, 5:7], True, table[:, 7]
    of_av = tables[""]
    return Driven(
        ids=tuple(tables),
        position_m=position,
        heading_rad=heading,
        z_m=z_m,
        size_m=size,
        valid=valid,
        now=int(of_av[np.abs(of_av[:, 1]).argmin(), 0]),
    )


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
