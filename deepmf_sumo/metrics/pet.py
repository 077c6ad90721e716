"""Post-encroachment time of AV and opponent, from the areas that their boxes sweep.

Allen, Shin, Cooper (1978); here the least over all common places, so that following counts too.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import series
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
DEFINITION = (
    "least time between one of AV and opponent leaving a place and the other coming onto it, over "
    "all places that both boxes cover in the simulated steps; 0 in contact"
)
_QUANTITY = Quantity("pet", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = series.encroachment_s(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found)
