"""Least time to collision of AV and opponent, in two dimensions."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import series
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
DEFINITION = (
    "least time over the simulated steps until the boxes of AV and opponent touch if both keep "
    "velocity and heading; 0 in contact"
)
_QUANTITY = Quantity("ttc_min", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = series.over_time(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    if np.isinf(found.ttc_s).all():
        return _QUANTITY.missing("AV and opponent were never on a collision course")
    return _QUANTITY.value(found.ttc_s.min())
