"""How close attacks brought the AV to a contact: the criticality of places, and rates of places.

A rate of hits needs many attacks, since most are not hits; the time to spare says something about
each. Means of few attacks are shrunk towards the typical place: the variation of attacks around
their place, and of places around the typical one, is taken as normal and estimated from all places
together (Efron and Morris, J. Am. Stat. Assoc. 70, 1975; for the
screening of roads: Highway Safety Manual, AASHTO 2010, chapter 4).

Rates of few attacks are shrunk towards the network's rate.

One hit in one attack is a rate of 100 %, and says very little. As in the screening of road
networks for accidents (Hauer, "Observational Before-After Studies in Road Safety", 1997), the rates
of all places are taken as drawn from one Beta distribution. Its mean is the network's rate. Its
strength, as a number of attacks, is not known: each of `STRENGTHS` is weighted by how likely the
counts of all places are under it. Given its own counts, too, a place's rate is Beta
distributed for each strength.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import sqrt
from statistics import fmean, median
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import betainc, betaln, softmax

_BOUND: Final = 1.645
"""Of a 90 % interval, in standard deviations."""
_BORROWED: Final = 4
_UNKNOWN: Final = 0.25**2
"""Variance of one more attack that is added: a few equal attacks do not make a place certain."""


class Drawn(NamedTuple):
    """A place's mean: of its attacks, and shrunk towards ``typical``, with a 90 % interval."""

    attacks: int
    mean: float
    typical: float
    drawn: float
    low: float
    high: float

    @property
    def excess(self) -> float:
        """By how much the place is worse than the typical one."""
        return self.drawn - self.typical

    @property
    def surely(self) -> float:
        """By how much it is worse at least: the interval's lower end, 0 if it may be typical."""
        return max(0.0, round(self.low - self.typical, 9))

    @property
    def stands_out(self) -> bool:
        """Whether the whole interval is above the typical place."""
        return self.surely > 0


def drawn(
    groups: Mapping[str, Sequence[float]], kinds: Mapping[str, str] | None = None
) -> dict[str, Drawn]:
    """Of places, each with the values of its attacks.

    Typical is the median of the places, or with ``kinds`` of those of the same kind. A place's own
    attacks and `_BORROWED` usual ones say how much attacks vary there.
    """
    means = {place: fmean(values) for place, values in groups.items() if values}
    typical = _typical(groups, means, kinds or dict.fromkeys(groups, ""))
    squares = {
        place: sum((value - means[place]) ** 2 for value in values)
        for place, values in groups.items()
    }
    spare = sum(len(groups[place]) - 1 for place in means)
    usual = (sum(squares.values()) + _UNKNOWN) / (spare + 1)
    noise = {
        place: (squares[place] + _BORROWED * usual)
        / (max(len(values) - 1, 0) + _BORROWED)
        / max(len(values), 1)
        for place, values in groups.items()
    }
    excess = [(mean - typical[place]) ** 2 - noise[place] for place, mean in means.items()]
    between = max(0.0, fmean(excess)) if excess else 0.0
    return {
        place: _drawn(
            means.get(place, typical[place]), typical[place], len(values), noise[place], between
        )
        for place, values in groups.items()
    }


def ranks(worse: Mapping[str, float]) -> dict[str, float]:
    """1 for the place that is worse by most; equals share the mean of their ranks.

    Of `Drawn.surely`: places that cannot be told from the typical one have one rank, not an order
    by chance.
    """
    number = np.round(list(worse.values()), 6)
    return {
        place: float((number > mine).sum() + ((number == mine).sum() + 1) / 2)
        for place, mine in zip(worse, number, strict=True)
    }


def _typical(
    places: Iterable[str], means: Mapping[str, float], kinds: Mapping[str, str]
) -> dict[str, float]:
    """Of each place's kind: the median of the means, 0 where there is none."""
    of_kind: dict[str, list[float]] = {}
    for place, mean in means.items():
        of_kind.setdefault(kinds[place], []).append(mean)
    return {place: median(of_kind.get(kinds[place]) or [0.0]) for place in places}


def _drawn(mean: float, typical: float, attacks: int, noise: float, between: float) -> Drawn:
    share = between / (between + noise) if attacks else 0.0
    middle = typical + share * (mean - typical)
    half = _BOUND * sqrt((1.0 - share) * between)
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return Drawn(attacks, mean, typical, middle, low, high)


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
