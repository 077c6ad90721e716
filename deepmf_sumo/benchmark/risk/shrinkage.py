"""Rates of many places, each drawn towards the network's rate as far as its data are thin.

One contact of one attack is a rate of 100 %, and says next to nothing. As in the screening of road
networks for accidents (Hauer, "Observational Before-After Studies in Road Safety", 1997), the rates
of all places are taken as drawn from one Beta distribution. Its mean is the network's rate. Its
strength, how many attacks it is worth, is not known: each of `STRENGTHS` counts as much as the
counts of all places are likely under it. Given its own counts, too, a place's rate is Beta
distributed for each strength.
"""

from collections.abc import Callable, Sequence
from math import exp, lgamma, log, log1p
from typing import Final, NamedTuple

STRENGTHS: Final = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
CONFIDENCE: Final = 0.9
_TINY: Final = 1e-300
_TERMS: Final = 500
_HALVINGS: Final = 30
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
    events, attacks = (sum(column) for column in zip(*counts, strict=True)) if counts else (0, 0)
    mean = (events + 0.5) / (attacks + 1.0)  # half an event: no rate is surely 0 or 1
    likelihoods = [
        sum(_log_chance(*one, mean * strength, (1 - mean) * strength) for one in counts)
        for strength in STRENGTHS
    ]
    weights = [exp(one - max(likelihoods)) for one in likelihoods]
    return Prior(mean, tuple(one / sum(weights) for one in weights))


def shrink(events: int, attacks: int, given: Prior) -> Shrunk:
    """A place's rate given its counts, and those of all places."""
    parts = [
        (chance, given.mean * worth + events, (1 - given.mean) * worth + attacks - events)
        for chance, worth in zip(given.chances, STRENGTHS, strict=True)
        if chance > _RARE
    ]
    rate = sum(chance * a / (a + b) for chance, a, b in parts) / sum(one[0] for one in parts)
    tail = (1 - CONFIDENCE) / 2
    return Shrunk(rate, _quantile(tail, parts), _quantile(1 - tail, parts))


def _log_chance(events: int, attacks: int, a: float, b: float) -> float:
    """Of counts, if the rate is Beta(a, b) distributed; without the number of orders."""
    return _log_beta(a + events, b + attacks - events) - _log_beta(a, b)


def _log_beta(a: float, b: float) -> float:
    return lgamma(a) + lgamma(b) - lgamma(a + b)


def _quantile(chance: float, parts: Sequence[tuple[float, float, float]]) -> float:
    """The rate that is not exceeded with this chance, by halving; parts are (weight, a, b)."""
    wanted = chance * sum(weight for weight, _, _ in parts)
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if sum(weight * not_exceeded(middle, a, b) for weight, a, b in parts) < wanted:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def not_exceeded(rate: float, a: float, b: float) -> float:
    """Chance that a Beta(a, b) distributed rate is not above ``rate``, in (0, 1)."""
    if rate > (a + 1) / (a + b + 2):  # the fraction converges fast below the mean only
        return 1 - not_exceeded(1 - rate, b, a)
    front = exp(a * log(rate) + b * log1p(-rate) - _log_beta(a, b)) / a
    return front / _fraction(lambda number: _coefficient(number, rate, a, b))


def _coefficient(number: int, rate: float, a: float, b: float) -> float:
    """Of the incomplete beta function's continued fraction (DLMF 8.17.22)."""
    half, odd = divmod(number, 2)
    if odd:
        return -(a + half) * (a + b + half) * rate / ((a + 2 * half) * (a + 2 * half + 1))
    return half * (b - half) * rate / ((a + 2 * half - 1) * (a + 2 * half))


def _fraction(coefficient: Callable[[int], float]) -> float:
    """1 + d1 / (1 + d2 / (1 + ...)), from the left (Lentz)."""
    value, above, below = 1.0, 1.0, 0.0
    for number in range(1, _TERMS):
        term = coefficient(number)
        below = 1 / (1 + term * below or _TINY)
        above = 1 + term / above or _TINY
        value *= above * below
        if abs(above * below - 1) < 1e-12:
            break
    return value
