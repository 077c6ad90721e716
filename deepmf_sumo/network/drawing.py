"""What sumo-gui draws beside the net: crosswalks and the like as polygons, and how to open it."""

from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from deepmf_sumo.datatypes import RoadMap
from deepmf_sumo.network.mapping import ADDITIONAL_FILE, NET_FILE
from deepmf_sumo.network.plain import coordinates

CONFIG_FILE: Final = "scene.sumocfg"
_COLORS: Final = {
    "crosswalk": "220,220,220",
    "speed_bump": "230,190,60",
    "driveway": "120,120,110",
}


def write_additional(road: RoadMap, folder: Path) -> Path:
    """Polygons of the road, on a layer above the lanes."""
    lines = [
        f"    <poly id={quoteattr(shape.kind + '_' + shape.id)} type={quoteattr(shape.kind)} "
        f'color="{_COLORS[shape.kind]}" fill="1" layer="{1 if shape.kind != "driveway" else -2}" '
        f'shape="{coordinates(np.vstack([shape.points_m, shape.points_m[:1]]))}"/>'
        for shape in road.polygons
        if len(shape.points_m) > 2
    ]
    body = "\n".join(lines)
    file = folder / ADDITIONAL_FILE
    file.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<additional>\n{body}\n</additional>\n',
        encoding="utf-8",
    )
    return file


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
