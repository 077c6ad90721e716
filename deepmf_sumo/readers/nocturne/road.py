"""``roads`` of a Nocturne or GPUDrive scene -> RoadMap, with the links between lanes inferred."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from deepmf_sumo.datatypes import Lane, Polygon, Polyline, RoadMap, StopSign
from deepmf_sumo.datatypes.road import LaneKind
from deepmf_sumo.readers import checks, topology
from deepmf_sumo.readers.nocturne.points import points

LANE_KINDS: Final[tuple[LaneKind, ...]] = ("unknown", "freeway", "street", "bike")
"""By ``map_element_id``, 0 to 3."""
FIRST_LINE: Final = 5
"""``map_element_id`` of road line type 0; up to 13."""
FIRST_EDGE: Final = 14
"""``map_element_id`` of road edge type 0; up to 16."""


def road(roads: Sequence[Mapping[str, Any]], repairs: list[str]) -> RoadMap:
    """The road. Ids are those of the file, else the places in its list.

    The file does not say which lane follows which, nor which lies beside which: that is inferred
    from the geometry. Speed limits, boundaries and the lanes of stop signs are unknown.
    """
    lanes: list[Lane] = []
    lines: list[Polyline] = []
    edges: list[Polyline] = []
    polygons: list[Polygon] = []
    signs: list[StopSign] = []
    strange: set[str] = set()
    for index, feature in enumerate(roads):
        name = checks.identifier(feature.get("id", index))
        xyz = points(feature["geometry"])
        shape, z = xyz[:, :2], xyz[:, 2]
        element = int(feature.get("map_element_id", -1))
        match feature["type"]:
            case "lane":
                lanes.append(Lane(id=name, kind=_lane_kind(element), centre_m=shape, z_m=z))
            case "road_line":
                kind = _within(element, FIRST_LINE, 8)
                lines.append(Polyline(id=name, kind=kind, points_m=shape, z_m=z))
            case "road_edge":
                kind = _within(element, FIRST_EDGE, 2)
                edges.append(Polyline(id=name, kind=kind, points_m=shape, z_m=z))
            case "crosswalk" | "speed_bump" | "driveway" as area:
                polygons.append(Polygon(id=name, kind=area, points_m=shape, z_m=z))
            case "stop_sign" if len(shape):
                signs.append(StopSign(id=name, position_m=shape[0], z_m=float(z[0]), lane_ids=()))
            case other:
                strange.add(str(other))
    if strange:
        repairs.append(f"Roads of unknown types were left out: {', '.join(sorted(strange))}.")
    return RoadMap(
        lanes=_linked(lanes),
        lines=tuple(lines),
        edges=tuple(edges),
        polygons=tuple(polygons),
        stop_signs=tuple(signs),
    )


def _linked(lanes: list[Lane]) -> dict[str, Lane]:
    ids = [lane.id for lane in lanes]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise ValueError(f"two lanes have the id {twice}")
    lost = next((lane.id for lane in lanes if not checks.is_placed(lane)), None)
    if lost is not None:
        raise ValueError(f"lane {lost} has points that are not finite numbers, or too far away")
    return topology.linked(lanes)


def _lane_kind(element: int) -> LaneKind:
    return LANE_KINDS[element] if 0 <= element < len(LANE_KINDS) else "unknown"


def _within(element: int, first: int, last_kind: int) -> int:
    """The kind's number; 0, which is unknown, where the file does not say."""
    kind = element - first
    return kind if 0 <= kind <= last_kind else 0
