"""Scene <-> named arrays.

Motion and signals are arrays of their own. The points of all road features stand in one array
each (``road_points_m`` (P, 2), ``road_z_m`` (P)), feature after feature, in the order of the
description: lanes, lines, edges, polygons, stop signs. The description is JSON, and holds
everything else: names, kinds, links, numbers of points.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import (
    Boundary,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    Source,
    StopSign,
    Tracks,
)

FORMAT_VERSION: Final = 1

Arrays = dict[str, np.ndarray]
_MOTION: Final = ("size_m", "position_m", "z_m", "heading_rad", "velocity_mps", "valid")
_SIGNAL: Final = ("state", "seen", "stop_m", "stop_z_m")


def to_arrays(scene: Scene) -> Arrays:
    """The scene as arrays; `from_arrays` gives it back without a difference."""
    points, heights, road = _road_description(scene.road)
    description = {
        "name": scene.name,
        "source": asdict(scene.source),
        "dt_s": scene.dt_s,
        "now": scene.now,
        "av_id": scene.av_id,
        "interest": scene.interest,
        "to_predict": scene.to_predict,
        "repairs": scene.repairs,
        "ids": scene.tracks.ids,
        "kinds": scene.tracks.kinds,
        "signal_lane_ids": scene.signals.lane_ids,
        "road": road,
    }
    arrays: Arrays = {
        "format_version": np.array(FORMAT_VERSION),
        "description": np.frombuffer(json.dumps(description).encode(), "uint8"),
        "timestamps_s": scene.timestamps_s,
        "road_points_m": np.concatenate([np.zeros((0, 2)), *points]),
        "road_z_m": np.concatenate([np.zeros(0), *heights]),
    }
    arrays |= {f"tracks_{name}": getattr(scene.tracks, name) for name in _MOTION}
    arrays |= {f"signals_{name}": getattr(scene.signals, name) for name in _SIGNAL}
    return arrays


def from_arrays(arrays: Mapping[str, np.ndarray]) -> Scene:
    """The scene of the arrays. Raises KeyError, ValueError or TypeError where they are not one."""
    description = json.loads(arrays["description"].tobytes())
    return Scene(
        name=description["name"],
        source=Source(**description["source"]),
        dt_s=description["dt_s"],
        now=description["now"],
        timestamps_s=arrays["timestamps_s"],
        tracks=Tracks(
            ids=tuple(description["ids"]),
            kinds=tuple(description["kinds"]),
            **{name: arrays[f"tracks_{name}"] for name in _MOTION},
        ),
        road=_road(description["road"], arrays["road_points_m"], arrays["road_z_m"]),
        signals=Signals(
            lane_ids=tuple(description["signal_lane_ids"]),
            **{name: arrays[f"signals_{name}"] for name in _SIGNAL},
        ),
        av_id=description["av_id"],
        interest=tuple(description["interest"]),
        to_predict=tuple(description["to_predict"]),
        repairs=tuple(description["repairs"]),
    )


def _road_description(
    road: RoadMap,
) -> tuple[list[np.ndarray], list[np.ndarray], dict[str, list[dict[str, Any]]]]:
    points, heights = [], []
    lanes = []
    for lane in road.lanes.values():
        points.append(lane.centre_m)
        heights.append(lane.z_m)
        lanes.append(_lane_description(lane))
    described: dict[str, list[dict[str, Any]]] = {"lanes": lanes}
    for name in ("lines", "edges", "polygons"):
        features: tuple[Polyline | Polygon, ...] = getattr(road, name)
        points += [feature.points_m for feature in features]
        heights += [feature.z_m for feature in features]
        described[name] = [
            {"id": one.id, "kind": one.kind, "points": len(one.points_m)} for one in features
        ]
    points += [sign.position_m[None] for sign in road.stop_signs]
    heights += [np.array([sign.z_m]) for sign in road.stop_signs]
    described["stop_signs"] = [
        {"id": sign.id, "lane_ids": sign.lane_ids, "points": 1} for sign in road.stop_signs
    ]
    return points, heights, described


def _lane_description(lane: Lane) -> dict[str, Any]:
    plain = ("id", "kind", "interpolating", "width_m", "speed_limit_mps", "next", "previous")
    listed = ("left", "right", "left_boundaries", "right_boundaries")
    described = {name: getattr(lane, name) for name in plain}
    described |= {name: [asdict(one) for one in getattr(lane, name)] for name in listed}
    if lane.gives_way_to:  # recordings do not know it
        described["gives_way_to"] = lane.gives_way_to
    return described | {"points": len(lane.centre_m)}


class _Points:
    """Hands out the points of one feature after the other."""

    def __init__(self, points_m: np.ndarray, z_m: np.ndarray) -> None:
        self._points_m, self._z_m, self._next = points_m, z_m, 0

    def take(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        start, self._next = self._next, self._next + count
        if count < 0 or self._next > len(self._points_m):
            raise ValueError("the road has fewer points than its description says")
        return self._points_m[start : self._next], self._z_m[start : self._next]


def _road(described: dict[str, list[dict[str, Any]]], xy: np.ndarray, z: np.ndarray) -> RoadMap:
    points = _Points(xy, z)
    lanes = [_lane(one, points) for one in described["lanes"]]
    return RoadMap(
        lanes={lane.id: lane for lane in lanes},
        lines=tuple(Polyline(**_shape(one, points)) for one in described["lines"]),
        edges=tuple(Polyline(**_shape(one, points)) for one in described["edges"]),
        polygons=tuple(Polygon(**_shape(one, points)) for one in described["polygons"]),
        stop_signs=tuple(_sign(one, points) for one in described["stop_signs"]),
    )


def _shape(described: dict[str, Any], points: _Points) -> dict[str, Any]:
    xy, z = points.take(described["points"])
    return {"id": described["id"], "kind": described["kind"], "points_m": xy, "z_m": z}


def _sign(described: dict[str, Any], points: _Points) -> StopSign:
    xy, z = points.take(described["points"])
    return StopSign(
        id=described["id"],
        position_m=xy[0],
        z_m=float(z[0]),
        lane_ids=tuple(described["lane_ids"]),
    )


def _lane(described: dict[str, Any], points: _Points) -> Lane:
    xy, z = points.take(described["points"])
    return Lane(
        id=described["id"],
        kind=described["kind"],
        centre_m=xy,
        z_m=z,
        interpolating=described["interpolating"],
        width_m=described["width_m"],
        speed_limit_mps=described["speed_limit_mps"],
        next=tuple(described["next"]),
        previous=tuple(described["previous"]),
        left=tuple(Neighbour(**one) for one in described["left"]),
        right=tuple(Neighbour(**one) for one in described["right"]),
        left_boundaries=tuple(Boundary(**one) for one in described["left_boundaries"]),
        right_boundaries=tuple(Boundary(**one) for one in described["right_boundaries"]),
        gives_way_to=tuple(described.get("gives_way_to", ())),
    )
