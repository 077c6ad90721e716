"""Wasserstein distance of the opponent's filtered accelerations to its recording's."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import accelerations, distributions
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s2"
BETTER: Better = "lower"
DEFINITION = (
    "signed change of the opponent's speed over the planned 8 s, as far as it is recorded, "
    "Savitzky-Golay filtered (11 samples, order 2) on both sides, against its recording's: first "
    "Wasserstein distance of the two samples"
)
_QUANTITY = Quantity("acceleration_wasserstein_smooth", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = accelerations.compared(rollout, case, smooth=True)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(distributions.wasserstein(found.attack, found.recorded))
