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

from deepmf_sumo.avoidance.braking import STANDING_MPS
from deepmf_sumo.avoidance.lanes import keeps_lane
from deepmf_sumo.datatypes import Case, Contact, Rollout
from deepmf_sumo.geometry import angles, boxes

Collision = Literal["av_stopped", "other_stopped", "active_rear", "active_front", "active_lateral"]

BEHIND_RAD: Final = np.radians(30)
_BUMPER_M = 0.1


def collision_class(rollout: Rollout, contact: Contact) -> Collision:
    """Class of a contact of the AV, from the speeds at the step before it."""
    tracks, before = rollout.tracks, max(contact.step - 1, 0)
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    if tracks.speed_mps[av, before] <= STANDING_MPS:
        return "av_stopped"
    if tracks.speed_mps[other, before] <= STANDING_MPS:
        return "other_stopped"
    offset = contact.pose_second[:2] - contact.pose_first[:2]
    course = float(contact.pose_first[2])
    aside = angles.difference(float(np.arctan2(offset[1], offset[0])), course)
    if abs(float(aside)) >= np.pi - BEHIND_RAD:
        return "active_rear"
    length, width = tracks.size_m[av, :2]
    bumper = contact.pose_first[:2] + length / 2 * angles.unit(course)
    front = boxes.overlap(
        bumper,
        np.asarray(course),
        np.array([_BUMPER_M, width]),
        contact.pose_second[:2],
        np.asarray(contact.pose_second[2]),
        tracks.size_m[other, :2],
    )
    return "active_front" if front else "active_lateral"


def av_at_fault(rollout: Rollout, case: Case) -> bool | None:
    """Whether the contact with the opponent is the AV's fault; None where they did not touch."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return None
    found = collision_class(rollout, contact)
    if found == "active_lateral":
        width = float(rollout.tracks.size_m[rollout.tracks.row(contact.first_id), 1])
        pose = contact.pose_first
        return not keeps_lane(case.road, pose[:2], float(pose[2]), width)
    return found in ("other_stopped", "active_front")
