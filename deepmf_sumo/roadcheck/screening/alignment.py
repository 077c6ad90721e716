"""Rules for the road itself: overlaps, missing links, merges, speed steps, tight turns."""

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Final

import shapely

from deepmf_sumo.roadcheck.screening.findings import Case, Judged
from deepmf_sumo.roadcheck.screening.guidelines import GRAVITY, KMH, Guideline
from deepmf_sumo.roadcheck.screening.roads import SignalledNetwork, Way, for_cars, for_motors
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network.sumo_net import NetEdge, NetFile, NetLane

_STEP_MPS: Final = 30 * KMH
_MERGING_RAD: Final = math.radians(30)
"""Ways that join at a smaller angle merge; others cross."""
_APART_M: Final = 1.8
"""Between the middles of two lanes: closer ones have no room for two cars beside each other."""
_PASSED_M: Final = 10.0
"""Over less than this cars can wait for each other."""
_SLOW_MPS: Final = 32 * KMH
"""Up to this limit an overlap may be a narrow road, where drivers wait: a warning."""
_SHARED: Final = "pair of edges that share a lane on purpose (bidi)"
_CUT_M: Final = 10.0
"""By so much a lane may be shorter: junctions of a network cut lanes."""
_LEAD_M: Final = 10.0
"""Drivers cut corners: a bend begins and ends so far beside the junction."""
_BACK_RAD: Final = math.radians(120)
"""An edge that leaves at a larger angle leads back: the other carriageway of the same road."""
_LEAST_BEND_RAD: Final = math.radians(10)
_TURN_GRIP: Final = 1.5
"""Side acceleration in turns to left and right, in g: no vehicle has that grip.

The speeds that netconvert itself gives to turns come to 1.25 g by this radius.
"""
_EXEMPT: Final = "turn to left or right below 1.5 g: its speed is netconvert's own"


def judge(roads: SignalledNetwork, book: Guideline, found: Judged) -> None:
    """All rules, on all edges and movements."""
    found.cases += overlaps(roads.net)
    found.not_judged[_SHARED] += sum(
        one.bidi > one.id and not one.function and any(for_motors(lane) for lane in one.lanes)
        for one in roads.net.edges.values()
    )
    for edge in roads.net.edges.values():
        if not edge.function and any(for_cars(lane) for lane in edge.lanes):
            _links(roads, book, edge, found)
    for junction in roads.net.junctions:
        ways = roads.ways.get(junction.id, [])
        _joins(roads, book, junction.type, ways, found)
        for way in ways:
            _step(way, found)
            _turn(way, book, found)


def overlaps(net: NetFile) -> Iterator[Case]:
    """Lanes of opposite directions that lie on each other, a case for each pair of edges.

    Not those that share a lane on purpose (``bidi``), where vehicles of SUMO brake for each other.
    """
    roads = [one for one in net.edges.values() if not one.function]
    by_ends = defaultdict(list)
    for one in roads:
        by_ends[one.start, one.end].append(one)
    for edge in roads:
        for other in by_ends[edge.end, edge.start] if edge.start != edge.end else ():
            if edge.id < other.id and edge.bidi != other.id:
                shared = {
                    (one.id, two.id): line.intersection(oncoming.buffer(_APART_M)).length
                    for one, line in _lines(edge)
                    for two, oncoming in _lines(other)
                }
                pair = max(shared, key=lambda key: shared[key], default=None)
                if pair is not None and shared[pair] > _PASSED_M:
                    yield _head_on(edge, other, pair, shared[pair])


def _lines(edge: NetEdge) -> list[tuple[NetLane, shapely.LineString]]:
    """Lanes for motor vehicles with their lines."""
    return [
        (one, shapely.LineString(one.shape_m[:, :2]))
        for one in edge.lanes
        if for_motors(one) and len(one.shape_m) > 1
    ]


def _head_on(edge: NetEdge, other: NetEdge, lanes: tuple[str, str], length_m: float) -> Case:
    limit = max(one.speed_mps for one in (*edge.lanes, *other.lanes))
    said = (
        f"lanes {lanes[0]} and {lanes[1]} of opposite directions lie on each other over"
        f" {length_m:.0f} m: vehicles drive through each other there"
    )
    return Case(
        rule="overlap", severity="error" if limit > _SLOW_MPS else "warning", junction=edge.end,
        edges=(edge.id, other.id), said=said, measured=length_m, required=0.0, unit="m",
        source="lanes of their own for both directions",
    )  # fmt: skip


def _links(roads: SignalledNetwork, book: Guideline, edge: NetEdge, found: Judged) -> None:
    """Lanes that end: a missing link, or a lane drop."""
    ways = roads.out_of.get(edge.id, [])
    onward = {way.target.edge for way in ways if not roads.opposite(edge.id, way.target.edge)}
    linked = {way.lane.id for way in ways}
    for lane in edge.lanes:
        if not for_cars(lane) or lane.id in linked:
            continue
        if len(onward) == 1:
            _drop(roads, book, lane, [way.lane for way in ways], found)
        elif onward:
            _missing(edge, f"lane {lane.index} of {edge.id}", sorted(onward), found)
    if not ways:
        others = _leaving(roads, edge)
        if others:
            _missing(edge, edge.id, others, found)


def _leaving(roads: SignalledNetwork, edge: NetEdge) -> list[str]:
    """Edges for cars that begin where this one ends, but those that lead back."""
    return sorted(
        one.id
        for one in roads.starting.get(edge.end, ())
        if not roads.opposite(edge.id, one.id)
        and roads.angle_rad(edge.id, one.id) < _BACK_RAD
        and any(for_cars(lane) for lane in one.lanes)
    )


