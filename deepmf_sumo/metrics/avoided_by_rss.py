"""Whether a driver who brakes as RSS asks for would have avoided the contact: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "of contacts: 1 if a driver who brakes as RSS asks for, in the place of the AV and on its"
    " path, avoids the same opponent trajectory, else 0"
)
_QUANTITY = Quantity("avoided_by_rss", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = judgement(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found.avoided_by["rss"])
