"""Coll_jk: whether candidate j of the opponent and reaction k of the AV overlap, when and how."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Bools, Floats, Forecast, Futures, Ints, View
from deepmf_sumo.geometry import boxes, impact
from deepmf_sumo.geometry.ground import Ground, clear, ground_of

NO_SECTOR: Final = -1


def footprint(view: View, agent_id: AgentId) -> Floats:
    """(2) length and width of an agent."""
    size: Floats = view.history.size_m[view.history.row(agent_id), :2]
    return size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Levels:
    """An opponent and the AV now, (3) x, y, z each, on a road that passes over itself."""

    ground: Ground
    opponent: Floats
    av: Floats

    @classmethod
    def of(cls, view: View, opponent_id: AgentId) -> "Levels | None":
        """None where the road passes nowhere over itself, and heights decide nothing."""
        ground, tracks = ground_of(view.road), view.history
        if not ground.has_levels:
            return None
        rows = [tracks.row(opponent_id), tracks.row(view.av_id)]
        now = np.column_stack([tracks.position_m[rows, -1], tracks.z_m[rows, -1]])
        return cls(ground=ground, opponent=now[0], av=now[1])

    def opponent_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the opponent, which follow the road."""
        return self._along(futures_m, self.opponent)

    def av_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the AV."""
        return self._along(futures_m, self.av)

    def clear(self, own_m: Floats, av_m: Floats, at: tuple[Ints, Ints, Ints]) -> Bools:
        """(K) whether candidates (N, F, 2) and reactions (N, M, F, 2) pass over each other.

        ``at``: K rows, modes and steps.
        """
        row, mode, step = at
        mine, own = np.unique(row, return_inverse=True)
        theirs, other = np.unique(row * av_m.shape[1] + mode, return_inverse=True)
        reactions = av_m[np.divmod(theirs, av_m.shape[1])]
        own_z, other_z = self.opponent_z_m(own_m[mine]), self.av_z_m(reactions)
        return clear(own_z[own, step], other_z[other, step])

    def _along(self, futures_m: Floats, now: Floats) -> Floats:
        begin = np.broadcast_to(now[:2], (len(futures_m), 1, 2))
        paths = np.concatenate([begin, futures_m], axis=1)
        return self.ground.follow(paths, np.full(len(paths), now[2]))[:, 1:]


def collisions(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    horizon: int,
    levels: Levels | None = None,
) -> tuple[Bools, Floats]:
    """(N1, N2) overlap of the oriented boxes at the same time, and (N1, N2) its first step.

    Every step (10 Hz) of the first ``horizon`` is tested; where there is no overlap the step is F,
    the length of the futures. Sizes are (2): length, width. Pairs of poses whose centres are
    farther apart than the half diagonals reach are not tested: they cannot overlap. ``levels`` says
    which of them pass over each other.
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
    if levels is not None:
        hit[hit] = ~levels.clear(own, other, (row[hit], mode[hit], step[hit]))
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
