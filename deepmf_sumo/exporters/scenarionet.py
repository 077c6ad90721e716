"""One scenario of ScenarioNet and MetaDrive, ``sd_run.pkl``: attacks to train and test planners on.

It holds the scene of `exporters.scene`: after a contact the AV is not there, and the last plan of
the opponent continues. A pickle of plain containers and numpy arrays, which numpy 1 reads as well
as 2. Of lanes it lacks widths and priorities, which the format does not know.
"""

import io
import pickle
import pickletools
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files, plugins
from deepmf_sumo.exporters.base import Exportable, known_heights
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import (
    AgentId,
    Boundary,
    Lane,
    Neighbour,
    RoadMap,
    Scene,
    Signals,
    SignalState,
)
from deepmf_sumo.scene.readers.scenarionet import EDGE_KINDS, KINDS, LANE_KINDS, LINE_KINDS
from deepmf_sumo.scene.scene import AgentKind, LaneKind, PolygonKind

FILE: Final = "sd_run.pkl"
"""MetaDrive takes files that begin with sd_ for scenarios."""
VERSION: Final = "MetaDrive v0.4.3"
"""Whose ``ScenarioDescription.sanity_check`` it passes."""
_TYPES: Final[dict[AgentKind, str]] = {kind: name for name, kind in KINDS.items()}
_LANES: Final[dict[LaneKind, str]] = {kind: name for name, kind in LANE_KINDS.items()}
_POLYGONS: Final[dict[PolygonKind, str]] = {
    "crosswalk": "CROSSWALK",
    "speed_bump": "SPEED_BUMP",
    "driveway": "DRIVEWAY",
}
_MPH: Final = 2.2369362920544
_KMH: Final = 3.6
_PROTOCOL: Final = 3
"""The last one that names what it calls in an operation of its own, see `packed`."""

Described = dict[str, Any]


