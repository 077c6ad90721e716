"""The side file of a converted net: which SUMO lane is which part of which of the scene's lanes."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.datatypes import ConversionReport, LanePiece, SignalLink, SumoNet
from deepmf_sumo.errors import ConversionError

NET_FILE: Final = "net.net.xml"
ADDITIONAL_FILE: Final = "additional.xml"
MAPPING_FILE: Final = "mapping.json"
FORMAT: Final = 2
"""Raised when nets are built in another way, so that cached ones are built anew."""


def write(net: SumoNet, folder: Path) -> None:
    """Write the side file into the net's folder. Seconds are left out: same scene, same bytes."""
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
    beside = folder / f".{MAPPING_FILE}"
    beside.write_text(json.dumps(document, separators=(",", ":")), encoding="utf-8")
    beside.replace(folder / MAPPING_FILE)


def read(folder: Path) -> SumoNet:
    """The net that was converted into a folder.

    Raises ConversionError where the folder holds none, or one of another format.
    """
    file = folder / MAPPING_FILE
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
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
