"""Where an AV was and what it did while it was attacked, up to a contact."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.results.risk import elements
from deepmf_sumo.results.risk.elements import Element
from deepmf_sumo.results.risk.places import Places, Spot
from deepmf_sumo.scene import Floats, RoadMap, Tracks, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import Ground, ground_of, off_level
from deepmf_sumo.scene.geometry.slow import STANDING_MPS

Manoeuvre = Literal[
    "straight on", "left turn", "right turn", "turnaround", "merge", "along a road",
    "lane change", "follows", "stops", "starts", "stands",
]  # fmt: skip
MANOEUVRES: Final[dict[Manoeuvre, str]] = {
    "straight on": "over a junction, straight on",
    "left turn": "over a junction, to the left",
    "right turn": "over a junction, to the right",
    "turnaround": "over a junction, back",
    "merge": "over a junction onto a road that another road joins within 45 degrees",
    "along a road": "between junctions, all the time",
    "lane change": "from a lane to another one of the same edge",
    "follows": "for 1 s at least another vehicle is at most 2 s ahead in its path",
    "stops": "from more than 1 m/s to a standstill",
    "starts": "from a standstill to more than 1 m/s",
    "stands": "all the time",
}
assert tuple(MANOEUVRES) == get_args(Manoeuvre)
_EVERY: Final = 5
NEAR_M: Final = 50.0
"""Road users within this distance of the AV are the traffic around it."""

MANOEUVRE_OF: Final[dict[str, Manoeuvre]] = {
    "straight": "straight on", "left": "left turn", "right": "right turn",
    "turnaround": "turnaround",
}  # fmt: skip
"""By `Movement.turn`."""
_MOVES_MPS: Final = 1.0
_GAP_S, _GAP_M, _FOLLOWS_S = 2.0, 5.0, 1.0
_SAME_RAD: Final = float(np.radians(30.0))
_JOINS_RAD: Final = float(np.radians(45.0))
_AT_LIMIT: Final = 0.9
"""Of the limit; an AV that is slower has no difficulty to keep to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivenUnderAttack:
    """What an AV did.

    Attributes:
        manoeuvres: all of them. elements: of the roads where it was. rules: of right of way, of the
            movements that it drove on, see `places.Movement`.
        near: road users within `NEAR_M` when the attack began.
        at_limit: it drove with 90 % of the speed limit, or more.
    """

    manoeuvres: frozenset[Manoeuvre] = frozenset()
    elements: frozenset[Element] = frozenset()
    rules: frozenset[str] = frozenset()
    near: int = 0
    at_limit: bool = False


NOTHING: Final = DrivenUnderAttack()
"""Of an attack of which no more is known."""


def driven(
    tracks: Tracks,
    av: int,
    spots: Sequence[Spot],
    first: int,
    dt_s: float,
    places: Places,
    road: RoadMap,
) -> DrivenUnderAttack:
    """What the AV, a row of the tracks, did from the step ``first`` on.

    Args:
        tracks: of all road users.
        av: its row.
        spots: where it was in the steps from ``first`` on, one each.
        first: the step at which the attack began.
        dt_s: of a step.
        places: of the network.
        road: its map, for the levels of roads.
    """
    span = slice(first, first + len(spots))
    found = {*_over(spots, places), *_along(spots, places), *_speeds(tracks.speed_mps[av, span])}
    if _follows(tracks, av, span, ground_of(road)) * dt_s >= _FOLLOWS_S - 1e-9:
        found.add("follows")
    movements = [places.movements[name] for name in _movements(spots, places)]
    return DrivenUnderAttack(
        manoeuvres=frozenset(found),
        elements=frozenset(_elements(tracks.position_m[av, span], spots, places)),
        rules=frozenset(rule for one in movements for rule in one.rule.split(" / ") if rule),
        near=_near(tracks, av, first, road),
        at_limit=_at_limit(tracks.speed_mps[av, span], spots, places),
    )


def _movements(spots: Sequence[Spot], places: Places) -> list[str]:
    """Over junctions, those that the AV was on."""
    over = elements.over_junctions(places)
    return [name for name in dict.fromkeys(spot.movement for spot in spots) if name in over]


