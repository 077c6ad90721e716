"""Time that the AV's planner had between seeing the opponent and their contact."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import attention, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "neither"
DEFINITION = (
    "time from the first step at which the planner followed the opponent (see "
    "planner_saw_opponent) to their contact"
)
_QUANTITY = Quantity("planner_warning_s", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    contact = rollout.first("av_opponent")
    if contact is None:
        return _QUANTITY.missing(parts.NO_COLLISION)
    seen = attention.steps_with_opponent(rollout)
    if seen is None:
        return _QUANTITY.missing(attention.BLIND)
    if not len(seen):
        return _QUANTITY.missing("the planner never followed the opponent")
    return _QUANTITY.value((contact.step - seen[0]) * rollout.dt_s)
