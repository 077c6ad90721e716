"""Angles, and changes between frames: of the scene, of a pose in it, and of SUMO.

Angles are radians, counter-clockwise from +x. In the frame of a pose x is ahead and y to the left.
SUMO's poses are the centre of the front bumper and degrees clockwise from north; everywhere else a
pose is the centre of the box.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from deepmf_sumo.scene import AgentId, Floats, View

TURNED_RAD: Final = 1e4
"""No vehicle turns this far: an angle beyond is a mistake, and rounding hides its direction."""


def wrap(angle_rad: Floats | float) -> Floats:
    """The same direction in (-pi, pi]."""
    return np.pi - np.mod(np.pi - np.asarray(angle_rad, float), 2 * np.pi)


def difference(to_rad: Floats | float, from_rad: Floats | float) -> Floats:
    """Smallest signed turn from one direction to the other, in (-pi, pi]."""
    return wrap(np.asarray(to_rad, float) - np.asarray(from_rad, float))


def unit(heading_rad: Floats | float) -> Floats:
    """(..., 2) unit vectors of headings (...)."""
    heading = np.asarray(heading_rad, float)
    found = np.empty((*heading.shape, 2))  # `np.stack` takes three times as long for a few
    found[..., 0], found[..., 1] = np.cos(heading), np.sin(heading)
    return found


def to_local(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points (..., 2) of the scene in the frame of the pose."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    shifted = np.asarray(points_m, float) - origin_m
    return shifted @ np.array([[cos, -sin], [sin, cos]])


def to_scene(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points (..., 2) of the pose's frame in the scene's."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return np.asarray(points_m, float) @ np.array([[cos, sin], [-sin, cos]]) + origin_m


def rotate(vectors: Floats, angle_rad: float) -> Floats:
    """Vectors (..., 2) turned counter-clockwise by an angle."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(vectors, float) @ np.array([[cos, sin], [-sin, cos]])


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentFrame:
    """Where an agent is now, as a frame: what networks read of a view is in it."""

    agent_id: AgentId
    position_m: Floats
    heading_rad: float
    speed_mps: float

    def to_local(self, points_m: Floats) -> Floats:
        """Points (..., 2) of the scene in the agent's frame."""
        return to_local(points_m, self.position_m, self.heading_rad)

    def vectors(self, vectors: Floats) -> Floats:
        """Vectors (..., 2) of the scene in the agent's frame."""
        return rotate(vectors, -self.heading_rad)

    def turn_rad(self, heading_rad: Floats) -> Floats:
        """Headings (...) of the scene in the agent's frame."""
        return wrap(heading_rad - self.heading_rad)


def pose_of(view: View, agent_id: AgentId) -> AgentFrame:
    """The agent's pose at the view's step. Raises KeyError if it is not in view."""
    row = view.history.row(agent_id)
    return AgentFrame(
        agent_id=agent_id,
        position_m=view.history.position_m[row, -1],
        heading_rad=float(view.history.heading_rad[row, -1]),
        speed_mps=float(view.history.speed_mps[row, -1]),
    )


def to_sumo(
    centre_m: ArrayLike, heading_rad: ArrayLike, length_m: ArrayLike
) -> tuple[Floats, Floats]:
    """Front bumpers (..., 2) and SUMO angles (...) in [0, 360) of boxes."""
    half = np.asarray(length_m, float)[..., None] / 2
    front: Floats = np.asarray(centre_m, float) + half * unit(np.asarray(heading_rad, float))
    return front, sumo_angle(heading_rad)


def from_sumo(
    front_m: ArrayLike, angle_deg: ArrayLike, length_m: ArrayLike
) -> tuple[Floats, Floats]:
    """Centres (..., 2) and headings (...) in (-pi, pi] of vehicles as SUMO gives them."""
    heading = wrap(np.radians(90.0 - np.asarray(angle_deg, float)))
    half = np.asarray(length_m, float)[..., None] / 2
    centre: Floats = np.asarray(front_m, float) - half * unit(heading)
    return centre, heading


def sumo_angle(heading_rad: ArrayLike) -> Floats:
    """Degrees clockwise from north, in [0, 360)."""
    return np.mod(90.0 - np.degrees(np.asarray(heading_rad, float)), 360.0)
