"""How two road users touched within the step of their contact, which ends deep in each other.

At the end of the step a fast AV may be half through a crossing car, or beyond a person. So the step
is looked at in parts, in which both move steadily.
"""

from typing import Final, Literal, NamedTuple

import numpy as np

from deepmf_sumo.scene import AgentId, Contact, Floats, Rollout
from deepmf_sumo.scene.geometry import boxes, frames, impact
from deepmf_sumo.scene.road_users import road_user

_BUMPER_M: Final = 0.1
_PARTS_LEFT: Final = np.linspace(0.95, 0.0, 20)
"""Of the step: at 40 m/s 0.2 m from one to the next."""


Face = Literal["front", "left", "right", "rear"]


class FrontTouch(NamedTuple):
    """The front bumper reaches the other: (3) x, y, heading of both."""

    av: Floats
    other: Floats


class Touch(NamedTuple):
    """Of a contact, seen from its first road user, the AV.

    Attributes:
        bearing_rad: where the other's centre is when they first overlap, from the AV's heading.
        front: both when the AV's front bumper first reaches the other; None if it never does.
        face: of the AV's box that the other touches first.
        own_mps: speed at which the AV's face moved towards the other there. their_mps: at which the
            other moved towards that face.
    """

    bearing_rad: float
    front: FrontTouch | None
    face: Face
    own_mps: float
    their_mps: float

    @property
    def ran_into(self) -> Face | None:
        """The face other than the front that the other ran into; None if the AV hit the other.

        A side strikes where it sweeps outwards faster than the other comes: in a turn.
        """
        return self.face if self.front is None and self.their_mps > self.own_mps else None


def first_touch(rollout: Rollout, contact: Contact) -> Touch:
    """The two poses at which the AV and the other first touch, and at which its bumper does."""
    pose, size_m = _during_step(rollout, contact, contact.first_id, contact.pose_first)
    others, other_m = _during_step(rollout, contact, contact.second_id, contact.pose_second)
    their_box = others[:, :2], others[:, 2], other_m
    touch = int(boxes.overlap(pose[:, :2], pose[:, 2], size_m, *their_box).argmax())
    x, y = others[touch, :2] - pose[touch, :2]
    bearing = frames.difference(float(np.arctan2(y, x)), float(pose[touch, 2]))
    front = boxes.overlap(*_bumper(pose, size_m), *their_box)
    reached = int(front.argmax())
    at_front = FrontTouch(pose[reached], others[reached]) if front.any() else None
    seconds = (1.0 - _PARTS_LEFT[0]) * rollout.dt_s * (len(_PARTS_LEFT) - 1)
    face, out = _face(pose[touch], others[touch], size_m)
    if at_front is not None:
        face, out = "front", np.array([1.0, 0.0])
    place = frames.to_local(others[touch, :2], pose[touch, :2], float(pose[touch, 2]))
    place = np.clip(place, -size_m / 2, size_m / 2)
    normal = frames.rotate(out, float(pose[touch, 2]))
    begin, end = (frames.to_scene(place, one[:2], float(one[2])) for one in pose[[0, -1]])
    theirs = others[-1, :2] - others[0, :2]
    return Touch(
        float(bearing), at_front, face, float((end - begin) @ normal) / seconds,
        -float(theirs @ normal) / seconds,
    )  # fmt: skip


def _face(pose: Floats, other: Floats, size_m: Floats) -> tuple[Face, Floats]:
    """The side or the rear of an AV at a pose (3) where another is, and its outward normal (2)."""
    x, y = frames.to_local(other[:2], pose[:2], float(pose[2]))
    if -x - size_m[0] / 2 > abs(y) - size_m[1] / 2:
        return "rear", np.array([-1.0, 0.0])
    return ("left", np.array([0.0, 1.0])) if y > 0 else ("right", np.array([0.0, -1.0]))


def share_of_front(rollout: Rollout, contact: Contact) -> float | None:
    """Where on the AV's front bumper the other is first reached; None if the front never is.

    0 is the AV's left end, 1 its right one. Of a pedestrian or cyclist the middle of the box counts
    (a body has no corners), of a vehicle the middle of what the bumper overlaps.
    """
    touch, tracks = first_touch(rollout, contact).front, rollout.tracks
    if touch is None:
        return None
    av, other = tracks.row(contact.first_id), tracks.row(contact.second_id)
    size_m, other_m = tracks.size_m[av, :2], tracks.size_m[other, :2]
    place = touch.other[:2]
    if not road_user(tracks.kinds[other], tracks.size_m[other]).person:
        bumper = _bumper(touch.av[None], size_m)
        local = impact.overlap_middle(*bumper, touch.other[:2], touch.other[2], other_m)[0]
        left_m = float(local[1])
    else:
        left_m = float(frames.to_local(place, touch.av[:2], float(touch.av[2]))[1])
    return float(np.clip(0.5 - left_m / size_m[1], 0.0, 1.0))


def _bumper(pose: Floats, size_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Boxes around the front end of an AV at poses (P, 3)."""
    ahead = pose[:, :2] + size_m[0] / 2 * frames.unit(pose[:, 2])
    return ahead, pose[:, 2], np.array([_BUMPER_M, size_m[1]])


def _during_step(
    rollout: Rollout, contact: Contact, agent_id: AgentId, end: Floats
) -> tuple[Floats, Floats]:
    """(P, 3) poses during the step of the contact until its end (3), and the agent's size (2)."""
    tracks, before = rollout.tracks, max(contact.step - 1, 0)
    row = tracks.row(agent_id)
    turn = frames.difference(end[2], tracks.heading_rad[row, before])
    moved = np.append(end[:2] - tracks.position_m[row, before], turn)
    return end - _PARTS_LEFT[:, None] * moved, tracks.size_m[row, :2]
