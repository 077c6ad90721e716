"""Share of the plans in which some pair of candidate and reaction collides."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = "share of the plans in which some pair of candidate and reaction collides"
_QUANTITY = Quantity("colliding_plans", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    reasons = [plan.reason for plan in rollout.plans if plan.reason is not None]
    if not reasons:
        return _QUANTITY.missing("the policy does not say what it chose from")
    return _QUANTITY.value(sum(bool(reason.collides.any()) for reason in reasons) / len(reasons))
