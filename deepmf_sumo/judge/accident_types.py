"""Types of accidents, by what the vehicles met with and by their directions at the contact.

An impact is one of ends if, a step before the contact, the boxes are farther apart along the AV
than across it; otherwise it is one of sides.
"""

from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.scene import DT_S, Floats, Rollout, Tracks
from deepmf_sumo.scene.geometry import boxes, frames, polylines

AccidentType = Literal["cut_in", "rear_end", "t_bone", "head_on", "sideswipe"]
ACCIDENT_TYPES: Final[tuple[AccidentType, ...]] = get_args(AccidentType)
"""In the order of the metric's numbers: 0 is a cut-in."""
_PARALLEL_ENDS_RAD, _PARALLEL_SIDES_RAD = np.pi / 4, np.pi / 6
CUT_IN_S: Final = 3.0
"""In a cut-in the vehicle in front was beside the other's path at some time of these seconds."""
_STRAIGHT_M = 100.0


def accident_type_of(rollout: Rollout) -> AccidentType:
    """Name of the collision of AV and opponent. Raises ValueError if there was none.

    Headings at the contact are parallel within 45 degrees for an impact of ends, and within 30 for
    one of sides; otherwise it is a T-bone. In the same direction an impact of ends is a cut-in if
    the vehicle in front was entirely beside the other's path within the 3 s before, else a rear-end
    collision; in opposite directions it is head-on. Impacts of sides are sideswipes.
    """
    contact = rollout.first("av_opponent")
    if contact is None:
        raise ValueError("AV and opponent did not collide")
    tracks, step = rollout.tracks, contact.step - 1
    rows = [tracks.row(contact.first_id), tracks.row(contact.second_id)]
    turn = abs(float(frames.difference(contact.pose_second[2], contact.pose_first[2])))
    position, heading = tracks.position_m[rows, step], tracks.heading_rad[rows, step].tolist()
    size = tracks.size_m[rows, :2]
    of_ends = boxes.end_to_end(position[0], heading[0], size[0], position[1], heading[1], size[1])
    if min(turn, np.pi - turn) > (_PARALLEL_ENDS_RAD if of_ends else _PARALLEL_SIDES_RAD):
        return "t_bone"
    if not of_ends:
        return "sideswipe"
    if turn > np.pi / 2:
        return "head_on"
    ahead = frames.to_local(position[1], position[0], heading[0])[0]
    follower, leader = rows if ahead > 0 else rows[::-1]
    beside = came_from_beside(tracks, follower, leader, contact.step, rollout.dt_s)
    return "cut_in" if beside else "rear_end"


def came_from_beside(
    tracks: Tracks, follower: int, leader: int, step: int, dt_s: float = DT_S
) -> bool:
    """Whether the leader was entirely beside the follower's path at a time of the last 3 s."""
    first = max(0, step - round(CUT_IN_S / dt_s))
    recent = tracks.position_m[leader, first:step]
    recent = recent[tracks.valid[leader, first:step]]
    apart = np.abs(polylines.project(_path(tracks, follower, step), recent).left_m)
    return bool((apart > (tracks.size_m[follower, 1] + tracks.size_m[leader, 1]) / 2).any())


def _path(tracks: Tracks, row: int, step: int) -> Floats:
    """(P, 2) the path that an agent drove up to a step, extended straight at both ends."""
    steps = np.flatnonzero(tracks.valid[row, :step])
    driven, heading = tracks.position_m[row, steps], tracks.heading_rad[row, steps]
    reach = _STRAIGHT_M * frames.unit(heading[[0, -1]])
    path: Floats = np.concatenate([driven[:1] - reach[:1], driven, driven[-1:] + reach[1:]])
    return path
