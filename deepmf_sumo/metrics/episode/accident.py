"""What an accident is called: by headings, by the sides that meet, by who came from beside.

The impact is one of ends where, a step before the contact, the boxes are farther apart along the
AV than across it; else one of sides.
"""

from typing import Final, Literal, get_args

import numpy as np

from deepmf_sumo.datatypes import AgentId, Case, Contact, Floats, Rollout
from deepmf_sumo.geometry import angles, frames, polylines

AccidentType = Literal["cut_in", "rear_end", "t_bone", "head_on", "sideswipe"]
ACCIDENT_TYPES: Final[tuple[AccidentType, ...]] = get_args(AccidentType)
"""In the order of the metric's numbers: 0 is a cut-in."""
_PARALLEL_ENDS_RAD, _PARALLEL_SIDES_RAD = np.pi / 4, np.pi / 6
_CUT_IN_S = 3.0
_STRAIGHT_M = 100.0


def accident_type(rollout: Rollout, case: Case) -> AccidentType | None:
    """Name of the collision of AV and opponent; None if there was none.

    Headings at the contact are parallel within 45 degrees for an impact of ends, and within 30 for
    one of sides; else it is a T-bone. In the same direction an impact of ends is a cut-in, if the
    one in front was wholly beside the other's way within the 3 s before, else a rear-end collision;
    in opposite directions it is head-on. Impacts of sides are sideswipes.
    """
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    turn = abs(float(angles.difference(contact.pose_second[2], contact.pose_first[2])))
    ahead, of_ends = _last_offset(rollout, contact)
    if min(turn, np.pi - turn) > (_PARALLEL_ENDS_RAD if of_ends else _PARALLEL_SIDES_RAD):
        return "t_bone"
    if not of_ends:
        return "sideswipe"
    if turn > np.pi / 2:
        return "head_on"
    pair = contact.first_id, contact.second_id
    follower, leader = pair if ahead > 0 else pair[::-1]
    return "cut_in" if _came_from_beside(rollout, contact, follower, leader) else "rear_end"


def _last_offset(rollout: Rollout, contact: Contact) -> tuple[float, bool]:
    """How far the second agent was ahead of the first a step before; whether ends meet."""
    tracks, step = rollout.tracks, contact.step - 1
    first, second = tracks.row(contact.first_id), tracks.row(contact.second_id)
    heading = float(tracks.heading_rad[first, step])
    x, y = frames.to_local(tracks.position_m[second, step], tracks.position_m[first, step], heading)
    turn = tracks.heading_rad[second, step] - heading
    cos, sin = abs(np.cos(turn)), abs(np.sin(turn))
    (length, width), other = tracks.size_m[first, :2], tracks.size_m[second, :2]
    along = abs(x) - (length + other @ [cos, sin]) / 2
    across = abs(y) - (width + other @ [sin, cos]) / 2
    return float(x), bool(along >= across)


def _came_from_beside(
    rollout: Rollout, contact: Contact, follower: AgentId, leader: AgentId
) -> bool:
    """Whether the leader was wholly beside the follower's way in the last seconds."""
    tracks = rollout.tracks
    behind, front = tracks.row(follower), tracks.row(leader)
    way = _way(rollout, behind, contact.step)
    begin = max(0, contact.step - round(_CUT_IN_S / rollout.dt_s))
    recent = tracks.position_m[front, begin : contact.step]
    recent = recent[tracks.valid[front, begin : contact.step]]
    apart = np.abs(polylines.project(way, recent).left_m)
    return bool((apart > (tracks.size_m[behind, 1] + tracks.size_m[front, 1]) / 2).any())


def _way(rollout: Rollout, row: int, step: int) -> Floats:
    """(P, 2) the path that an agent drove up to a step, straight on before and behind it."""
    tracks = rollout.tracks
    steps = np.flatnonzero(tracks.valid[row, :step])
    driven, heading = tracks.position_m[row, steps], tracks.heading_rad[row, steps]
    reach = _STRAIGHT_M * angles.unit(heading[[0, -1]])
    way: Floats = np.concatenate([driven[:1] - reach[:1], driven, driven[-1:] + reach[1:]])
    return way