def _elements(position_m: Floats, spots: Sequence[Spot], places: Places) -> Iterator[Element]:
    """At every fifth step, and the last one."""
    last = len(spots) - 1
    for step in dict.fromkeys((*range(0, last, _EVERY), last)):
        yield from elements.at(places, spots[step], position_m[step])


def _over(spots: Sequence[Spot], places: Places) -> Iterator[Manoeuvre]:
    for name in _movements(spots, places):
        turn = places.movements[name].turn
        if turn in MANOEUVRE_OF:
            yield MANOEUVRE_OF[turn]
        if name in merging(places):
            yield "merge"


def _along(spots: Sequence[Spot], places: Places) -> Iterator[Manoeuvre]:
    if not _movements(spots, places):
        yield "along a road"
    if any(one.edge and one.edge == two.edge and one.lane != two.lane
           for one, two in pairwise(spots)):  # fmt: skip
        yield "lane change"


def _speeds(speed_mps: Floats) -> Iterator[Manoeuvre]:
    stands, moves = speed_mps <= STANDING_MPS, speed_mps > _MOVES_MPS
    if stands.all():
        yield "stands"
    if moves.any() and stands[moves.argmax() :].any():
        yield "stops"
    if stands.any() and moves[stands.argmax() :].any():
        yield "starts"


def _follows(tracks: Tracks, av: int, span: slice, ground: Ground) -> int:
    """In how many steps another vehicle drives or stands ahead in the AV's path."""
    position_m, heading = tracks.position_m[:, span], tracks.heading_rad[:, span]
    away = position_m - position_m[av]
    along, aside = frames.unit(heading[av]), frames.unit(heading[av] + np.pi / 2)
    ahead_m = (away * along).sum(axis=-1)
    left_m = (away * aside).sum(axis=-1)
    length, width = tracks.size_m[:, :2].T[..., None]
    gap_m = ahead_m - (length + length[av]) / 2
    beside = np.abs(left_m) < (width + width[av]) / 2
    alike = np.abs(frames.difference(heading, heading[av])) < _SAME_RAD
    near = gap_m <= np.maximum(_GAP_S * tracks.speed_mps[av, span], _GAP_M)
    leads = (gap_m >= 0) & beside & alike & near
    leads &= tracks.valid[:, span] & tracks.valid[av, span]
    leads[av] = False
    row, at = np.nonzero(leads)
    z_m = tracks.z_m[:, span]
    leads[row, at] = ~ground.apart(
        position_m[av, at], z_m[av, at], position_m[row, at], z_m[row, at]
    )
    return int(leads.any(axis=0).sum())


def _near(tracks: Tracks, av: int, step: int, road: RoadMap) -> int:
    here_m, z_m = tracks.position_m[:, step], tracks.z_m[:, step]
    there = tracks.valid[:, step] & (np.hypot(*(here_m - here_m[av]).T) <= NEAR_M)
    there &= ~off_level(road, here_m[av], float(z_m[av]), here_m, z_m)
    there[av] = False
    return len(agent_ids.wholes(tracks.ids[row] for row in np.flatnonzero(there)))


def _at_limit(speed_mps: Floats, spots: Sequence[Spot], places: Places) -> bool:
    known = ((speed, places.lanes.get(spot.lane)) for speed, spot in
             zip(speed_mps, spots, strict=True))  # fmt: skip
    return any(lane is not None and speed >= _AT_LIMIT * lane.speed_mps for speed, lane in known)


@lru_cache(maxsize=8)
def merging(places: Places) -> frozenset[str]:
    """Movements onto an edge that another one leads to from a direction within 45 degrees."""
    by_target: dict[str, set[str]] = {}
    movements = [places.movements[name] for name in places.driven["movement"]]
    for one in movements:
        by_target.setdefault(one.target, set()).add(one.origin)
    heading = {
        origin: places.heading_rad(origin)
        for origins in by_target.values()
        if len(origins) > 1
        for origin in origins
    }
    return frozenset(
        one.id
        for one in movements
        if any(
            abs(float(frames.difference(heading[one.origin], heading[other]))) < _JOINS_RAD
            for other in by_target[one.target] - {one.origin}
        )
    )
