"""What the simulation says to a planner outside it, as JSON."""

import json
import os
from collections.abc import Iterable
from typing import Any

from deepmf_sumo.datatypes import Case, Lane, Neighbour, Polyline, RoadMap, View
from deepmf_sumo.datatypes.scene import DT_S
from deepmf_sumo.planners.doors.messages import PROTOCOL


def episode_of(case: Case) -> str:
    """Tells the episodes apart that run at the same time."""
    return f"{case.name}#{os.getpid()}"


def reset_message(case: Case, *, road: bool) -> bytes:
    """Start of an episode; ``road``: with the map."""
    return _line(
        {
            "type": "reset",
            "protocol": PROTOCOL,
            "episode": episode_of(case),
            "case": case.name,
            "seed": case.seed,
            "av_id": case.av_id,
            "dt_s": DT_S,
            "steps": case.duration_steps,
            "own_lane": case.net is not None and case.net.ghost_edge is not None,
            "road": _road(case.road) if road else None,
        }
    )


def view_message(episode: str, view: View, history_steps: int) -> bytes:
    """A step, with so many steps of history (now included)."""
    return _line(
        {
            "type": "view",
            "episode": episode,
            "step": view.step,
            "dt_s": view.dt_s,
            "steps_left": view.steps_left,
            "av_id": view.av_id,
            "agents": _agents(view, history_steps),
            "signals": {lane: state.name for lane, state in view.signals.items()},
            "av_path_m": None if view.av_path_m is None else view.av_path_m.tolist(),
        }
    )


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _agents(view: View, history_steps: int) -> list[dict[str, Any]]:
    tracks = view.history
    last = tracks.window(max(0, tracks.steps - history_steps), tracks.steps)
    columns = zip(
        last.ids,
        last.kinds,
        last.size_m.tolist(),
        last.position_m[..., 0].tolist(),
        last.position_m[..., 1].tolist(),
        last.z_m.tolist(),
        last.heading_rad.tolist(),
        last.velocity_mps[..., 0].tolist(),
        last.velocity_mps[..., 1].tolist(),
        last.valid.tolist(),
        strict=True,
    )
    names = (
        "id",
        "kind",
        "size_m",
        "x_m",
        "y_m",
        "z_m",
        "heading_rad",
        "vx_mps",
        "vy_mps",
        "valid",
    )
    return [dict(zip(names, column, strict=True)) for column in columns]


def _road(road: RoadMap) -> dict[str, Any]:
    return {
        "lanes": [_lane(lane) for lane in road.lanes.values()],
        "lines": _lines(road.lines),
        "edges": _lines(road.edges),
        "areas": [
            {"id": one.id, "kind": one.kind, "points_m": one.points_m.tolist()}
            for one in road.polygons
        ],
        "stop_signs": [
            {"id": one.id, "position_m": one.position_m.tolist(), "lane_ids": list(one.lane_ids)}
            for one in road.stop_signs
        ],
    }


def _lane(lane: Lane) -> dict[str, Any]:
    def beside(neighbours: Iterable[Neighbour]) -> list[str]:
        return list(dict.fromkeys(one.lane_id for one in neighbours))

    return {
        "id": lane.id,
        "kind": lane.kind,
        "centre_m": lane.centre_m.tolist(),
        "width_m": lane.width_m,
        "speed_limit_mps": lane.speed_limit_mps,
        "next": list(lane.next),
        "previous": list(lane.previous),
        "left": beside(lane.left),
        "right": beside(lane.right),
    }


def _lines(lines: Iterable[Polyline]) -> list[dict[str, Any]]:
    return [{"id": one.id, "kind": one.kind, "points_m": one.points_m.tolist()} for one in lines]
