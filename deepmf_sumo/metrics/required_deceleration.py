"""Hardest braking that the opponent asks of the AV.

After the required longitudinal deceleration of Brannstrom et al. (2008), with boxes, in two
dimensions, without a reaction time.
"""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import series
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "higher"
DEFINITION = (
    "largest constant braking, along the heading of the AV and at once, that keeps it behind an "
    "opponent which keeps its heading and its speed or braking, over the simulated steps, up to 1 "
    "s before a contact; 0 without a collision course"
)
_QUANTITY = Quantity("required_deceleration", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = series.in_time(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    hardest = found.braking_mps2.max()
    if np.isinf(hardest):
        return _QUANTITY.missing("at some step no braking is enough: the opponent runs into the AV")
    return _QUANTITY.value(hardest)
