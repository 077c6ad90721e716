"""KL divergence of the opponent's accelerations from its recording's, as published.

The noise of recordings alone gives about 1: compare adversaries, not absolute values.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import accelerations, distributions
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "nat"
BETTER: Better = "lower"
DEFINITION = (
    "signed change of the opponent's speed over the planned 8 s, as far as it is recorded, raw 10 "
    "Hz differences, against its recording's: KL(planned || recorded), 21 bins of 1 m/s2 on "
    "[-10.5, 10.5], values outside in the end bins, 1e-10 added to each count"
)
_QUANTITY = Quantity("acceleration_kl", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = accelerations.compared(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(distributions.divergence(found.attack, found.recorded))
