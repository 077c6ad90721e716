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
    Lane,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    StopSign,
    Tracks,
)
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers.native.description import (
    Area,
    Description,
    LaneDescription,
    Line,
    Road,
    Sign,
    described,
)

FORMAT_VERSION: Final = 1

Arrays = dict[str, np.ndarray]
_MOTION: Final = ("size_m", "position_m", "z_m", "heading_rad", "velocity_mps", "valid")
_SIGNAL: Final = ("state", "seen", "stop_m", "stop_z_m")
# Kinds of numpy's types; all other arrays are of real numbers.
_KINDS: Final = {"tracks_valid": "b", "signals_seen": "b", "signals_state": "u"}
_CALLED: Final = {"b": "booleans", "u": "bytes", "f": "real numbers"}

NAMES: Final = (
    "format_version",
    "description",
    "timestamps_s",
    "road_points_m",
    "road_z_m",
    *(f"tracks_{name}" for name in _MOTION),
    *(f"signals_{name}" for name in _SIGNAL),
)
"""Of all arrays of a file."""


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
    """The scene of the arrays `names`. Raises ReaderError, naming the field that is wrong."""
    told = described(arrays["description"].tobytes())
    _check_arrays(arrays, told)
    return Scene(
        name=told.name,
        source=told.source.made(),
        dt_s=told.dt_s,
        now=told.now,
        timestamps_s=arrays["timestamps_s"],
        tracks=Tracks(
            ids=tuple(told.ids),
            kinds=tuple(told.kinds),
            **{name: arrays[f"tracks_{name}"] for name in _MOTION},
        ),
        road=_road(told.road, arrays["road_points_m"], arrays["road_z_m"]),
        signals=Signals(
            lane_ids=tuple(told.signal_lane_ids),
            **{name: arrays[f"signals_{name}"] for name in _SIGNAL},
        ),
        av_id=told.av_id,
        interest=tuple(told.interest),
        to_predict=tuple(told.to_predict),
        repairs=tuple(told.repairs),
    )


def _check_arrays(arrays: Mapping[str, np.ndarray], told: Description) -> None:
    """Raises ReaderError for an array of another type or shape than the description asks for."""
    agents, signals = len(told.ids), len(told.signal_lane_ids)
    if len(told.kinds) != agents:
        raise ReaderError(f"'kinds' has {len(told.kinds)} items, but there are {agents} ids")
    if told.av_id not in told.ids:
        raise ReaderError(f"'av_id' is '{told.av_id}', but there is no such agent")
    steps = arrays["timestamps_s"].size
    road = told.road
    features = (*road.lanes, *road.lines, *road.edges, *road.polygons, *road.stop_signs)
    points = sum(feature.points for feature in features)
    shapes = {
        "timestamps_s": (steps,),
        "road_points_m": (points, 2),
        "road_z_m": (points,),
        "tracks_size_m": (agents, 3),
        "tracks_position_m": (agents, steps, 2),
        "tracks_z_m": (agents, steps),
        "tracks_heading_rad": (agents, steps),
        "tracks_velocity_mps": (agents, steps, 2),
        "tracks_valid": (agents, steps),
        "signals_state": (signals, steps),
        "signals_seen": (signals, steps),
        "signals_stop_m": (signals, 2),
        "signals_stop_z_m": (signals,),
    }
    for name, shape in shapes.items():
        array, kind = arrays[name], _KINDS.get(name, "f")
        if array.dtype.kind != kind:
            raise ReaderError(f"array '{name}' holds {array.dtype}, not {_CALLED[kind]}")
        if array.shape != shape:
            raise ReaderError(f"array '{name}' has shape {array.shape}, not {shape}")


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
        return self._points_m[start : self._next], self._z_m[start : self._next]


def _road(told: Road, xy: np.ndarray, z: np.ndarray) -> RoadMap:
    points = _Points(xy, z)
    lanes = [_lane(one, points) for one in told.lanes]
    if len({lane.id for lane in lanes}) < len(lanes):
        raise ReaderError("two lanes have the same id")
    return RoadMap(
        lanes={lane.id: lane for lane in lanes},
        lines=tuple(Polyline(**_shape(one, points)) for one in told.lines),
        edges=tuple(Polyline(**_shape(one, points)) for one in told.edges),
        polygons=tuple(Polygon(**_shape(one, points)) for one in told.polygons),
        stop_signs=tuple(_sign(one, points) for one in told.stop_signs),
    )


def _shape(told: Line | Area, points: _Points) -> dict[str, Any]:
    xy, z = points.take(told.points)
    return {"id": told.id, "kind": told.kind, "points_m": xy, "z_m": z}


def _sign(told: Sign, points: _Points) -> StopSign:
    xy, z = points.take(told.points)
    return StopSign(id=told.id, position_m=xy[0], z_m=float(z[0]), lane_ids=tuple(told.lane_ids))


def _lane(told: LaneDescription, points: _Points) -> Lane:
    xy, z = points.take(told.points)
    return Lane(
        id=told.id,
        kind=told.kind,
        centre_m=xy,
        z_m=z,
        interpolating=told.interpolating,
        width_m=told.width_m,
        speed_limit_mps=told.speed_limit_mps,
        next=tuple(told.next),
        previous=tuple(told.previous),
        left=tuple(one.made() for one in told.left),
        right=tuple(one.made() for one in told.right),
        left_boundaries=tuple(one.made() for one in told.left_boundaries),
        right_boundaries=tuple(one.made() for one in told.right_boundaries),
        gives_way_to=tuple(told.gives_way_to),
    )
