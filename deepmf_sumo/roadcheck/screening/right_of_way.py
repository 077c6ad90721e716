"""Rules for junctions without lights: one road has to give way, and at speed by a sign."""

from typing import Final

from deepmf_sumo.roadcheck.screening.findings import Case, Judged
from deepmf_sumo.roadcheck.screening.guidelines import KMH, Guideline
from deepmf_sumo.roadcheck.screening.roads import SignalledNetwork, Way, common_place

_SLOW_MPS: Final = 30 * KMH
"""Up to this limit a junction without any rule of priority is a warning, above it an error."""
_SLACK_MPS: Final = 2 * KMH
_BY_RIGHT: Final = {"right_before_left", "left_before_right"}


def judge(roads: SignalledNetwork, book: Guideline, found: Judged) -> None:
    """All rules, at all junctions."""
    for junction in roads.net.junctions:
        if junction.type.startswith("rail"):
            found.not_judged["railway junction"] += 1
            continue
        pairs = [
            (one, two)
            for one, two in roads.pairs(junction.id)
            if not (one.link.light or two.link.light)
        ]
        for one, two in pairs:
            if junction.goes_first and None in {one.row, two.row}:
                found.not_judged["right of way of connections without a request"] += 1
            elif _opposed(roads, one, two):
                found.not_judged["oncoming movements that share a lane on purpose (bidi)"] += 1
            elif _has_rule(one, two) or roads.waits(one, two) or roads.waits(two, one):
                continue
            elif common_place(one, two) is None:  # the network calls them foes all the same
                found.not_judged["right of way of foes whose ways do not come near each other"] += 1
            else:
                _nobody(one, two, found)
        if junction.type in _BY_RIGHT and pairs:
            _by_right(roads.ways[junction.id], book, found)


def _opposed(roads: SignalledNetwork, one: Way, two: Way) -> bool:
    """Oncoming on a lane that both directions share: vehicles of SUMO brake for each other."""
    edges = roads.net.edges
    return (
        edges[one.lane.edge].bidi == two.target.edge
        and edges[one.target.edge].bidi == two.lane.edge
    )


def _has_rule(one: Way, two: Way) -> bool:
    """A zipper or an all-way stop: all of them take turns."""
    states = {one.link.state, two.link.state}
    return states <= {"Z"} or states <= {"w"}


def _nobody(one: Way, two: Way, found: Judged) -> None:
    limit = max(one.lane.speed_mps, two.lane.speed_mps)
    said = (
        f"{one.said} and {two.said} meet at limits of {one.lane.speed_mps / KMH:.0f} and"
        f" {two.lane.speed_mps / KMH:.0f} km/h, and neither gives way"
    )
    found.cases.append(
        Case(
            rule="no_priority",
            severity="error" if limit > _SLOW_MPS + _SLACK_MPS else "warning",
            junction=one.junction,
            edges=tuple(dict.fromkeys((*one.edges, *two.edges))),
            said=said,
            measured=limit / KMH,
            required=0.0,
            unit="km/h",
            source="a rule of priority where ways meet",
        )
    )


def _by_right(ways: list[Way], book: Guideline, found: Judged) -> None:
    fastest = max(ways, key=lambda one: (one.lane.speed_mps, one.lane.id))
    limit, most = fastest.lane.speed_mps, book.right_before_left_mps
    if limit <= most + _SLACK_MPS:
        return
    said = (
        f"priority by the side that one comes from, at a limit of {limit / KMH:.0f} km/h on"
        f" {fastest.lane.edge}, at most {most / KMH:.0f} km/h are usual"
    )
    found.cases.append(
        Case(
            rule="right_before_left", severity="warning", junction=fastest.junction,
            edges=(fastest.lane.edge,), said=said, measured=limit / KMH, required=most / KMH,
            unit="km/h", source="this project's: built-up areas",
        )
    )  # fmt: skip
