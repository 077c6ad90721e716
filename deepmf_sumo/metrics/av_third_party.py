"""Contacts of the AV with others than the opponent."""

from deepmf_sumo.datatypes import Case, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "neither"
DEFINITION = "number of contacts of the AV with others than the opponent"
_QUANTITY = Quantity("av_third_party", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    hits = [contact for contact in rollout.contacts if contact.kind == "av_other"]
    return _QUANTITY.value(len(hits))
