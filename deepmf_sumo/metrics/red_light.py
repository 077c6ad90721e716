"""Whether the opponent drives over a stop line at red: 1 or 0.

A turn on red after a stop, which some countries allow, counts too: maps do not say where it is.
"""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import lights, parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "lower"
DEFINITION = (
    "1 where, while the policy drives the opponent, the middle of its front bumper crosses stop "
    "lines of lanes in their direction (within 60 degrees and half a width) that all are red, "
    "else 0"
)
_QUANTITY = Quantity("red_light", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    found = parts.driving(rollout)
    if isinstance(found, str):
        return _QUANTITY.missing(found)
    row, steps = found
    if not rollout.signals:
        return _QUANTITY.missing("the rollout does not hold the states of the lights")
    return _QUANTITY.value(lights.passed_on_red(rollout, case, row, steps))
