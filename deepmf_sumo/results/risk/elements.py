"""The elements of a network's roads: junctions by their kind, lanes, bends, limits, crossings.

What a place of the network has, and where in the network each element is.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
import shapely

from deepmf_sumo.results.risk.places import Kind, Places, Spot
from deepmf_sumo.scene import Floats
from deepmf_sumo.sumo.network.sumo_net import NetEdge, NetLane, junction_of

KMH: Final = 3.6
BETWEEN: Final = "between junctions"
_BY_TYPE: Final[Mapping[str, str]] = {
    "priority": "priority signs", "priority_stop": "stop signs", "allway_stop": "all-way stop",
    "right_before_left": "right before left", "left_before_right": "left before right",
    "zipper": "zipper merge", "rail_crossing": "rail crossing", "rail_signal": "rail crossing",
    "unregulated": "no rule of priority",
}  # fmt: skip
"""Of SUMO's types of junctions; those that begin with ``traffic_light`` have lights."""
JUNCTIONS: Final = ("traffic light", "roundabout", *dict.fromkeys(_BY_TYPE.values()), BETWEEN)
_ARMS: Final = 3
"""Roads of fewer other junctions meet in no junction: there a road goes on with other lanes."""
_LANES: Final = ("1 lane", "2 lanes", "3 lanes and more")
_LIMITS_KMH: Final = {30: "up to 30 km/h", 50: "30 to 50 km/h", 70: "50 to 70 km/h",
                      100: "70 to 100 km/h"}  # fmt: skip
_FAST: Final = "over 100 km/h"
_RADII_M: Final = {50.0: "bend below 50 m", 200.0: "bend of 50 to 200 m"}
STRAIGHT: Final = "straight"
"""Or a radius of 200 m and more."""
_CHORD_M: Final = 10.0
"""Bends are measured by two chords of this length, of shorter edges by its halves."""
_SAMPLE_M: Final = 5.0
_SHORT_M: Final = 1.0
"""The direction of shorter edges is a matter of rounding."""
CROSSINGS: Final = "crossing for people"


class Element(NamedTuple):
    """What a road has, e.g. ``lanes``: ``2 lanes``."""

    subject: str
    name: str


ELEMENTS: Final = (
    *(Element("junction", name) for name in JUNCTIONS),
    *(Element("lanes in the AV's direction", name) for name in _LANES),
    *(Element("bend", name) for name in (STRAIGHT, *_RADII_M.values())),
    *(Element("speed limit", name) for name in (*_LIMITS_KMH.values(), _FAST)),
    Element("people", CROSSINGS),
)
"""All of them, in the order of the tables."""
Site = tuple[Kind, str]
"""Kind and id of a place that traffic is counted at: a movement or an edge."""


def at(places: Places, spot: Spot, place_m: Floats) -> frozenset[Element]:
    """The elements of the place (2,) where an AV is; none where it is on no road."""
    movement = places.movements.get(spot.movement)
    edge = places.net.edges.get(movement.origin if movement else spot.edge)
    found = set()
    if spot.junction or spot.edge:
        found.add(Element("junction", junction(places, spot.junction)))
    if spot.junction and spot.junction in _with_crossings(places):
        found.add(Element("people", CROSSINGS))
    if edge is not None:
        found |= set(_of_edge(edge))
    if edge is not None and spot.edge:  # ways over a junction bend as their turn does
        found.add(Element("bend", _bend(edge, place_m)))
    return frozenset(found)


def everywhere(places: Places) -> dict[Element, frozenset[Site]]:
    """Where the network has each element: movements, and edges that vehicles may use."""
    found: dict[Element, set[Site]] = defaultdict(set)
    crossed = _with_crossings(places)
    for one in (places.movements[name] for name in places.driven["movement"]):
        site: Site = "movement", one.id
        found[Element("junction", junction(places, one.junction))].add(site)
        if one.junction in crossed:
            found[Element("people", CROSSINGS)].add(site)
    for edge in (places.net.edges[name] for name in places.driven["edge"]):
        site = "edge", edge.id
        found[Element("junction", BETWEEN)].add(site)
        for element in (*_of_edge(edge), *(Element("bend", bend) for bend in _bends(edge))):
            found[element].add(site)
    return {element: frozenset(found[element]) for element in ELEMENTS}


