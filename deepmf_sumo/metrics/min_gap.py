"""Least distance of the boxes of AV and opponent after the current step."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import series
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m"
BETTER: Better = "lower"
DEFINITION = "least distance of the boxes of AV and opponent over the simulated steps; 0 in contact"
_QUANTITY = Quantity("min_gap", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = series.over_time(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found.gap_m.min())
