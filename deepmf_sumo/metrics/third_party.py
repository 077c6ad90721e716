"""Contacts of the opponent with others than the AV."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode import parts
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "lower"
DEFINITION = "number of contacts of the opponent with others than the AV"
_QUANTITY = Quantity("third_party", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    row = parts.opponent_row(rollout)
    if row is None:
        return _QUANTITY.missing(parts.NO_OPPONENT)
    hits = [contact for contact in rollout.contacts if contact.kind == "opponent_other"]
    return _QUANTITY.value(len(hits))
