"""Rows of a risk map -> SUMO's edge data and polygons, which sumo-gui and netedit draw.

Numbers of attacks that were decided on an edge or a lane have the names of ``risk.csv``, those of
attacks that began there have the same names after ``began_``. A right click on a polygon shows its
numbers (*Show parameter*).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final
from xml.etree import ElementTree as ET  # written, never parsed

import shapely

from deepmf_sumo import tables
from deepmf_sumo.report.page.maps import lanes_of
from deepmf_sumo.report.palette import Rgb, risk_colour
from deepmf_sumo.results.risk.attacks import Network
from deepmf_sumo.results.risk.places import Kind
from deepmf_sumo.results.risk.table import PlaceRow, columns
from deepmf_sumo.scene import Floats

_WORDS: Final = {"kind", "place", "title", "counted"}
_END_S: Final = "1000000.00"
"""The data belong to no time of the simulation: sumo-gui shows them at all times."""
Values = dict[str, str]


def edges(network: Network, rows: Sequence[PlaceRow]) -> bytes:
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
    return _edge_data_text(root)


def movements(network: Network, rows: Sequence[PlaceRow]) -> bytes:
    """``<edgeRelation from= to=>`` of all movements with attacks."""
    root = ET.Element("data")
    interval = ET.SubElement(root, "interval", begin="0.00", end=_END_S, id="deepmf-sumo risk")
    for place, values in _values(rows, "movement").items():
        one = network.places.movements[place]
        ends = {"from": one.origin, "to": one.target, "junction": one.junction}
        ET.SubElement(interval, "edgeRelation", {**ends, "turn": one.turn, **values})
    return _edge_data_text(root)


def _values(rows: Iterable[PlaceRow], kind: str) -> dict[str, Values]:
    """Numbers of the places of a kind, as text; what is not known is left out."""
    found: dict[str, Values] = {}
    for row in rows:
        if row.kind == kind:
            head = "" if row.counted == "decided" else f"{row.counted}_"
            found.setdefault(row.place, {}).update(numbers(row, head))
    return found


def numbers(row: PlaceRow, head: str = "") -> Values:
    """A row's numbers as text, by name."""
    return {
        f"{head}{name}": tables.cell(value)
        for name, value in columns(row).items()
        if name not in _WORDS and value is not None
    }


def _edge_data_text(root: ET.Element) -> bytes:
    ET.indent(root, "    ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"


_NOTHING: Final[Rgb] = (120, 128, 136)
_OUTLINE_M: Final = 0.4
_LAYERS: Final[Mapping[Kind, int]] = {"junction": 150, "edge": 151, "movement": 152}
"""Above the roads (about 100) and below the vehicles (about 400)."""
_WAY_M: Final = 1.2
"""Ways over a junction lie over each other: they are drawn narrower than lanes."""


def additional(network: Network, rows: Sequence[PlaceRow]) -> bytes:
    """``<poly>`` of the junctions, edges and movements where attacks were decided.

    Filled with the colour of the risk of a hit, see `palette.RISK_CLASSES`; without any hit they
    have a grey outline.
    """
    drawn = [row for row in rows if row.counted == "decided" and row.kind in _LAYERS]
    root = ET.Element("additional")
    for row in drawn:
        for number, corners in enumerate(_outlines(network, row)):
            part = ET.SubElement(
                root,
                "poly",
                id=f"risk.{row.kind}.{_name(network, row)}.{number}",
                type=f"risk.{row.kind}",
                color=_text(risk_colour(row.risk["hit"].rate) if row.events["hit"] else _NOTHING),
                fill="1" if row.events["hit"] else "0",
                lineWidth=str(_OUTLINE_M),
                layer=str(_LAYERS[row.kind]),
                shape=" ".join(f"{x:.2f},{y:.2f}" for x, y in corners),
            )
            for key, value in {"place": row.title, **numbers(row)}.items():
                ET.SubElement(part, "param", key=key, value=value)
    ET.indent(root, "    ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root) + b"\n"


def _name(network: Network, row: PlaceRow) -> str:
    """SUMO takes no blanks in ids."""
    if row.kind != "movement":
        return row.place
    one = network.places.movements[row.place]
    return f"{one.origin}.{one.target}"


def _text(mixed: Rgb) -> str:
    return ",".join(map(str, mixed))


def _outlines(network: Network, row: PlaceRow) -> Iterator[Floats]:
    """Corners (P, 2) of the areas of a place."""
    for area in areas(network, row):
        yield shapely.get_coordinates(shapely.get_exterior_ring(area))


def areas(network: Network, row: PlaceRow) -> Iterator[shapely.Polygon]:
    """The areas of a place: a junction's outline, else one or more for each lane."""
    if row.kind == "junction":
        shape_m = network.places.junctions[row.place].shape_m
        if len(shape_m) > 2:
            yield shapely.Polygon(shape_m[:, :2])
    for lane in lanes_of(network, row):
        width_m = _WAY_M if row.kind == "movement" else lane.width_m
        line = shapely.LineString(lane.shape_m[:, :2])
        if line.length > 0:
            area = shapely.buffer(line, width_m / 2, cap_style="flat", join_style="mitre")
            yield from shapely.get_parts(area)
