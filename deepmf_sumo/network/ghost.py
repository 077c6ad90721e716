"""The ghost edge: the AV's recorded path as an edge of its own.

In parking lots and where the map lacks a lane, the AV drives where no lane is. SUMO can drive it
only on one, so the recorded path becomes one, joined to no other.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Floats, RoadMap, Scene
from deepmf_sumo.geometry import angles
from deepmf_sumo.network import cutting
from deepmf_sumo.network.blueprint import EdgePlan, LanePlan, NodePlan
from deepmf_sumo.network.matching import ELSEWHERE, lane_index, match

GHOST_EDGE: Final = "ghost_av"
OFF_LANE_M: Final = 3.0
"""Nearly a lane from the centre of any lane of its direction: the AV has left them. Lane changes
stay below it."""
OFF_STEPS: Final = 5
SPACING_M: Final = 1.0
BEHIND_M: Final = 20.0
AHEAD_M: Final = 200.0
WIDTH_M: Final = 3.3
SPEED_MPS: Final = 13.89


def leaves_lanes(scene: Scene) -> bool:
    """Whether the AV's recorded path, from the present on, leads off the lanes.

    It does where the AV is far from any lane for half a second, or goes on on a lane that neither
    follows nor adjoins the one before.
    """
    row = scene.tracks.row(scene.av_id)
    valid = scene.tracks.valid[row].copy()
    valid[: scene.now] = False
    found = match(scene.road, scene.tracks.position_m[row], scene.tracks.heading_rad[row], valid)
    off = found.distance_m[valid] > OFF_LANE_M
    runs = "".join("x" if far else " " for far in off).split()
    longest = max(map(len, runs), default=0)
    lanes = [lane for lane in found.lane_ids if lane]
    return longest >= OFF_STEPS or _jumps(scene.road, lanes)


def _jumps(road: RoadMap, lane_ids: Iterable[str]) -> bool:
    index = lane_index(road)
    return any(index.cost(one, two) >= ELSEWHERE for one, two in pairwise(lane_ids))


def ghost_edge(scene: Scene) -> tuple[EdgePlan, tuple[NodePlan, NodePlan]]:
    """The edge and its two nodes."""
    shape = ghost_path(scene)
    row = scene.tracks.row(scene.av_id)
    speed = max(SPEED_MPS, float(scene.tracks.speed_mps[row][scene.tracks.valid[row]].max()))
    nodes = tuple(
        NodePlan(id=f"{GHOST_EDGE}_{end}", position_m=point)
        for end, point in (("start", shape[0]), ("end", shape[-1]))
    )
    lane = LanePlan(shape_m=shape, speed_mps=speed, width_m=WIDTH_M)
    edge = EdgePlan(id=GHOST_EDGE, start=nodes[0].id, end=nodes[1].id, lanes=(lane,))
    return edge, (nodes[0], nodes[1])


def ghost_path(scene: Scene) -> Floats:
    """(P, 2) the AV's path, begun behind its first pose and continued straight ahead."""
    row = scene.tracks.row(scene.av_id)
    valid = scene.tracks.valid[row]
    positions = scene.tracks.position_m[row][valid]
    headings = scene.tracks.heading_rad[row][valid]
    path = [positions[0]]
    for position in positions[1:]:
        if np.hypot(*(position - path[-1])) >= SPACING_M:
            path.append(position)
    before = path[0] - BEHIND_M * angles.unit(headings[0])
    way = np.array([before, *path])
    ahead = angles.unit(headings[-1]) if len(path) == 1 else cutting.end_direction(way)
    return np.vstack([way, way[-1] + AHEAD_M * ahead])
