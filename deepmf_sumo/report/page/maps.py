"""A network with attacks -> the risk map on a page: roads, places, attacks."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, Final

import shapely

from deepmf_sumo.report.evidence import HEADINGS, NOTE, row
from deepmf_sumo.report.page.columns import Column, short
from deepmf_sumo.report.palette import RISK_CLASSES
from deepmf_sumo.results.quantities import BY_NAME
from deepmf_sumo.results.risk.attacks import Attacked, Network
from deepmf_sumo.results.risk.coverage import TABLES, EvidenceCell, coverage
from deepmf_sumo.results.risk.kinds import MEANINGS, TypeRow, by_type
from deepmf_sumo.results.risk.places import KINDS
from deepmf_sumo.results.risk.table import COUNTED, DEFINITIONS, PlaceRow, columns
from deepmf_sumo.results.statistics import PLACE_CONFIDENCE
from deepmf_sumo.scene import Floats
from deepmf_sumo.sumo.network.sumo_net import ON_FOOT, NetLane

_TOLERANCE_M: Final = 0.1
_MOST_NEVER: Final = 50
"""Longest list on the page; `coverage.csv` has all."""
_RISK: Final = f"({100 * PLACE_CONFIDENCE:.0f} % interval)"


def _number(name: str, heading: str, digits: int = 0, **more: Any) -> Column:
    """Most numbers are worse the larger they are."""
    return Column(
        name=name, heading=heading, kind="number", digits=digits, **{"ascending": False, **more}
    )


def _share(name: str, heading: str, **more: Any) -> Column:
    return Column(name=name, heading=heading, kind="share", ascending=False, **more)


PLACE_COLUMNS: Final = (
    _number("rank", "rank", ascending=True),
    Column(name="title", heading="place"),
    Column(name="kind", heading="kind"),
    _share("risk", f"risk {_RISK}"),
    _number("attacks", "attacks"),
    _number("hits", "hits"),
    _share("hit_rate", "hit rate (95 % interval)", optional=True),
    _number("findings", "findings"),
    _share("finding_share", "findings of hits (95 % interval)", optional=True),
    _number("severe", "severe hits"),
    _number("conflicts", "conflicts"),
    _number("other_contacts", "AV hit another", optional=True),
    _number("min_ttc_s", BY_NAME["ttc_min_s"].heading, 1, ascending=True),
    _number("min_gap_m", BY_NAME["min_gap_m"].heading, 1, ascending=True, optional=True),
    _number("delta_v_mps", f"mean {BY_NAME['delta_v_mps'].heading}", 1),
    _number("delta_v_most_mps", f"greatest {BY_NAME['delta_v_mps'].heading}", 1, optional=True),
    _number("criticality", f"criticality {_RISK}", 2, optional=True),
    _number("vehicles_per_hour", "vehicles per hour", optional=True),
    _number("hits_per_1000_vehicles", "hits per 1000 passing vehicles", 1, optional=True),
)
"""``rank`` and ``risk`` are those of the event that the reader chooses."""


def content(network: Network, rows: Sequence[PlaceRow]) -> dict[str, Any]:
    """What the page needs of a map, as JSON values. The same rows give the same content."""
    table, cells = [columns(one) for one in rows], coverage(network)
    return {
        "network": network.name,
        "columns": [column.as_json() for column in PLACE_COLUMNS],
        "values": list(table[0]) if table else [],
        "rows": [[short(value) for value in row.values()] for row in table],
        "shapes": [_shape(network, row) for row in rows],
        "roads": list(_roads(network)),
        "attacks": [_attack(one, network) for one in network.attacks],
        "leftOut": dict(network.left_out),
        "places": {kind: network.places.count(kind) for kind in KINDS},
        "off": {counted: _off(network, counted) for counted in COUNTED},
        "definitions": dict(DEFINITIONS),
        "types": [_type(row) for row in by_type(network.attacks)],
        "covered": _covered(cells),
        "evidence": _evidence(cells),
        "evidenceHeadings": HEADINGS,
        "evidenceNote": NOTE,
        "confidence": round(100 * PLACE_CONFIDENCE),
        "classes": RISK_CLASSES,
    }


def _type(row: TypeRow) -> list[Any]:
    """The cells of a kind of conflict, numbers as they are; its definition first."""
    return [MEANINGS[row.kind], *(short(value) for value in asdict(row).values())]


def _covered(cells: Sequence[EvidenceCell]) -> list[list[Any]]:
    """Of movements and edges how many were attacked, of how many, and which never were."""
    subjects: dict[str, list[EvidenceCell]] = {}
    for one in cells:
        if one.table == "place":
            subjects.setdefault(one.subject, []).append(one)
    return [
        [subject, sum(one.attacks > 0 for one in found), len(found), _never(found)]
        for subject, found in subjects.items()
    ]


def _evidence(cells: Sequence[EvidenceCell]) -> list[list[Any]]:
    """The title of each table, and its rows: cells of text."""
    return [
        [title, [list(row(one)) for one in cells if one.table == table]]
        for table, title in TABLES.items()
    ]


def _never(found: Sequence[EvidenceCell]) -> list[str]:
    """The busiest first, with their flow where it is known."""
    never = [one for one in found if not one.attacks]
    if any(one.vehicles_per_hour for one in never):
        never.sort(key=lambda one: -(one.vehicles_per_hour or 0.0))
    return [
        one.title
        if one.vehicles_per_hour is None
        else f"{one.title}: {one.vehicles_per_hour:.0f} vehicles per hour"
        for one in never[:_MOST_NEVER]
    ]


def lanes_of(network: Network, row: PlaceRow) -> list[NetLane]:
    """The lanes of an edge, of a movement, or the lane itself; none of a junction."""
    places = network.places
    if row.kind == "edge":
        return list(places.net.edges[row.place].lanes)
    if row.kind == "movement":
        return [places.lanes[lane] for lane in places.movements[row.place].lanes]
    return [places.lanes[row.place]] if row.kind == "lane" else []


def _shape(network: Network, row: PlaceRow) -> list[Any]:
    """Width and corners of each line of a place; of a junction its outline, without a width."""
    if row.kind == "junction":
        return [[0, _corners(network.places.junctions[row.place].shape_m)]]
    return [_line(lane.width_m, lane.shape_m) for lane in lanes_of(network, row)]


def _roads(network: Network) -> Iterator[list[Any]]:
    """Width and corners of all lanes for vehicles."""
    for edge in network.places.net.edges.values():
        if edge.function not in ON_FOOT:
            yield from (_line(lane.width_m, lane.shape_m) for lane in edge.lanes)


def _line(width_m: float, shape_m: Floats) -> list[Any]:
    return [round(width_m, 1), _corners(shape_m[:, :2])]


def _corners(line_m: Floats) -> list[list[float]]:
    if len(line_m) < 2:
        return []
    simple = shapely.simplify(shapely.LineString(line_m), _TOLERANCE_M)
    return [[round(float(x), 1), round(float(y), 1)] for x, y in shapely.get_coordinates(simple)]


def _attack(one: Attacked, network: Network) -> list[Any]:
    """Run, turn, position, whether it hit, the places by kind, the opponent's, conflict."""
    return [
        one.run_id,
        one.turn,
        [round(value, 1) for value in one.place_m],
        int(one.hit),
        {counted: {kind: getattr(one, counted).of(kind) for kind in KINDS} for counted in COUNTED},
        network.places.site(one.against),
        one.kind,
    ]


def _off(network: Network, counted: str) -> int:
    """How many attacks are at no place."""
    spots = (getattr(one, counted) for one in network.attacks)
    return sum(not any(spot.of(kind) for kind in KINDS) for spot in spots)
