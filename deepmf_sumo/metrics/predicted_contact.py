"""How likely the first plan meets the AV, by what the policy predicted."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = (
    "predicted chance that the first plan meets the AV: mass of the AV's reactions that the chosen"
    " candidate collides with; its mean over runs is to be compared with the rate of hits"
)
_QUANTITY = Quantity("predicted_contact", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    first = next((plan.reason for plan in rollout.plans if plan.reason is not None), None)
    if first is None:
        return _QUANTITY.missing("the policy does not say what it chose from")
    mass = first.reactions[first.chosen].probability[first.collides[first.chosen]].sum()
    return _QUANTITY.value(float(mass))
