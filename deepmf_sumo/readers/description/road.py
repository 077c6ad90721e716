"""``map_features`` of a ScenarioNet scene -> RoadMap.

Neighbours stand under singular keys, indices may be text, and crosswalks changed their name.
The lanes' ``width`` was computed by the converter and is not read.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import (
    Boundary,
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    StopSign,
)
from deepmf_sumo.datatypes.road import LaneKind, PolygonKind
from deepmf_sumo.readers.checks import identifier

MPS_PER_MPH: Final = 0.44704
LANE_KINDS: Final[dict[str, LaneKind]] = {
    "LANE_FREEWAY": "freeway",
    "LANE_SURFACE_STREET": "street",
    "LANE_BIKE_LANE": "bike",
}
LINE_KINDS: Final = (
    "ROAD_LINE_UNKNOWN",
    "ROAD_LINE_BROKEN_SINGLE_WHITE",
    "ROAD_LINE_SOLID_SINGLE_WHITE",
    "ROAD_LINE_SOLID_DOUBLE_WHITE",
    "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    "ROAD_LINE_BROKEN_DOUBLE_YELLOW",
    "ROAD_LINE_SOLID_SINGLE_YELLOW",
    "ROAD_LINE_SOLID_DOUBLE_YELLOW",
    "ROAD_LINE_PASSING_DOUBLE_YELLOW",
)
"""By WOMD's RoadLine.type."""
EDGE_KINDS: Final = ("ROAD_EDGE_UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN")
"""By WOMD's RoadEdge.type."""
POLYGON_KINDS: Final[dict[str, PolygonKind]] = {
    "CROSSWALK": "crosswalk",
    "CROSS_WALK": "crosswalk",
    "SPEED_BUMP": "speed_bump",
    "DRIVEWAY": "driveway",
}

Feature = Mapping[str, Any]


def road(features: Mapping[Any, Feature], repairs: list[str]) -> RoadMap:
    """The road. Kinds of features that are not known are left out and listed in ``repairs``."""
    lanes: dict[str, Lane] = {}
    lines: list[Polyline] = []
    edges: list[Polyline] = []
    polygons: list[Polygon] = []
    signs: list[StopSign] = []
    unknown: set[str] = set()
    for key, feature in features.items():
        name, kind = identifier(key), identifier(feature["type"])
        # UNKNOWN is a lane's and a road line's type; only lanes have a speed limit.
        if kind.startswith("LANE_") or "speed_limit_mph" in feature:
            lanes[name] = _lane(name, kind, feature)
        elif kind == "UNKNOWN" or kind.startswith("ROAD_LINE_"):
            lines.append(_polyline(name, LINE_KINDS, kind, feature))
        elif kind.startswith("ROAD_EDGE_"):
            edges.append(_polyline(name, EDGE_KINDS, kind, feature))
        elif kind in POLYGON_KINDS:
            points = _points(feature["polygon"] if "polygon" in feature else feature["polyline"])
            polygons.append(
                Polygon(id=name, kind=POLYGON_KINDS[kind], points_m=points[:, :2], z_m=points[:, 2])
            )
        elif kind == "STOP_SIGN":
            signs.append(_stop_sign(name, feature))
        else:
            unknown.add(kind)
    if unknown:
        repairs.append(
            f"Map features of unknown kinds were left out: {', '.join(sorted(unknown))}."
        )
    return RoadMap(
        lanes=lanes,
        lines=tuple(lines),
        edges=tuple(edges),
        polygons=tuple(polygons),
        stop_signs=tuple(signs),
    )


def _lane(name: str, kind: str, feature: Feature) -> Lane:
    points = _points(feature["polyline"])
    limit_mph = float(feature.get("speed_limit_mph") or 0.0)
    return Lane(
        id=name,
        kind=LANE_KINDS.get(kind, "unknown"),
        centre_m=points[:, :2],
        z_m=points[:, 2],
        interpolating=bool(feature.get("interpolating", False)),
        speed_limit_mps=limit_mph * MPS_PER_MPH if limit_mph > 0 else None,
        next=tuple(map(identifier, feature.get("exit_lanes", ()))),
        previous=tuple(map(identifier, feature.get("entry_lanes", ()))),
        left=_neighbours(feature, "left"),
        right=_neighbours(feature, "right"),
        left_boundaries=_boundaries(feature.get("left_boundaries", ())),
        right_boundaries=_boundaries(feature.get("right_boundaries", ())),
    )


def _neighbours(feature: Feature, side: str) -> tuple[Neighbour, ...]:
    listed = feature.get(f"{side}_neighbor", feature.get(f"{side}_neighbors", ()))
    return tuple(
        Neighbour(
            lane_id=identifier(one["feature_id"]),
            self_start=int(one["self_start_index"]),
            self_end=int(one["self_end_index"]),
            other_start=int(one["neighbor_start_index"]),
            other_end=int(one["neighbor_end_index"]),
        )
        for one in listed
    )


def _boundaries(listed: Any) -> tuple[Boundary, ...]:
    return tuple(
        Boundary(
            start=int(one["lane_start_index"]),
            end=int(one["lane_end_index"]),
            feature_id=identifier(one["boundary_feature_id"]),
            kind=_number(LINE_KINDS, one["boundary_type"]),
        )
        for one in listed
    )


def _stop_sign(name: str, feature: Feature) -> StopSign:
    position = np.asarray(feature["position"], float).reshape(-1)
    if len(position) < 2:
        raise ValueError(f"stop sign {name} has {len(position)} coordinates")
    return StopSign(
        id=name,
        position_m=position[:2],
        z_m=float(position[2]) if len(position) > 2 else 0.0,
        lane_ids=tuple(map(identifier, feature.get("lane", ()))),
    )


def _polyline(name: str, kinds: tuple[str, ...], kind: str, feature: Feature) -> Polyline:
    points = _points(feature["polyline"])
    return Polyline(id=name, kind=_number(kinds, kind), points_m=points[:, :2], z_m=points[:, 2])


def _number(kinds: tuple[str, ...], kind: Any) -> int:
    """WOMD's number of a kind; 0 (unknown) where it is a road edge's, as in WOMD."""
    return kinds.index(kind) if kind in kinds else 0


def _points(values: Any) -> Floats:
    """(P, 3); a missing third coordinate is 0."""
    points = np.asarray(values, float)
    points = points.reshape(len(points), -1)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    if len(points) and points.shape[1] != 3:
        raise ValueError(f"points have {points.shape[1]} coordinates")
    return points.reshape(-1, 3)
