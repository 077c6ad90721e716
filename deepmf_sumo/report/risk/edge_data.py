"""Rows of a risk map -> SUMO's edge data, which sumo-gui, netedit and plotting tools read.

Numbers of attacks that were decided on an edge or a lane have the names of ``risk.csv``, those of
attacks that began there the same with ``began_`` before them.
"""

from collections.abc import Iterable, Sequence
from typing import Final
from xml.etree import ElementTree as ET  # written, never parsed

from deepmf_sumo.benchmark.risk import Network, Row, columns

_WORDS: Final = {"kind", "place", "title", "counted"}
_END_S: Final = "1000000.00"
"""The data are of no time of the simulation in particular: they are shown at all times."""
Values = dict[str, str]


def edges(network: Network, rows: Sequence[Row]) -> bytes:
    """``<meandata>`` of all edges with attacks, those inside junctions too, and their lanes."""
    root = ET.Element("meandata")
    interval = ET.SubElement(root, "interval", begin="0.00", end=_END_S, id="deepmf-sumo risk")
    by_edge, by_lane = _values(rows, "edge"), _values(rows, "lane")
    for place, values in _values(rows, "movement").items():  # edges inside junctions are of one
        for inner in network.places.movements[place].lanes:
            by_edge[network.places.lanes[inner].edge] = values
    for edge in network.places.net.edges.values():
        lanes = [lane for lane in edge.lanes if lane.id in by_lane]
        if edge.id in by_edge or lanes:
            element = ET.SubElement(interval, "edge", {"id": edge.id, **by_edge.get(edge.id, {})})
            for lane in lanes:
                ET.SubElement(element, "lane", {"id": lane.id, **by_lane[lane.id]})
    return _text(root)


def movements(network: Network, rows: Sequence[Row]) -> bytes:
    """``<edgeRelation from= to=>`` of all movements with attacks."""
    root = ET.Element("data")
    interval = ET.SubElement(root, "interval", begin="0.00", end=_END_S, id="deepmf-sumo risk")
    for place, values in _values(rows, "movement").items():
        one = network.places.movements[place]
        ends = {"from": one.origin, "to": one.target, "junction": one.junction}
        ET.SubElement(interval, "edgeRelation", {**ends, "turn": one.turn, **values})
    return _text(root)


def _values(rows: Iterable[Row], kind: str) -> dict[str, Values]:
    """Numbers of the places of a kind, as text; what is not known is left out."""
    found: dict[str, Values] = {}
    for row in rows:
        if row.kind == kind:
            head = "" if row.counted == "decided" else f"{row.counted}_"
            found.setdefault(row.place, {}).update(numbers(row, head))
    return found


def numbers(row: Row, head: str = "") -> Values:
    """A row's numbers as text, by name."""
    return {
        f"{head}{name}": f"{value:.6g}"
        for name, value in columns(row).items()
        if name not in _WORDS and value is not None
    }


def _text(root: ET.Element) -> bytes:
    ET.indent(root, "    ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"
