"""The roads of a report: each stored once, however many runs are on it, and only near the runs."""

import hashlib
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from deepmf_sumo.benchmark import stored
from deepmf_sumo.benchmark.results import Run
from deepmf_sumo.datatypes import Floats, RoadMap
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.report.page.packing import packed, stepwise

AROUND_M: Final = 60.0
"""How much of the road is kept around what AV and opponent drove."""
UNIT_M: Final = 0.1
_TOLERANCE_M: Final = 0.12
"""Lines may be so far off where points are left out."""
_UNKNOWN_WIDTH_M: Final = 3.5
_KEPT: Final = 8
"""Road maps in memory: runs of one scene come one after the other, or a sweep has few scenes."""


@dataclass(slots=True)
class Roads:
    """The roads of the runs that were added, numbered."""

    _numbers: dict[str, int] = field(default_factory=dict)
    _origins: list[Floats] = field(default_factory=list)
    _shapes: list[dict[tuple[str, int], list[Any]]] = field(default_factory=list)
    _maps: OrderedDict[str, tuple[RoadMap, str]] = field(default_factory=OrderedDict)

    def add(self, run: Run, near_m: Floats) -> tuple[int | None, RoadMap | None, str]:
        """Keep the road of a run near the places (K, 2).

        Returns:
            Its number, the map, and why it is not the one that was attacked on; None, None and the
            reason where there is no road to be had.
        """
        key = _key(run)
        try:
            road, note = self._map(key, run)
        except (DeepmfError, OSError, KeyError) as error:
            return None, None, f"no road: {error}"
        if key not in self._numbers:
            self._numbers[key] = len(self._numbers)
            self._origins.append(np.rint(near_m[0]))
            self._shapes.append({})
        number = self._numbers[key]
        _keep(self._shapes[number], road, near_m, self._origins[number])
        return number, road, note

    def packed(self) -> list[str]:
        """Each road as the page reads it."""
        return [
            packed({"origin": origin.tolist(), "unit": UNIT_M, "shapes": list(shapes.values())})
            for origin, shapes in zip(self._origins, self._shapes, strict=True)
        ]

    def _map(self, key: str, run: Run) -> tuple[RoadMap, str]:
        if key not in self._maps:
            self._maps[key] = run.road()
            while len(self._maps) > _KEPT:
                self._maps.popitem(last=False)
        self._maps.move_to_end(key)
        return self._maps[key]


def _key(run: Run) -> str:
    """What tells roads apart: the recorded scene, or the content of the network."""
    source = run.source
    if "recording" in source:
        return f"{source['recording']} {run.scene}"
    net = stored.net_file(run.folder)
    return run.run_id if net is None else _digest(net, net.stat().st_mtime_ns)


@lru_cache(maxsize=4096)
def _digest(file: Path, changed: int) -> str:  # noqa: ARG001 - part of the key
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _keep(
    shapes: dict[tuple[str, int], list[Any]], road: RoadMap, near_m: Floats, origin: Floats
) -> None:
    """Add the shapes within `AROUND_M` of the places that are not there yet."""
    area = shapely.buffer(shapely.LineString(np.concatenate([near_m, near_m[-1:]])), AROUND_M)
    shapely.prepare(area)
    for kind, number, width_m, line in _features(road):
        if (kind, number) not in shapes and shapely.intersects(area, line):
            corners = shapely.get_coordinates(shapely.simplify(line, _TOLERANCE_M)) - origin
            x, y = (stepwise(axis, UNIT_M) for axis in corners.T)
            shapes[kind, number] = [kind, round(width_m / UNIT_M), x, y]


@lru_cache(maxsize=_KEPT)
def _features(road: RoadMap) -> list[tuple[str, int, float, shapely.LineString]]:
    """Kind, number, width in metres and line of all that is drawn."""
    rows = [
        ("lane", lane.width_m or _UNKNOWN_WIDTH_M, lane.centre_m) for lane in road.lanes.values()
    ]
    rows += [("line", 0.0, line.points_m) for line in road.lines]
    rows += [("edge", 0.0, edge.points_m) for edge in road.edges]
    rows += [("crosswalk", 0.0, one.points_m) for one in road.polygons if one.kind == "crosswalk"]
    return [
        (kind, number, width_m, shapely.LineString(points))
        for number, (kind, width_m, points) in enumerate(rows)
        if len(points) > 1
    ]
