"""The paper's pseudo-labels for the opponent network (section IV-B1), from whole recordings."""

from collections.abc import Sequence

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Tracks
from deepmf_sumo.geometry import boxes


def interacting(tracks: Tracks, av_id: AgentId, agent_ids: Sequence[AgentId]) -> Bools:
    """(A) whose way overlaps the AV's, at any two times, or who came close to it.

    Close: at one time the centres are nearer than the AV's length. Any vehicle may be taken as
    the AV.
    """
    av = tracks.row(av_id)
    length = float(tracks.size_m[av, 0])
    reach = np.hypot(*tracks.size_m[:, :2].T) / 2
    place = tracks.position_m[av, tracks.valid[av]]
    found = np.zeros(len(agent_ids), bool)
    if len(place) == 0:
        return found
    low, high = place.min(0), place.max(0)
    for number, agent_id in enumerate(agent_ids):
        other = tracks.row(agent_id)
        own = tracks.position_m[other, tracks.valid[other]]
        near = max(float(reach[av] + reach[other]), length)
        if len(own) == 0 or (own > high + near).all(0).any() or (own < low - near).all(0).any():
            continue  # the ways keep apart along one axis: most do
        found[number] = _close(tracks, av, other, length) or _overlap(
            tracks, av, other, float(reach[av] + reach[other])
        )
    return found


def _close(tracks: Tracks, av: int, other: int, length_m: float) -> bool:
    """Whether the centres are at one time nearer than the AV's length."""
    both = tracks.valid[av] & tracks.valid[other]
    apart = tracks.position_m[av, both] - tracks.position_m[other, both]
    return bool(len(apart) and np.hypot(apart[:, 0], apart[:, 1]).min() < length_m)


def _overlap(tracks: Tracks, av: int, other: int, reach_m: float) -> bool:
    """Whether the boxes overlap at any two times."""
    av_seen, seen = np.flatnonzero(tracks.valid[av]), np.flatnonzero(tracks.valid[other])
    av_place, place = tracks.position_m[av, av_seen], tracks.position_m[other, seen]
    away = av_place[:, None] - place
    first, second = ((away * away).sum(-1) < reach_m**2).nonzero()
    if len(first) == 0:
        return False
    hit = boxes.overlap(
        av_place[first],
        tracks.heading_rad[av, av_seen[first]],
        tracks.size_m[av, :2],
        place[second],
        tracks.heading_rad[other, seen[second]],
        tracks.size_m[other, :2],
    )
    return bool(hit.any())
