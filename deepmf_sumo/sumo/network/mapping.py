"""The files beside a converted network: which lane became which, polygons, a configuration."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import (
    ConversionReport,
    Floats,
    LanePiece,
    Polygon,
    RoadMap,
    SignalLink,
    SumoNet,
)
from deepmf_sumo.sumo.network.plain_net import coordinates

NET_FILE: Final = "net.net.xml"
ADDITIONAL_FILE: Final = "additional.xml"
MAPPING_FILE: Final = "mapping.json"
FORMAT: Final = 2
"""Increased when nets are built differently, so that cached ones are rebuilt."""


def write(net: SumoNet, folder: Path) -> None:
    """Write the side file into the net's folder, without times: same scene, same bytes."""
    report = asdict(net.report) if net.report else {}
    report.pop("seconds", None)
    document = {
        "format": FORMAT,
        "pieces": {
            key: [
                [piece.sumo_lane, round(piece.start_m, 4), round(piece.length_m, 4)]
                for piece in row
            ]
            for key, row in net.pieces.items()
        },
        "lane_of": net.lane_of,
        "signals": {
            key: [[link.light, link.index] for link in links] for key, links in net.signals.items()
        },
        "ghost_edge": net.ghost_edge,
        "report": report,
    }
    files.write(folder / MAPPING_FILE, json.dumps(document, separators=(",", ":")))


def read(folder: Path) -> SumoNet:
    """The net that was converted into a folder.

    Raises ConversionError if the folder has no net, or one of another format.
    """
    file = folder / MAPPING_FILE
    try:
        document = json.loads(files.content(file))
        known = document["format"] == FORMAT
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConversionError(f"{file} is not a converted net's side file: {error}.") from None
    if not known:
        raise ConversionError(
            f"{file} has format {document['format']}, not {FORMAT}: convert the scene again."
        )
    additional = folder / ADDITIONAL_FILE
    return SumoNet(
        file=folder / NET_FILE,
        additional=additional if additional.is_file() else None,
        pieces={
            key: tuple(LanePiece(sumo_lane=lane, start_m=a, length_m=b) for lane, a, b in row)
            for key, row in document["pieces"].items()
        },
        lane_of={key: tuple(row) for key, row in document["lane_of"].items()},
        signals={
            key: tuple(SignalLink(light=light, index=index) for light, index in row)
            for key, row in document["signals"].items()
        },
        ghost_edge=document["ghost_edge"],
        report=_report(document["report"]),
    )


def _report(values: dict[str, Any]) -> ConversionReport:
    """JSON has lists where the report has tuples."""
    rows: dict[str, Any] = {
        key: tuple(tuple(row) for row in value) if isinstance(value, list) else value
        for key, value in values.items()
    }
    return ConversionReport(**rows)


CONFIG_FILE: Final = "scene.sumocfg"
_COLORS: Final = {
    "crosswalk": "220,220,220",
    "speed_bump": "230,190,60",
    "driveway": "120,120,110",
    "building": "190,190,190",
    "water": "170,205,230",
}
_ABOVE: Final = {"crosswalk", "speed_bump"}
"""These are drawn on the lanes."""


def beside(road: RoadMap) -> list[Polygon]:
    """What a road has that its network does not say: buildings, water, areas of other files.

    Crossings of a network are edges of it, and edges have names that begin with a colon.
    """
    added = [one for one in road.polygons if not one.id.startswith(":")]
    return [*added, *road.buildings, *road.water]


def write_additional(shapes: Sequence[Polygon], file: Path, *, flat: bool = False) -> Path:
    """Polygons that sumo-gui draws, and that `road_of_net` takes.

    ``flat``: without their heights, for a converted net, which has none.
    """
    lines = [
        f"    <poly id={quoteattr(shape.kind + '_' + shape.id)} type={quoteattr(shape.kind)} "
        f'color="{_COLORS[shape.kind]}" fill="1" layer="{1 if shape.kind in _ABOVE else -2}" '
        f'shape="{coordinates(_ring(shape, flat=flat))}"/>'
        for shape in shapes
        if len(shape.points_m) > 2
    ]
    body = "\n".join(lines)
    file.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<additional>\n{body}\n</additional>\n',
        encoding="utf-8",
    )
    return file


def _ring(shape: Polygon, *, flat: bool) -> Floats:
    """The closed outline (P, 3), or (P, 2) where nothing is known of heights."""
    known = shape.points_m if flat or not shape.z_m.any() else np.c_[shape.points_m, shape.z_m]
    return np.vstack([known, known[:1]])


def write_config(folder: Path) -> Path:
    """A configuration that opens the net in SUMO or sumo-gui."""
    file = folder / CONFIG_FILE
    file.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<configuration>\n    <input>\n'
        f'        <net-file value="{NET_FILE}"/>\n'
        f'        <additional-files value="{ADDITIONAL_FILE}"/>\n    </input>\n'
        '    <time>\n        <begin value="0"/>\n        <step-length value="0.1"/>\n    </time>\n'
        "</configuration>\n",
        encoding="utf-8",
    )
    return file
