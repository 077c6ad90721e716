"""Coll_jk: whether candidate j of the opponent and reaction k of the AV overlap, when and how."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Bools, Floats, Forecast, Futures, Ints, View
from deepmf_sumo.geometry import boxes, impact

NO_SECTOR: Final = -1


def footprint(view: View, agent_id: AgentId) -> Floats:
    """(2) length and width of an agent."""
    size: Floats = view.history.size_m[view.history.row(agent_id), :2]
    return size


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
    own, other = candidates.position_m, _stacked([each.futures.position_m for each in reactions])
    other_heading = _stacked([each.futures.heading_rad for each in reactions])
    # each axis by itself: numpy is slow at sums over the two of them
    x, y = (own[:, None, :horizon, axis] - other[:, :, :horizon, axis] for axis in range(2))
    reach = (np.hypot(*opponent_size_m) + np.hypot(*av_size_m)) / 2
    near = np.nonzero(x * x + y * y < reach**2)
    row, mode, step = near
    hit = boxes.overlap(
        own[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
        other[near],
        other_heading[near],
        av_size_m,
    )
    steps = own.shape[1]
    first = np.full(other.shape[:2], float(steps))
    np.minimum.at(first, (row[hit], mode[hit]), step[hit].astype(float))
    return first < steps, first


def _stacked(arrays: Sequence[Floats]) -> Floats:
    """(N, ...); the same array for all is not copied."""
    if all(each is arrays[0] for each in arrays):
        return np.broadcast_to(arrays[0], (len(arrays), *arrays[0].shape))
    return np.stack(arrays)


def impact_sectors(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Ints:
    """(N1, N2) sector of the AV, 0..7, in which each pair first overlaps; `NO_SECTOR` without.

    The same judgement as that of contacts in the simulation (`geometry.impact`).
    """
    found = np.full(collision_step.shape, NO_SECTOR)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    step = collision_step[row, mode].astype(int)
    other = np.stack([reaction.futures.position_m for reaction in reactions])
    other_heading = np.stack([reaction.futures.heading_rad for reaction in reactions])
    found[row, mode] = impact.sectors(
        other[row, mode, step],
        other_heading[row, mode, step],
        av_size_m,
        candidates.position_m[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
    )
    return found


def delta_v(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Floats:
    """(N1, N2) change of the AV's velocity in m/s (`Contact.delta_v_mps`); 0 without contact."""
    change = np.zeros(collision_step.shape)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    after = np.maximum(collision_step[row, mode].astype(int), 1)
    other = np.stack([reaction.futures.position_m for reaction in reactions])
    apart = other[row, mode, after] - candidates.position_m[row, after]
    before = other[row, mode, after - 1] - candidates.position_m[row, after - 1]
    area, av_area = np.prod(opponent_size_m), np.prod(av_size_m)
    relative = np.hypot(*(apart - before).T) / DT_S
    change[row, mode] = relative * area / (area + av_area)
    return change
