"""Time from the current step to the contact of AV and opponent."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
DEFINITION = "time from the current step to the contact of AV and opponent; hits alone"
_QUANTITY = Quantity("collision_time_s", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    return _QUANTITY.value((contact.step - rollout.now) * rollout.dt_s)
