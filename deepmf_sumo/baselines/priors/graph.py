"""A view as a graph of vehicles: each described in its own frame, all of them placed in the AV's.

Arrays are in metres and seconds; the network scales them. `Graph` names them, with shapes.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.encode import recent_change
from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M, PathInfo, path_set, road_index
from deepmf_sumo.scene import HISTORY_STEPS, AgentId, Floats, Ints, Tracks, View
from deepmf_sumo.scene.geometry import frames

MEMBERS: Final = 16
"""Vehicles of a graph: the AV first."""
PATHS: Final = 7
"""Six ways along lanes, and straight on."""
NODES: Final = 49
SPACING_M: Final = 4.0
"""Between the nodes of a path."""

Graph = dict[str, NDArray[np.float32]]
"""What the network reads of a view:

=========  ============== ======================================================================
history    (16, 11, 7)    x, y, cos, sin, vx, vy, valid, in the vehicle's own frame
size       (16, 2)        length, width
kind       (16, 3)        is a cyclist, is the AV, there
motion     (16, 3)        speed, acceleration, yaw rate
pose       (16, 3)        x, y, heading now, in the frame of the first vehicle
ways       (16, 7, 49, 2) ways that the lanes offer, every 4 m, in the vehicle's own frame
way_info   (16, 7, 14)    see `lanes.PathInfo`
=========  ============== ======================================================================
"""

_STRIDE: Final = round(SPACING_M / NODE_SPACING_M)
_STANDING_MPS: Final = 0.5
_STANDING_M: Final = 30.0
"""Added to the distance of a standing vehicle: parked cars would fill the graph."""


def members(view: View, wanted: Sequence[AgentId] = ()) -> tuple[AgentId, ...]:
    """Up to 16 ids: the AV, those wanted, then the vehicles and cyclists nearest to the AV.

    Raises KeyError where the AV or a wanted one is not in view.
    """
    tracks = view.history
    av = tracks.row(view.av_id)
    away = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[av, -1]).T)
    away = away + _STANDING_M * (tracks.speed_mps[:, -1] < _STANDING_MPS)
    first = [av, *(tracks.row(agent_id) for agent_id in wanted)]
    others = [
        row
        for row in np.argsort(away, kind="stable").tolist()
        if row not in first and tracks.kinds[row] in {"vehicle", "cyclist"}
    ]
    return tuple(tracks.ids[row] for row in [*first, *others][:MEMBERS])


def graph_of(view: View, ids: Sequence[AgentId]) -> Graph:
    """The arrays of `Graph`; rows beyond the agents are zero. Raises KeyError as `members` does."""
    tracks, index = view.history, road_index(view.road)
    rows = np.array([tracks.row(agent_id) for agent_id in ids])
    count = len(rows)
    position, heading = tracks.position_m[rows, -1], tracks.heading_rad[rows, -1]
    found: dict[str, Floats] = {
        "history": np.zeros((MEMBERS, HISTORY_STEPS, 7)),
        "size": np.zeros((MEMBERS, 2)),
        "kind": np.zeros((MEMBERS, 3)),
        "motion": np.zeros((MEMBERS, 3)),
        "pose": np.zeros((MEMBERS, 3)),
        "ways": np.zeros((MEMBERS, PATHS, NODES, 2)),
        "way_info": np.zeros((MEMBERS, PATHS, len(PathInfo))),
    }
    found["history"][:count] = _histories(tracks, rows, position, heading)
    found["size"][:count] = tracks.size_m[rows, :2]
    found["kind"][:count, 0] = [tracks.kinds[row] == "cyclist" for row in rows]
    found["kind"][:count, 1] = [agent_id == view.av_id for agent_id in ids]
    found["kind"][:count, 2] = 1.0
    found["motion"][:count] = _motions(tracks, rows, view.dt_s)
    found["pose"][:count, :2] = frames.to_local(position, position[0], float(heading[0]))
    found["pose"][:count, 2] = frames.wrap(heading - heading[0])
    for number in range(count):
        speed = float(found["motion"][number, 0])
        paths = path_set(
            index,
            position[number],
            float(heading[number]),
            speed,
            view.signals,
            float(tracks.z_m[rows[number], -1]),
        )
        straight = len(paths.lanes)
        lanes = min(straight, PATHS - 1)
        chosen = [*range(lanes), straight]  # the fan begins with straight on
        length = NODES * _STRIDE
        found["ways"][number, : lanes + 1] = paths.points_m[chosen, :length:_STRIDE]
        found["way_info"][number, : lanes + 1] = paths.info[chosen]
    return {name: values.astype(np.float32) for name, values in found.items()}


def _histories(tracks: Tracks, rows: Ints, position: Floats, heading: Floats) -> Floats:
    """(A, 11, 7) each in its own frame now."""
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]

    def turned(vectors: Floats) -> list[Floats]:
        x, y = vectors[..., 0], vectors[..., 1]
        return [x * cos + y * sin, y * cos - x * sin]

    valid = tracks.valid[rows].astype(float)
    turn = tracks.heading_rad[rows] - heading[:, None]
    columns = [
        *turned(tracks.position_m[rows] - position[:, None]),
        np.cos(turn),
        np.sin(turn),
        *turned(tracks.velocity_mps[rows]),
        np.ones_like(valid),
    ]
    return np.stack([column * valid for column in columns], axis=-1)


def _motions(tracks: Tracks, rows: Ints, dt_s: float) -> Floats:
    """(A, 3) speed, acceleration, yaw rate."""
    gain, yaw = recent_change(tracks, rows, dt_s)
    return np.stack([tracks.speed_mps[rows, -1], gain, yaw], axis=1)