def junction(places: Places, name: str) -> str:
    """The kind of a junction; `BETWEEN` for a joint of two roads, and for none."""
    if name in places.rings:
        return "roundabout"
    known = places.junctions.get(name)
    if known is None:
        return BETWEEN
    if known.type.startswith("traffic_light"):
        return "traffic light"
    if known.type.startswith("rail"):
        return "rail crossing"
    if len(_arms(places)[name]) < _ARMS:
        return BETWEEN
    return _BY_TYPE.get(known.type, "no rule of priority")


@lru_cache(maxsize=8)
def over_junctions(places: Places) -> frozenset[str]:
    """Movements over a junction: without joints of two roads, where vehicles do not turn."""
    movements = (places.movements[name] for name in places.driven["movement"])
    return frozenset(one.id for one in movements if junction(places, one.junction) != BETWEEN)


@lru_cache(maxsize=8)
def _arms(places: Places) -> dict[str, set[str]]:
    """The other ends of the roads at each junction."""
    found: dict[str, set[str]] = defaultdict(set)
    for edge in (places.net.edges[name] for name in places.driven["edge"]):
        found[edge.start].add(edge.end)
        found[edge.end].add(edge.start)
    return found


@lru_cache(maxsize=8)
def _with_crossings(places: Places) -> frozenset[str]:
    """Junctions at which people may cross: a crossing's id is ``:JUNCTION_c0``."""
    edges = (edge for edge in places.net.edges.values() if edge.function == "crossing")
    return frozenset(junction_of(edge.id) for edge in edges)


def _lanes(edge: NetEdge) -> list[NetLane]:
    """Lanes that cars may use; if there are none, lanes of other road vehicles."""
    lanes = [lane for lane in edge.lanes if lane.road] or list(edge.lanes)
    return [lane for lane in lanes if lane.allows("passenger")] or lanes


def _of_edge(edge: NetEdge) -> Iterator[Element]:
    lanes = _lanes(edge)
    yield Element("lanes in the AV's direction", _LANES[min(len(lanes), len(_LANES)) - 1])
    limit_kmh = max(lane.speed_mps for lane in lanes) * KMH
    fits = (name for most, name in _LIMITS_KMH.items() if limit_kmh <= most + 0.5)
    yield Element("speed limit", next(fits, _FAST))


def _line(edge: NetEdge) -> tuple[shapely.LineString, float]:
    """The edge's first lane, and the length of the chords; 0 where it is almost a point."""
    shape_m = edge.lanes[0].shape_m[:, :2]
    line = shapely.LineString(shape_m if len(shape_m) > 1 else np.repeat(shape_m, 2, axis=0))
    return line, min(_CHORD_M, line.length / 2) if line.length >= _SHORT_M else 0.0


def _bends(edge: NetEdge) -> set[str]:
    line, chord_m = _line(edge)
    if not chord_m:
        return {STRAIGHT}
    along = np.arange(chord_m, line.length - chord_m + 1e-6, _SAMPLE_M)
    return set(map(_class, _radius_m(line, along, chord_m)))


def _bend(edge: NetEdge, place_m: Floats) -> str:
    line, chord_m = _line(edge)
    if not chord_m:
        return STRAIGHT
    along = shapely.line_locate_point(line, shapely.Point(place_m))
    inside = np.clip(along, chord_m, line.length - chord_m)
    return _class(_radius_m(line, np.array([inside]), chord_m)[0])


def _class(radius_m: float) -> str:
    return next((name for below, name in _RADII_M.items() if radius_m < below), STRAIGHT)


def _radius_m(line: shapely.LineString, along_m: Floats, chord_m: float) -> Floats:
    """(K) radii at distances along a line, from the angle between the chords on both sides."""
    before, here, behind = (
        shapely.get_coordinates(shapely.line_interpolate_point(line, along_m + aside))
        for aside in (-chord_m, 0.0, chord_m)
    )
    (one_x, one_y), (two_x, two_y) = (here - before).T, (behind - here).T
    angle = np.abs(np.arctan2(one_x * two_y - one_y * two_x, one_x * two_x + one_y * two_y))
    return chord_m / np.maximum(angle, 1e-9)
