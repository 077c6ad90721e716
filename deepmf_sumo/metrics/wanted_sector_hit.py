"""Whether the opponent hit the AV where the user wanted it: 1 or 0."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "higher"
DEFINITION = "1 if the opponent hit the AV in the wanted sector, else 0 (no hit, another sector)"
_QUANTITY = Quantity("wanted_sector_hit", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    reasons = [plan.reason for plan in rollout.plans if plan.reason is not None]
    wanted = {reason.wanted_sector for reason in reasons} - {None}
    if len(wanted) != 1:
        return _QUANTITY.missing("no sector was wanted, or nothing was planned")
    contact = rollout.first("av_opponent")
    return _QUANTITY.value(float(contact is not None and contact.sector in wanted))
