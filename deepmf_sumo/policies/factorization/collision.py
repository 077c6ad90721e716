"""Coll_jk: whether candidate j of the opponent and reaction k of the AV overlap, and when."""

from collections.abc import Sequence

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Forecast, Futures
from deepmf_sumo.geometry import boxes


def collisions(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    horizon: int,
) -> tuple[Bools, Floats]:
    """(N1, N2) overlap of the oriented boxes at the same time, and (N1, N2) its first step.

    Every step (10 Hz) of the first ``horizon`` is tested; where there is no overlap the step is F,
    the length of the futures. Sizes are (2): length, width. Pairs of poses whose centres are
    farther apart than the half diagonals reach are not tested: they cannot overlap.
    """
    own, own_heading = candidates.position_m[:, None], candidates.heading_rad[:, None]
    other = np.stack([reaction.futures.position_m for reaction in reactions])
    other_heading = np.stack([reaction.futures.heading_rad for reaction in reactions])
    steps = own.shape[2]
    offset = other[:, :, :horizon] - own[:, :, :horizon]
    reach = (np.hypot(*opponent_size_m) + np.hypot(*av_size_m)) / 2
    near = np.nonzero((offset**2).sum(-1) < reach**2)
    row, mode, step = near
    hit = boxes.overlap(
        candidates.position_m[row, step],
        own_heading[row, 0, step],
        opponent_size_m,
        other[near],
        other_heading[near],
        av_size_m,
    )
    first = np.full(other.shape[:2], float(steps))
    np.minimum.at(first, (row[hit], mode[hit]), step[hit].astype(float))
    return first < steps, first
