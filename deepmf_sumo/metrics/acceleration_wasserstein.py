"""Wasserstein distance of the opponent's accelerations to its recording's, as published."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import accelerations, distributions
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "lower"
DEFINITION = (
    "signed change of the opponent's speed over the planned 8 s, as far as it is recorded, raw 10 "
    "Hz differences, against its recording's: first Wasserstein distance of the two samples"
)
_QUANTITY = Quantity("acceleration_wasserstein", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = accelerations.compared(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(distributions.wasserstein(found.attack, found.recorded))