class Settings(plugins.Settings):
    """None."""


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the file ``path``. Raises OutputError and what `Exportable.around` raises."""
    content = packed(described(scene_of(run), run.made))
    with files.writing(path):
        files.write(path, content)


def packed(values: Any) -> bytes:
    """A pickle for numpy 1 and 2.

    numpy 2 names its function by a module that numpy 1 does not have; the name of before is an
    alias in numpy 2.
    """
    content = pickle.dumps(values, protocol=_PROTOCOL)
    out, done = io.BytesIO(), 0
    for operation, argument, at in pickletools.genops(content):
        if operation.name == "GLOBAL" and str(argument).startswith("numpy._core."):
            module, name = str(argument).split(" ")
            out.write(content[done:at])
            out.write(f"c{module.replace('numpy._core.', 'numpy.core.')}\n{name}\n".encode())
            assert at is not None
            done = at + len(f"c{module}\n{name}\n".encode())
    out.write(content[done:])
    return out.getvalue()


def described(scene: Scene, made: Collection[AgentId] = ()) -> Described:
    """The scene as MetaDrive's ``ScenarioDescription``, of plain containers and arrays.

    The metadata of people who were ``made`` say so.
    """
    tracks = _tracks(scene)
    for agent in tracks.keys() & {*made}:
        tracks[agent]["metadata"]["made"] = True
    return {
        "id": scene.name,
        "version": VERSION,
        "length": scene.tracks.steps,
        "metadata": {
            "id": scene.name,
            "scenario_id": scene.name,
            "dataset": "deepmf_sumo",
            "source_file": scene.source.file,
            "coordinate": "metadrive",
            "metadrive_processed": False,
            "ts": np.array(scene.timestamps_s, float),
            "sdc_id": scene.av_id,
            "sdc_track_index": list(tracks).index(scene.av_id),
            "current_time_index": scene.now,
            "objects_of_interest": list(scene.interest),
            "tracks_to_predict": {},
        },
        "tracks": tracks,
        "dynamic_map_states": _signals(scene.signals),
        "map_features": _road(scene.road),
    }


def _tracks(scene: Scene) -> Described:
    """Those of all road users that are ever there; values are 0 where one is not."""
    tracks, found = scene.tracks, {}
    height = known_heights(tracks)
    for row, agent in enumerate(tracks.ids):
        valid = tracks.valid[row]
        if not valid.any():
            continue
        kind = _TYPES.get(tracks.kinds[row], "OTHER")
        middle_m = tracks.z_m[row] + height[row] / 2
        place = np.column_stack([tracks.position_m[row], middle_m])
        size = {"length": tracks.size_m[row, 0], "width": tracks.size_m[row, 1],
                "height": height[row]}  # fmt: skip
        found[agent] = {
            "type": kind,
            "state": {
                "position": np.where(valid[:, None], place, 0.0),
                "heading": np.where(valid, tracks.heading_rad[row], 0.0),
                "velocity": np.where(valid[:, None], tracks.velocity_mps[row], 0.0),
                **{name: np.where(valid, one, 0.0) for name, one in size.items()},
                "valid": np.array(valid, bool),
            },
            "metadata": {
                "type": kind,
                "object_id": agent,
                "track_length": tracks.steps,
                "dataset": "deepmf_sumo",
            },
        }
    return found


def _signals(signals: Signals) -> Described:
    """The signal of each lane; a step without a state has None."""
    found = {}
    for row, lane in enumerate(signals.lane_ids):
        states = [
            f"LANE_STATE_{SignalState(state).name}" if seen else None
            for state, seen in zip(
                signals.state[row].tolist(), signals.seen[row].tolist(), strict=True
            )
        ]
        found[lane] = {
            "type": "TRAFFIC_LIGHT",
            "lane": lane,
            "stop_point": np.append(signals.stop_m[row], signals.stop_z_m[row]),
            "state": {"object_state": states},
            "metadata": {
                "type": "TRAFFIC_LIGHT",
                "object_id": lane,
                "track_length": len(states),
                "dataset": "deepmf_sumo",
            },
        }
    return found


def _road(road: RoadMap) -> Described:
    """All features in one mapping; one whose id a lane or an earlier one has gets another."""
    found: Described = {}
    lines = [("line", LINE_KINDS[one.kind], one) for one in road.lines]
    lines += [("edge", EDGE_KINDS[one.kind], one) for one in road.edges]
    taken, names = set(road.lanes), {}
    for sort, kind, one in lines:
        name = names[one.id] = _free(one.id, sort, taken)
        found[name] = {"type": kind, "polyline": np.column_stack([one.points_m, one.z_m])}
    for polygon in road.polygons:
        outline = np.column_stack([polygon.points_m, polygon.z_m])
        name = _free(polygon.id, "polygon", taken)
        found[name] = {"type": _POLYGONS[polygon.kind], "polygon": outline}
    for sign in road.stop_signs:
        found[_free(sign.id, "sign", taken)] = {
            "type": "STOP_SIGN",
            "position": np.append(sign.position_m, sign.z_m),
            "lane": list(sign.lane_ids),
        }
    return {key: _lane(lane, names) for key, lane in road.lanes.items()} | found


def _free(name: str, sort: str, taken: set[str]) -> str:
    while name in taken:
        name = f"{name}:{sort}"
    taken.add(name)
    return name


def _lane(lane: Lane, names: dict[str, str]) -> Described:
    limit = lane.speed_limit_mps or 0.0
    return {
        "type": _LANES.get(lane.kind, "LANE_UNKNOWN"),
        "polyline": np.column_stack([lane.centre_m, lane.z_m]),
        "interpolating": lane.interpolating,
        "speed_limit_mph": limit * _MPH,
        "speed_limit_kmh": limit * _KMH,
        "entry_lanes": list(lane.previous),
        "exit_lanes": list(lane.next),
        "left_neighbor": [_neighbour(one) for one in lane.left],
        "right_neighbor": [_neighbour(one) for one in lane.right],
        "left_boundaries": [_boundary(one, names) for one in lane.left_boundaries],
        "right_boundaries": [_boundary(one, names) for one in lane.right_boundaries],
    }


def _neighbour(one: Neighbour) -> Described:
    return {
        "feature_id": one.lane_id,
        "self_start_index": one.self_start,
        "self_end_index": one.self_end,
        "neighbor_start_index": one.other_start,
        "neighbor_end_index": one.other_end,
    }


def _boundary(one: Boundary, names: dict[str, str]) -> Described:
    return {
        "lane_start_index": one.start,
        "lane_end_index": one.end,
        "boundary_type": LINE_KINDS[one.kind],
        "boundary_feature_id": names.get(one.feature_id, one.feature_id),
    }
