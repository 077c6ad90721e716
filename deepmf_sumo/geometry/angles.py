"""Angles in radians, counter-clockwise from +x."""

import numpy as np

from deepmf_sumo.datatypes import Floats


def wrap(angle_rad: Floats | float) -> Floats:
    """The same direction in (-pi, pi]."""
    wrapped: Floats = np.pi - np.mod(np.pi - np.asarray(angle_rad, float), 2 * np.pi)
    return wrapped


def difference(to_rad: Floats | float, from_rad: Floats | float) -> Floats:
    """Smallest signed turn from one direction to the other, in (-pi, pi]."""
    return wrap(np.asarray(to_rad, float) - np.asarray(from_rad, float))


def unit(heading_rad: Floats | float) -> Floats:
    """(..., 2) unit vectors of headings (...)."""
    heading = np.asarray(heading_rad, float)
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)
