"""Time to the contact of AV and opponent, the whole episode where there is none.

A method that only manages early hits looks no better by it: nobody is left out of the mean.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "s"
BETTER: Better = "lower"
DEFINITION = (
    "time from the current step to the contact of AV and opponent; the duration of the case where "
    "they do not collide"
)
_QUANTITY = Quantity("collision_time_restricted_s", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    if parts.opponent_row(rollout) is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    contact = rollout.first("av_opponent")
    steps = case.duration_steps if contact is None else contact.step - rollout.now
    return _QUANTITY.value(steps * rollout.dt_s)
