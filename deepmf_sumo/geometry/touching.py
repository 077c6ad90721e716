"""Overlaps of many pairs of boxes of which few are near each other."""

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats
from deepmf_sumo.geometry import boxes


def touching(
    centre_a: Floats,
    heading_a: Floats,
    size_a: Floats,
    centre_b: Floats,
    heading_b: Floats,
    size_b: Floats,
) -> Bools:
    """(...) as `boxes.overlap` for centres (..., 2) and headings (...), which broadcast.

    Sizes are (2). Only pairs whose centres are nearer than the half diagonals reach are tested.
    """
    offset = centre_b - centre_a
    reach = (np.hypot(*size_a) + np.hypot(*size_b)) / 2
    hit: Bools = np.asarray((offset**2).sum(-1) < reach**2)
    near = np.nonzero(hit)
    pairs = hit.shape
    hit[near] = boxes.overlap(
        np.broadcast_to(centre_a, offset.shape)[near],
        np.broadcast_to(heading_a, pairs)[near],
        size_a,
        np.broadcast_to(centre_b, offset.shape)[near],
        np.broadcast_to(heading_b, pairs)[near],
        size_b,
    )
    return hit
