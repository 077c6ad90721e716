"""SUMO's poses: centre of the front bumper, degrees clockwise from north.

Everywhere else a pose is the centre of the box and a heading counts counter-clockwise from +x.
"""

import numpy as np
from numpy.typing import ArrayLike

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry.angles import unit, wrap


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
    angle: Floats = np.mod(90.0 - np.degrees(np.asarray(heading_rad, float)), 360.0)
    return angle
