"""Whether the contact could have been avoided at all (grade B, C or D): 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "of contacts: 1 if one of the manoeuvres or of the reference drivers avoids the same "
    "opponent trajectory, else 0"
)
_QUANTITY = Quantity("avoidable_physically", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = judgement(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found.physically)
