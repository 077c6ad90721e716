"""Largest deceleration rate to avoid the crash (DRAC) of AV and opponent."""

import numpy as np

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import series
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "higher"
DEFINITION = (
    "largest relative speed over twice the time to collision (same direction: speed difference "
    "squared over twice the gap), over the simulated steps, up to 1 s before a contact; 0 without "
    "a collision course"
)
_QUANTITY = Quantity("drac_max", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = series.in_time(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    if np.isinf(found.drac_mps2).any():
        return _QUANTITY.missing("AV and opponent overlapped without a contact that counts")
    return _QUANTITY.value(found.drac_mps2.max())
