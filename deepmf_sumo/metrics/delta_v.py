"""Change of the AV's velocity in a plastic impact with the opponent."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s"
BETTER: Better = "higher"
DEFINITION = (
    "change of the AV's velocity in a plastic impact with the opponent, masses proportional to "
    "the areas of the boxes"
)
_QUANTITY = Quantity("delta_v", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    return _QUANTITY.value(contact.delta_v_mps)
