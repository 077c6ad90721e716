"""Whether predicted modes stay on the road and clear of what the others really did."""

from typing import Final

import numpy as np

from deepmf_sumo.datatypes import FUTURE_STEPS, Bools, Floats, Ints
from deepmf_sumo.geometry import boxes, road
from deepmf_sumo.training.evaluation.targets import Target

_EVERY: Final = 5
"""The road is looked up each half second."""
NEVER: Final = FUTURE_STEPS
"""Step of what does not happen within 8 s."""


def first_overlap(target: Target, position_m: Floats, heading_rad: Floats) -> Ints:
    """(M) first step at which the target's box overlaps another agent's, `NEVER` if none.

    Modes are (M, 80, 2) and (M, 80), not finite where nothing is known. The others do what they
    did.
    """
    tracks, now = target.scene.tracks, target.view.step
    stop = min(now + 1 + FUTURE_STEPS, tracks.steps)
    steps = stop - now - 1
    others = np.arange(tracks.agents) != tracks.row(target.agent_id)
    centre = tracks.position_m[others, now + 1 : stop]  # (A, F, 2)
    there = tracks.valid[others, now + 1 : stop]
    size = tracks.size_m[:, :2]
    own_size = size[tracks.row(target.agent_id)]
    reach = (np.hypot(*own_size) + np.hypot(*size[others].T)) / 2  # (A)
    offset = position_m[:, None, :steps] - centre  # (M, A, F, 2)
    near = (offset[..., 0] ** 2 + offset[..., 1] ** 2 < reach[:, None] ** 2) & there
    mode, agent, step = near.nonzero()
    hit = boxes.overlap(
        position_m[mode, step],
        heading_rad[mode, step],
        own_size,
        centre[agent, step],
        tracks.heading_rad[others, now + 1 : stop][agent, step],
        size[others][agent],
    )
    first = np.full(len(position_m), NEVER)
    np.minimum.at(first, mode[hit], step[hit])
    return first


def first_off_road(target: Target, position_m: Floats) -> Ints:
    """(M) first half second, as a step, at which the centre is off the lanes, `NEVER` if none."""
    steps = np.arange(_EVERY - 1, FUTURE_STEPS, _EVERY)
    places = position_m[:, steps]  # (M, 16, 2)
    known: Bools = np.isfinite(places[..., 0])
    off = np.zeros(known.shape, bool)
    off[known] = ~road.on_road(target.view.road, places[known])
    return np.where(off.any(1), steps[off.argmax(1)], NEVER)
