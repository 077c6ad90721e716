"""Distances of paths as curves, without regard to time (SSPD: Besse et al., T-ITS 17, 2016)."""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.datatypes import Case, Floats, Rollout
from deepmf_sumo.geometry import polylines
from deepmf_sumo.metrics.episode import parts


class Paths(NamedTuple):
    """The opponent's path (K, 2) and its recording's (K, 2), at least three points."""

    attack: Floats
    recorded: Floats


def compared(rollout: Rollout, case: Case, *, until_contact: bool = False) -> Paths | str:
    """Paths of one rollout, or the reason why there are none.

    Both over the steps that attack and recording have: what the policy drove, and what its last
    plan says of the time after the end; until contact: what it drove alone.
    """
    row = parts.opponent_row(rollout)
    if row is None:
        return parts.NO_OPPONENT
    if not parts.is_recorded(case, rollout.tracks.ids[row]):
        return parts.NO_LOG
    if not parts.driven(rollout, row).any():
        return parts.NEVER_DRIVEN
    stretches = parts.compared_stretches(rollout, case, row, beyond=not until_contact)
    if sum(len(one.attack_m) for one in stretches) < 3:
        return parts.TOO_SHORT
    attack, recorded = (np.concatenate(side) for side in zip(*stretches, strict=True))
    return Paths(attack, recorded)


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
