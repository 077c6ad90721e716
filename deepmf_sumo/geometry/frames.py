"""Changes between the scene's frame and the frame of a pose (x ahead, y to the left)."""

import numpy as np

from deepmf_sumo.datatypes import Floats


def to_local(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points (..., 2) of the scene in the frame of the pose."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    shifted = np.asarray(points_m, float) - origin_m
    local: Floats = shifted @ np.array([[cos, -sin], [sin, cos]])
    return local


def to_scene(points_m: Floats, origin_m: Floats, heading_rad: float) -> Floats:
    """Points (..., 2) of the pose's frame in the scene's."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    scene: Floats = np.asarray(points_m, float) @ np.array([[cos, sin], [-sin, cos]]) + origin_m
    return scene


def rotate(vectors: Floats, angle_rad: float) -> Floats:
    """Vectors (..., 2) turned counter-clockwise by an angle."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned: Floats = np.asarray(vectors, float) @ np.array([[cos, sin], [-sin, cos]])
    return turned
