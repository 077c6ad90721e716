"""Ids and names: text that can be shown everywhere, and is short enough to be."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Polygon, Polyline, RoadMap, StopSign
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.texts import LONGEST_ID, is_plain


def identifier(value: Any) -> str:
    """An id as text. Raises ValueError where it is neither text nor a number."""
    if isinstance(value, str | int | float | np.integer | np.floating):
        return str(value)
    raise ValueError(f"an id is neither text nor a number, but of type {type(value).__name__}")


def refuse(name: str, agents: Iterable[str], signals: Iterable[str], road: RoadMap) -> None:
    """Raises ReaderError for the first id that cannot be used, and says whose it is."""
    named: dict[str, Iterable[str]] = {
        "name of the scene": [name],
        "id of an agent": agents,
        "lane of a signal": signals,
        "id on the map": _of_road(road),
    }
    for what, ids in named.items():
        for one in ids:
            if not isinstance(one, str):
                raise ReaderError(f"the {what} is of type {type(one).__name__}, not text")
            if len(one) > LONGEST_ID:
                raise ReaderError(f"the {what}, {one[:20]}..., is longer than {LONGEST_ID} letters")
            if not is_plain(one):
                raise ReaderError(f"the {what}, {one[:40]!a}, has characters that cannot be shown")


def _of_road(road: RoadMap) -> Iterator[str]:
    for key, lane in road.lanes.items():
        yield from (key, lane.id, *lane.next, *lane.previous, *lane.gives_way_to)
        for neighbour in (*lane.left, *lane.right):
            yield neighbour.lane_id
        for boundary in (*lane.left_boundaries, *lane.right_boundaries):
            yield boundary.feature_id
    features: tuple[Polyline | Polygon | StopSign, ...] = (*road.lines, *road.edges)
    for feature in (*features, *road.polygons, *road.stop_signs):
        yield feature.id
    for sign in road.stop_signs:
        yield from sign.lane_ids
