"""Whether a competent driver could avoid what an opponent is about to do: many futures at once.

The fast form of the driver models of `drivers`, for choosing among candidates before any of them
is driven: the AV keeps its speed along its path until the driver in its place reacts.
"""

from typing import Literal

import numpy as np

from deepmf_sumo.avoidance import braking, drivers
from deepmf_sumo.avoidance.approach import Approach
from deepmf_sumo.avoidance.path import Path, State
from deepmf_sumo.datatypes import Bools, Floats

By = Literal["any", "all", "cc", "fsm", "rss"]


def avoidable(
    av_start: State,
    av_size_m: Floats,
    av_path_m: Floats,
    opponent_now: State,
    opponent_size_m: Floats,
    opponent_position_m: Floats,
    opponent_heading_rad: Floats,
    dt_s: float,
    by: By = "any",
    av_along_m: Floats | None = None,
) -> Bools:
    """(N) whether there is no contact with future n of the opponent if a reference driver drives.

    ``av_start`` is the AV at the current step, whose speed it keeps until the driver reacts;
    ``av_path_m`` (P, 2), P >= 0, are points ahead of it as far as known, then it goes straight on.
    ``opponent_now`` is the opponent at the current step, ``opponent_position_m`` (N, K, 2) and
    ``opponent_heading_rad`` (N, K) are its futures from the step after it, every ``dt_s``. Sizes
    are (2): length, width. ``by`` names the driver who has to avoid: one of `drivers.MODELS`,
    ``any`` of them or ``all``. ``av_along_m`` (K + 1) is how far the AV has driven along its path,
    now and at the opponent's steps, where it is known to do otherwise than to keep its speed.
    """
    path = Path.through(av_start.position_m[None], np.array([av_start.heading_rad]), av_path_m)
    futures, steps = np.shape(opponent_heading_rad)
    before = np.broadcast_to(opponent_now.position_m, (futures, 1, 2))
    position = np.concatenate([before, opponent_position_m], axis=1)
    before_rad = np.full((futures, 1), opponent_now.heading_rad)
    heading = np.concatenate([before_rad, opponent_heading_rad], axis=1)
    approach = Approach.of(path, position, heading, opponent_size_m, av_size_m, dt_s)
    steady_m = av_start.speed_mps * dt_s * np.arange(steps + 1)
    driven_m = steady_m if av_along_m is None else av_along_m
    models = list(drivers.MODELS.values()) if by in ("any", "all") else [drivers.MODELS[by]]
    avoided = braking.outcome(models, path, approach, driven_m).avoided
    result: Bools = np.all(avoided, axis=0) if by == "all" else np.any(avoided, axis=0)
    return result
