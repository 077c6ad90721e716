"""Networks with attacks -> a folder each: CSV, edge data, polygons, a page."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import shapely

from deepmf_sumo import files, risk, tables
from deepmf_sumo.datatypes import Floats
from deepmf_sumo.errors import OutputError
from deepmf_sumo.report.risk import sumo_files
from deepmf_sumo.report.risk.sumo_files import CLASSES, lanes_of
from deepmf_sumo.risk.attacks import Attacked, Network
from deepmf_sumo.risk.criticality import CONFIDENCE
from deepmf_sumo.risk.places import KINDS
from deepmf_sumo.risk.table import COUNTED, DEFINITIONS, Row, columns

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


TABLE, PAGE, EDGES, MOVEMENTS = "risk.csv", "risk.html", "edges.xml", "movements.xml"
POLYGONS, CONFIG, CONFLICTS = "polygons.add.xml", "risk.sumocfg", "conflicts.csv"
_MADE: Final = {
    TABLE, PAGE, EDGES, MOVEMENTS, POLYGONS, CONFIG, CONFLICTS, "net.net.xml", "net.net.xml.gz",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """The files of one network, and what stands in them."""

    folder: Path
    network: Network
    rows: list[Row]


def write(out: Path, networks: Sequence[Network], title: str = "") -> list[Written]:
    """Write the risk map of each network: into ``out``, or a folder each in it if several.

    Args:
        out: made if it is not there; files of an earlier map are replaced.
        networks: of `benchmark.risk.read`.
        title: of the page, e.g. the name of the result folder.

    Raises OutputError where a folder cannot be written or holds something else.
    """
    written = []
    for number, network in enumerate(networks):
        folder = out if len(networks) == 1 else out / f"{number + 1}-{network.name}"
        with files.writing(folder):
            written.append(_write(folder, network, title or network.name))
    return written


def _write(folder: Path, network: Network, title: str) -> Written:
    folder.mkdir(parents=True, exist_ok=True)
    others = {path.name for path in folder.iterdir() if not path.name.startswith(".")} - _MADE
    if others:
        raise OutputError(f"{folder} holds '{min(others)}'; choose an empty folder for --out.")
    rows = risk.rows(network)
    net = "".join(["net.net.xml", ".gz" * (network.net_file.suffix == ".gz")])
    files.write(folder / net, network.net_file.read_bytes())
    files.write(folder / TABLE, tables.to_csv([risk.columns(row) for row in rows]))
    files.write(folder / CONFLICTS, tables.to_csv([asdict(one) for one in risk.conflicts(network)]))
    files.write(folder / EDGES, sumo_files.edges(network, rows))
    files.write(folder / MOVEMENTS, sumo_files.movements(network, rows))
    files.write(folder / POLYGONS, sumo_files.additional(network, rows))
    files.write(folder / CONFIG, _config(net))
    files.write(folder / PAGE, html(network, rows, title))
    return Written(folder=folder, network=network, rows=rows)


def _config(net: str) -> str:
    """What ``sumo-gui -c`` opens: the network with the polygons, and no traffic."""
    return f"""<configuration>
    <input>
        <net-file value="{net}"/>
        <additional-files value="{POLYGONS}"/>
    </input>
    <time>
        <begin value="0"/>
        <end value="1"/>
    </time>
    <gui_only>
        <edgedata-files value="{EDGES}"/>
    </gui_only>
</configuration>
"""