def _missing(edge: NetEdge, what: str, others: list[str], found: Judged) -> None:
    listed = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
    found.cases.append(
        Case(
            rule="missing_link", severity="warning", junction=edge.end, edges=(edge.id,),
            said=f"{what} has no connection, though the road goes on ({listed})",
            measured=0.0, required=1.0, unit="connections", source="this project's",
        )
    )  # fmt: skip


def _drop(
    roads: SignalledNetwork, book: Guideline, lane: NetLane, beside: list[NetLane], found: Judged
) -> None:
    """A lane that ends beside others: an acceleration lane where it comes from a ramp."""
    length, first, ramp = _back(roads, lane)
    if ramp is None:
        why = "that goes through" if roads.into.get(first.id) else "that begins beside the road"
        found.not_judged[f"end of a lane {why}: signs and markings are not in a network"] += 1
        return
    main = max(beside, key=lambda one: one.speed_mps)
    need = book.acceleration_m(main.speed_mps, ramp.lane.speed_mps)
    if need is None:
        found.not_judged["merge at a limit for which the guideline has no acceleration lane"] += 1
    elif length < need.value - _CUT_M:
        said = (
            f"the acceleration lane behind {ramp.lane.edge} is {length:.0f} m long,"
            f" {need.value:.0f} m are required {need.why}"
        )
        found.cases.append(
            Case(
                rule="merge", severity="error" if length < need.value / 2 else "warning",
                junction=ramp.junction, edges=(ramp.lane.edge, lane.edge), said=said,
                measured=length, required=need.value, unit="m", source=need.source,
            )
        )  # fmt: skip


def _back(roads: SignalledNetwork, lane: NetLane) -> tuple[float, NetLane, Way | None]:
    """Length of a lane up to where it begins, its first piece, and the ramp that it comes from.

    It comes from a ramp where it is fed by an edge that does not feed the lanes beside it.
    """
    length, seen = lane.length_m, {lane.id}
    while True:
        before = [way for way in roads.into.get(lane.id, []) if way.lane.id not in seen]
        beside = {
            way.lane.edge
            for other in roads.net.edges[lane.edge].lanes
            if other.id != lane.id
            for way in roads.into.get(other.id, [])
        }
        ramps = [way for way in before if beside and way.lane.edge not in beside]
        if ramps or not before:
            return length, lane, ramps[0] if ramps else None
        lane = before[0].lane
        seen.add(lane.id)
        length += lane.length_m + sum(one.length_m for one in before[0].inner)


def _joins(
    roads: SignalledNetwork, book: Guideline, kind: str, ways: list[Way], found: Judged
) -> None:
    """Two roads that merge into one lane, without an acceleration lane at all."""
    if kind.startswith("rail") or len({way.target.edge for way in ways}) != 1:
        return
    for one, two in itertools.combinations(ways, 2):
        lit = one.link.light or two.link.light
        if one.target.id != two.target.id or one.lane.edge == two.lane.edge or lit:
            continue
        headings = (roads.places.heading_rad(way.lane.edge) for way in (one, two))
        apart = abs(float(frames.difference(*headings)))
        ramp, main = (two, one) if roads.waits(two, one) else (one, two)
        need = book.acceleration_m(main.target.speed_mps, ramp.lane.speed_mps)
        if apart > _MERGING_RAD or need is None:
            continue
        zipper = one.link.state == two.link.state == "Z"
        said = (
            f"{ramp.lane.edge} merges with {main.lane.edge} without an acceleration lane,"
            f" {need.value:.0f} m are required {need.why}"
        )
        found.cases.append(
            Case(
                rule="merge", severity="warning" if zipper else "error", junction=one.junction,
                edges=(ramp.lane.edge, main.lane.edge, main.target.edge), said=said, measured=0.0,
                required=need.value, unit="m", source=need.source,
            )
        )  # fmt: skip


def _step(way: Way, found: Judged) -> None:
    before, behind = way.lane.speed_mps, way.target.speed_mps
    if way.turn == "straight" and before - behind > _STEP_MPS + 0.5 * KMH:
        said = (
            f"the limit falls from {before / KMH:.0f} to {behind / KMH:.0f} km/h in one step, from"
            f" {way.said}, at most {_STEP_MPS / KMH:.0f} km/h in one step"
        )
        found.cases.append(
            Case(
                rule="speed_step", severity="warning", junction=way.junction, edges=way.edges,
                said=said, measured=(before - behind) / KMH, required=_STEP_MPS / KMH,
                unit="km/h", source="this project's",
            )
        )  # fmt: skip


def _turn(way: Way, book: Guideline, found: Judged) -> None:
    """Side acceleration on the way over a junction, as a share of the weight."""
    bend = way.bend_rad
    speed = min((one.speed_mps for one in way.inner), default=way.lane.speed_mps)
    if bend < _LEAST_BEND_RAD or speed <= 0 or way.turn == "turnaround":
        return
    straight = way.turn == "straight"
    length = way.inner_m + (2 * _LEAD_M if straight else 0.0)
    share = speed**2 * bend / length / GRAVITY
    if straight:
        most, why, source = book.friction(speed)
    else:
        most, why, source = _TURN_GRIP, "in turns", "this project's"
        found.not_judged[_EXEMPT] += share <= most
    if share > most:
        said = (
            f"{way.said} bends with a radius of {length / bend:.0f} m at {speed / KMH:.0f} km/h,"
            f" that is {share:.2f} g to the side, at most {most:.2f} g {why}"
        )
        found.cases.append(
            Case(
                rule="tight_turn", severity="warning", junction=way.junction, edges=way.edges,
                said=said, measured=share, required=most, unit="g", source=source,
            )
        )  # fmt: skip
