"""Rates of many places, each drawn towards the network's rate as far as its data are thin.

One contact of one attack is a rate of 100 %, and says next to nothing. As in the screening of road
networks for accidents (Hauer, "Observational Before-After Studies in Road Safety", 1997), the rates
of all places are taken as drawn from one Beta distribution. Its mean is the network's rate. Its
strength, how many attacks it is worth, is not known: each of `STRENGTHS` counts as much as the
counts of all places are likely under it. Given its own counts, too, a place's rate is Beta
distributed for each strength.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import betainc, betaln, softmax

STRENGTHS: Final = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
CONFIDENCE: Final = 0.9
_STRENGTHS: Final = np.array(STRENGTHS)
_RARE: Final = 1e-3
"""Strengths less likely than this are left out."""


class Prior(NamedTuple):
    """Beta distributions of rates by their mean, and how likely each of `STRENGTHS` is."""

    mean: float
    chances: tuple[float, ...]


class Shrunk(NamedTuple):
    """A place's rate: its expectation, and the ends of the 90 % interval."""

    rate: float
    low: float
    high: float


def prior(counts: Sequence[tuple[int, int]]) -> Prior:
    """The distribution that counts (events, attacks) of places come from."""
    events, attacks = np.array(counts, dtype=float).reshape(-1, 2).T
    mean = float((events.sum() + 0.5) / (attacks.sum() + 1.0))  # half an event: never 0 or 1
    a, b = mean * _STRENGTHS[:, None], (1 - mean) * _STRENGTHS[:, None]
    likelihoods = (betaln(a + events, b + attacks - events) - betaln(a, b)).sum(axis=1)
    return Prior(mean, tuple(softmax(likelihoods).tolist()))


def shrink(events: int, attacks: int, given: Prior) -> Shrunk:
    """A place's rate given its counts, and those of all places."""
    chances = np.array(given.chances)
    kept = chances > _RARE
    a = given.mean * _STRENGTHS[kept] + events
    b = (1 - given.mean) * _STRENGTHS[kept] + attacks - events
    weights = chances[kept] / chances[kept].sum()

    def quantile(chance: float) -> float:
        found = brentq(lambda rate: weights @ betainc(a, b, rate) - chance, 0.0, 1.0, xtol=1e-10)
        return float(found)

    tail = (1 - CONFIDENCE) / 2
    return Shrunk(float(weights @ (a / (a + b))), quantile(tail), quantile(1 - tail))
