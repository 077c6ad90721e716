"""Whether no reference driver avoids the contact, but one has stopped before it: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "neither"
DEFINITION = (
    "of contacts: 1 if no reference driver in the place of the AV avoids the same opponent "
    "trajectory, but at least one has stopped before the opponent runs into it, else 0"
)
_QUANTITY = Quantity("avoidance_hit_standing", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = judgement(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found.hit_standing)
