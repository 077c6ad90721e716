"""Relative speed of AV and opponent at the last step before their contact."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "m/s"
BETTER: Better = "higher"
DEFINITION = (
    "length of the difference of the velocities of AV and opponent at the last step before their "
    "contact"
)
_QUANTITY = Quantity("collision_speed", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    return _QUANTITY.value(contact.relative_mps)
