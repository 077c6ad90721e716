"""Confidence interval of a rate (Wilson, JASA 22, 1927)."""

import math
from statistics import NormalDist
from typing import NamedTuple


class Interval(NamedTuple):
    """A rate and its two-sided confidence interval."""

    rate: float
    low: float
    high: float


def wilson(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Interval of a rate; stays within [0, 1] and is not empty at 0 and at all.

    Raises ValueError for no trials, or more successes than trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials is no rate")
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / trials
    share = z * z / trials
    centre = (rate + share / 2) / (1 + share)
    half = z / (1 + share) * math.sqrt(rate * (1 - rate) / trials + share / (4 * trials))
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return Interval(rate, low, high)
