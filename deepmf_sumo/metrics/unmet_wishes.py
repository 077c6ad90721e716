"""Share of the plans in which no candidate met what the user wished (sector, fair, lawful)."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "lower"
DEFINITION = (
    "share of the plans in which no candidate hits the wanted sector, or none that meets the AV is "
    "fair, or lawful"
)
_QUANTITY = Quantity("unmet_wishes", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    reasons = [plan.reason for plan in rollout.plans if plan.reason is not None]
    wished = [
        reason
        for reason in reasons
        if any(wish is not None for wish in (reason.wanted_sector, reason.fair, reason.lawful))
    ]
    if not wished:
        return _QUANTITY.missing("nothing was wished of the attack, or nothing was planned")
    return _QUANTITY.value(sum(bool(reason.unmet) for reason in wished) / len(wished))
