"""Perplexity of P(OV), mean over plans: how many candidates are about equally likely."""

import numpy as np

from deepmf_sumo.datatypes import Case, Floats, MetricValue, Rollout
from deepmf_sumo.metrics.episode.quantity import Better, Quantity

UNIT = "1"
BETTER: Better = "neither"
DEFINITION = (
    "exponential of the entropy of P(OV) over the candidates, mean over plans: how many are about "
    "equally likely"
)
_QUANTITY = Quantity("candidate_perplexity", UNIT, BETTER)


def measure(rollout: Rollout, case: Case) -> MetricValue:
    """The metric of one rollout."""
    reasons = [plan.reason for plan in rollout.plans if plan.reason is not None]
    if not reasons:
        return _QUANTITY.missing("the policy does not say what it chose from")
    every = [_perplexity(reason.candidates.probability) for reason in reasons]
    return _QUANTITY.value(sum(every) / len(every))


def _perplexity(probability: Floats) -> float:
    """Exponential of the entropy of probabilities (N1)."""
    some = probability[probability > 0]
    return float(np.exp(-(some * np.log(some)).sum()))
