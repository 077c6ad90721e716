"""Whether the AV is at fault in its contact with the opponent, as in nuPlan's classes: 1 or 0."""

from deepmf_sumo.avoidance import fault
from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "of contacts: 1 if the AV hits something that stands or hits with its front, or touches "
    "sideways while not within one lane; 0 if it stands itself, is hit from behind, or keeps its "
    "lane (nuPlan's at-fault collisions)"
)
_QUANTITY = Quantity("av_at_fault", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    if parts.opponent_row(rollout) is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    found = fault.av_at_fault(rollout, case)
    return _QUANTITY.missing(parts.NO_COLLISION) if found is None else _QUANTITY.value(found)
