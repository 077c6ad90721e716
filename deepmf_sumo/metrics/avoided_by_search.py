"""Whether any braking or steering without delay would have avoided the contact: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.judgement import judgement
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "of contacts: 1 if one of about a hundred manoeuvres (braking up to 8 m/s2 with lateral "
    "accelerations up to 6 m/s2, begun at the onset) avoids the opponent, hits nobody else "
    "and keeps to the road, else 0"
)
_QUANTITY = Quantity("avoided_by_search", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = judgement(rollout, case)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    return _QUANTITY.value(found.manoeuvres > 0)
