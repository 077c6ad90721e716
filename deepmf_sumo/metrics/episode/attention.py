"""What the AV's planner followed."""

import numpy as np

from deepmf_sumo.datatypes import Ints, Rollout

BLIND = "the planner does not look at anybody, or does not say at whom"


def steps_with_opponent(rollout: Rollout) -> Ints | None:
    """Steps, before a contact, at which the planner followed the opponent; None if it never looks.

    What it followed is what it, or SUMO's model for it, chose the next step by.
    """
    if all(one is None for one in rollout.leaders):
        return None
    seen = [rollout.opponent_id in (one or ()) for one in rollout.leaders]
    return np.flatnonzero(seen) + rollout.now
