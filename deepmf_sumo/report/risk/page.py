"""A risk map as one page for a browser, which needs no other file and no network."""

import json
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any, Final

import shapely

from deepmf_sumo.benchmark.risk import Attacked, Network, Row, columns
from deepmf_sumo.benchmark.risk.places import KINDS
from deepmf_sumo.benchmark.risk.shrinkage import CONFIDENCE
from deepmf_sumo.benchmark.risk.table import COUNTED, DEFINITIONS
from deepmf_sumo.datatypes import Floats
from deepmf_sumo.report.risk.polygons import CLASSES, lanes_of

_SCRIPTS: Final = ("elements", "risk_places", "risk_map", "risk_table", "risk_start")
_TOLERANCE_M: Final = 0.1
_SIDEWALKS: Final = {"crossing", "walkingarea"}


def html(network: Network, rows: Sequence[Row], title: str) -> str:
    """The page. The same rows give the same page."""
    table = [columns(row) for row in rows]
    content = {
        "title": title,
        "network": network.name,
        "columns": list(table[0]) if table else [],
        "rows": [[_short(value) for value in row.values()] for row in table],
        "shapes": [_shape(network, row) for row in rows],
        "roads": list(_roads(network)),
        "attacks": [_attack(one, network) for one in network.attacks],
        "leftOut": dict(network.left_out),
        "places": {kind: network.places.count(kind) for kind in KINDS},
        "off": {counted: _off(network, counted) for counted in COUNTED},
        "definitions": dict(DEFINITIONS),
        "confidence": round(100 * CONFIDENCE),
        "classes": CLASSES,
    }
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    ours, report = (resources.files(f"deepmf_sumo.report.{name}") for name in ("risk", "page"))

    def asset(name: str) -> str:
        own = ours / "assets" / name
        return (own if own.is_file() else report / "assets" / name).read_text("utf-8")

    parts = {
        "style": asset("page.css") + asset("risk.css"),
        # what begins with < could end the element that it stands in
        "data": text.replace("<", "\\u003c"),
        "script": "\n".join(asset(f"{name}.js") for name in _SCRIPTS),
    }
    page = asset("risk.html")
    for name, part in parts.items():
        page = page.replace(f"<!-- {name} -->", part, 1)
    return page


def _shape(network: Network, row: Row) -> list[Any]:
    """Width and corners of each line of a place; of a junction its outline, without a width."""
    if row.kind == "junction":
        return [[0, _corners(network.places.junctions[row.place].shape_m)]]
    lanes = lanes_of(network, row)
    return [[round(lane.width_m, 1), _corners(lane.shape_m[:, :2])] for lane in lanes]


def _roads(network: Network) -> Iterator[list[Any]]:
    """Width and corners of all lanes for vehicles."""
    for edge in network.places.net.edges.values():
        if edge.function not in _SIDEWALKS:
            for lane in edge.lanes:
                yield [round(lane.width_m, 1), _corners(lane.shape_m[:, :2])]


def _corners(line_m: Floats) -> list[list[float]]:
    if len(line_m) < 2:
        return []
    simple = shapely.simplify(shapely.LineString(line_m), _TOLERANCE_M)
    return [[round(float(x), 1), round(float(y), 1)] for x, y in shapely.get_coordinates(simple)]


def _attack(one: Attacked, network: Network) -> list[Any]:
    """Run, place, whether it was a hit, the spots as the rows name them, the opponent's place."""
    return [
        one.run_id if one.turn is None else f"{one.run_id}, turn {one.turn}",
        [round(value, 1) for value in one.place_m],
        int(one.hit),
        {counted: {kind: getattr(one, counted).of(kind) for kind in KINDS} for counted in COUNTED},
        network.places.site(one.against),
    ]


def _off(network: Network, counted: str) -> int:
    """Attacks at no place at all."""
    spots = (getattr(one, counted) for one in network.attacks)
    return sum(not any(spot.of(kind) for kind in KINDS) for spot in spots)


def _short(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value
