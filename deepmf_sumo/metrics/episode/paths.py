"""Distances of paths as curves, without regard to time (SSPD: Besse et al., T-ITS 17, 2016)."""

import numpy as np

from deepmf_sumo.datatypes import Floats
from deepmf_sumo.geometry import polylines


def directed(points_m: Floats, path_m: Floats) -> Floats:
    """(N) distances of points (N, 2) to a path (P, 2), P >= 2, as a polyline."""
    distance: Floats = polylines.project(path_m, points_m).distance_m
    return distance


def symmetric_mean(a_m: Floats, b_m: Floats) -> float:
    """Symmetrised segment-path distance: mean of the two mean directed distances."""
    return float((directed(a_m, b_m).mean() + directed(b_m, a_m).mean()) / 2)


def hausdorff(a_m: Floats, b_m: Floats) -> float:
    """The larger of the two greatest directed distances."""
    return float(np.maximum(directed(a_m, b_m).max(), directed(b_m, a_m).max()))
