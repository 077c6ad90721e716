"""Least time to collision of AV and opponent, in two dimensions.

Both boxes keep velocity and heading; 0 in a rollout that ends with their contact.
"""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import conflict, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
_QUANTITY = Quantity("ttc_min", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    av, steps = parts.together(rollout, row)
    if not steps.any():
        return _QUANTITY.missing("AV and opponent were never there together")
    tracks = rollout.tracks
    seconds = conflict.time_to_collision(
        tracks.position_m[av, steps],
        tracks.heading_rad[av, steps],
        tracks.velocity_mps[av, steps],
        tracks.size_m[av, :2],
        tracks.position_m[row, steps],
        tracks.heading_rad[row, steps],
        tracks.velocity_mps[row, steps],
        tracks.size_m[row, :2],
    )
    if np.isinf(seconds).all():
        return _QUANTITY.missing("AV and opponent were never on a collision course")
    return _QUANTITY.value(seconds.min())
