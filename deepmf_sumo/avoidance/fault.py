"""Who is at fault in a contact, by the classes of nuPlan's at-fault collisions.

Caesar et al., nuPlan, 2021 (metric ``no_ego_at_fault_collisions``): the AV is at fault if it hits
something that stands, or hits with its front, or touches sideways while it is not within one lane.
It is not at fault while it stands itself, or where it is hit from behind. The classes know neither
a right of way nor a cut-in: a car that pulls in close before the AV and is hit there counts against
the AV; `grading` says whether it could have done anything. A vehicle stands at less than 0.1 m/s
(nuPlan: 0.05, which recorded velocities of standing vehicles exceed).
"""

from typing import Final, Literal

import numpy as np

from deepmf_sumo.avoidance.lanes import keeps_lane
from deepmf_sumo.datatypes import AgentId, Case, Contact, Floats, Rollout
from deepmf_sumo.geometry import angles, boxes
from deepmf_sumo.geometry.slow import STANDING_MPS

Collision = Literal["av_stopped", "other_stopped", "active_rear", "active_front", "active_lateral"]

BEHIND_RAD: Final = np.radians(30)
_BUMPER_M = 0.1
_PARTS_LEFT = np.linspace(0.95, 0.0, 20)  # of the step: at 40 m/s 0.2 m from one to the next


def collision_class(rollout: Rollout, contact: Contact) -> Collision:
    """Class of a contact of the AV, from the speeds at the step before it."""
    tracks, before = rollout.tracks, max(contact.step - 1, 0)
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    if tracks.speed_mps[av, before] <= STANDING_MPS:
        return "av_stopped"
    if tracks.speed_mps[other, before] <= STANDING_MPS:
        return "other_stopped"
    pose, size_m = _during_step(rollout, contact, contact.first_id, contact.pose_first)
    others, other_m = _during_step(rollout, contact, contact.second_id, contact.pose_second)
    their_box = others[:, :2], others[:, 2], other_m
    touch = int(boxes.overlap(pose[:, :2], pose[:, 2], size_m, *their_box).argmax())
    x, y = others[touch, :2] - pose[touch, :2]
    aside = angles.difference(float(np.arctan2(y, x)), float(pose[touch, 2]))
    if abs(float(aside)) >= np.pi - BEHIND_RAD:
        return "active_rear"
    bumper = pose[:, :2] + size_m[0] / 2 * angles.unit(pose[:, 2])
    front = boxes.overlap(bumper, pose[:, 2], np.array([_BUMPER_M, size_m[1]]), *their_box)
    return "active_front" if front.any() else "active_lateral"


def _during_step(
    rollout: Rollout, contact: Contact, agent_id: AgentId, end: Floats
) -> tuple[Floats, Floats]:
    """(P, 3) poses during the step of the contact until its end (3), and the agent's size (2).

    At its end alone a fast AV may be half through a car that crosses: its front is beyond it.
    """
    tracks, before = rollout.tracks, max(contact.step - 1, 0)
    row = tracks.row(agent_id)
    turn = angles.difference(end[2], tracks.heading_rad[row, before])
    moved = np.append(end[:2] - tracks.position_m[row, before], turn)
    return end - _PARTS_LEFT[:, None] * moved, tracks.size_m[row, :2]


def av_at_fault(rollout: Rollout, case: Case) -> bool | None:
    """Whether the contact with the opponent is the AV's fault; None where they did not touch."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    found = collision_class(rollout, contact)
    if found == "active_lateral":
        width = float(rollout.tracks.size_m[rollout.tracks.row(contact.first_id), 1])
        pose = contact.pose_first
        z_m = rollout.tracks.z_m[rollout.tracks.row(contact.first_id), contact.step]
        return not keeps_lane(case.road, pose[:2], float(pose[2]), width, float(z_m))
    return found in ("other_stopped", "active_front")
