"""How sure results are: intervals of rates, of means and differences, of places; what they decide.

All intervals say something about other situations of the same kind, so a *unit* is a situation: a
spec, a moment of a network's traffic, a recorded scene. Runs of a unit with other seeds repeat the
situation: they make its value more exact, and count as one unit.

Rates, means and differences have intervals of one method, which assumes no distribution (Gaffke,
Mathematical Methods of Statistics 14, 2005; Learned-Miller and Thomas, arXiv:1905.06208, 2019).
The values of n units, and the greatest that another unit may have, get random shares that add up
to 1; the upper end is a quantile of the mean with these shares, and the lower end has the least
value in place of the greatest. This is the Bayesian bootstrap (Rubin, Annals of Statistics 9, 1981)
with one unit more. Known methods are cases of it:

- for a rate, it is the exact interval (Clopper and Pearson, Biometrika 26, 1934), and after n units
  without an event the upper end is near 3 / n (the rule of three);
- for a difference of paired rates, it excludes 0 if McNemar's exact test does.

So n equal values do not give an interval of width 0: about 3 / n of the other units may have
another value. How far it may be off is known for rates, and said for quantities
(`quantities.Quantity.largest`). The distribution of the mean is computed, not drawn: equal values
give equal intervals.

Places of a network borrow from each other. A place's own few attacks and all places together say
how often attacks hit there and how critical they are (Beta-binomial). Neither the mean of all
places nor how much they differ is known: both are integrated over.
"""

import math
import operator
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import cache, lru_cache
from statistics import fmean
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import Floats

CONFIDENCE: Final = 0.95
_MOST_VALUES: Final = 200
"""More different values than these are averaged in groups of neighbours."""
_STEP: Final = 0.125
_SINH, _COSH = (of(np.arange(0.0, 13.0, _STEP)) for of in (np.sinh, np.cosh))
_COSH[0] /= 2  # the trapezoidal rule


class Interval(NamedTuple):
    """A rate and its two-sided confidence interval."""

    rate: float
    low: float
    high: float


class Difference(NamedTuple):
    """A mean, or new minus old, with a two-sided interval.

    Both ends are None if all units are equal and it is not known how far another unit may be off.
    """

    mean: float
    low: float | None
    high: float | None


class Units(NamedTuple):
    """Values of units, each with its weight; the weights add up to the number of equal units."""

    values: tuple[float, ...]
    weights: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Of all runs."""
        return float(np.dot(self.values, self.weights) / sum(self.weights))

    @property
    def other_way(self) -> "Units":
        """Old minus new of differences."""
        return Units(tuple(-value for value in self.values), self.weights)

    def as_many(self, units: float) -> "Units":
        """The same values in a sample of another size."""
        factor = units / len(self.values)
        return Units(self.values, tuple(factor * weight for weight in self.weights))


def units_of(groups: Iterable[Sequence[float]]) -> Units:
    """Mean and weight of each unit, from the values of its runs.

    The mean is that of all runs. If the runs of a unit agree, k units of m_1 ... m_k runs are worth
    (sum of m)^2 / (sum of m^2) units of equal numbers (Kish, "Survey sampling", 1965).
    """
    runs = [group for group in groups if len(group)]
    counts = np.array([len(group) for group in runs], dtype=float)
    weights = counts * counts.sum() / (counts @ counts) if runs else counts
    return Units(tuple(fmean(group) for group in runs), tuple(weights.tolist()))


def by_unit(values: Iterable[tuple[Hashable, float]]) -> list[list[float]]:
    """Values of runs, grouped by what they are runs of."""
    groups: dict[Hashable, list[float]] = defaultdict(list)
    for unit, value in values:
        groups[unit].append(value)
    return list(groups.values())


def weighted(values: Iterable[tuple[Hashable, float, float]]) -> Units:
    """`units_of` of runs that count differently: of each its unit, its value and what it counts.

    The mean is a ratio of estimates (Hajek, "Foundations of Statistical Inference", 1971).
    """
    groups: dict[Hashable, list[tuple[float, float]]] = defaultdict(list)
    for unit, value, counts in values:
        groups[unit].append((value, counts))
    sums = [math.fsum(counts for _, counts in group) for group in groups.values()]
    totals = np.array(sums)
    weights = totals * totals.sum() / (totals @ totals) if groups else totals
    means = (
        math.fsum(value * counts for value, counts in group) / total
        for group, total in zip(groups.values(), sums, strict=True)
    )
    return Units(tuple(means), tuple(weights.tolist()))


def drawn(chances: Sequence[float], population: int) -> list[float]:
    """How many of a population each unit stands for that was drawn from it, in their order.

    Args:
        chances: of each, that it was drawn then, of the units that were left. The first ones may
            have been taken with certainty.
        population: number of its units.

    Each draw gives an estimate of the population's sum: the values drawn before, and its own over
    its chance (Des Raj, Journal of the American Statistical Association 51, 1956). It is unbiased
    whatever the chances depend on, also on the values before, and so is each mean of the draws with
    given weights. Here are what the values count for in the one that gives equal weights, the
    inverse probabilities of Horvitz and Thompson, where chances are equal (Farquhar, Gal and
    Rainforth, "On statistical bias in active learning", ICLR 2021).
    """
    surely = next((at for at, chance in enumerate(chances) if chance < 1.0), len(chances))
    units, draws = population - surely, len(chances) - surely
    weights = [1.0] * surely
    for number, chance in enumerate(chances[surely:], 1):
        left = units - number
        unequal = 1.0 / ((left + 1) * chance) - 1.0
        weights.append(units / draws * (1.0 + (units - draws) / max(left, 1) * unequal))
    return weights


def rate(groups: Iterable[Sequence[float]], confidence: float = CONFIDENCE) -> Interval:
    """The share of ones, from the zeros and ones of each unit's runs.

    Raises ValueError for no runs, or values beyond 0 and 1.
    """
    return rate_of(units_of(groups), confidence)


def rate_of(units: Units, confidence: float = CONFIDENCE) -> Interval:
    """`rate` of units. Raises ValueError for none, or values beyond 0 and 1."""
    if not units.values or not 0 <= min(units.values) <= max(units.values) <= 1:
        raise ValueError(f"{units.values} are no zeros and ones")
    return Interval(units.mean, *_ends(units, (0.0, 1.0), confidence))


def mean(groups: Iterable[Sequence[float]], confidence: float = CONFIDENCE) -> Difference:
    """The mean of values with no known limits: another unit may be off by their range, both ways.

    Raises ValueError for no runs.
    """
    units = units_of(groups)
    span = max(units.values) - min(units.values)
    if not span:
        return Difference(units.mean, None, None)
    reach = (min(units.values) - span, max(units.values) + span)
    return Difference(units.mean, *_ends(units, reach, confidence))


def paired(
    groups: Iterable[Sequence[float]], confidence: float, largest: float | None = None
) -> Difference:
    """The mean difference within pairs.

    Args:
        groups: the differences of each unit's pairs.
        confidence: two-sided.
        largest: difference that another unit may have, or the largest seen if that is more; without
            it, twice the largest seen.
    """
    return of_pairs(units_of(groups), confidence, largest)


def of_pairs(units: Units, confidence: float, largest: float | None) -> Difference:
    """`paired` of units."""
    reach = _reach(units, largest)
    if not reach:
        return Difference(units.mean, None, None)
    return Difference(units.mean, *_ends(units, (-reach, reach), confidence))


def below(units: Units, confidence: float, largest: float | None, bound: float) -> bool:
    """Whether the interval of `of_pairs` ends below a bound, without computing where it ends."""
    reach = _reach(units, largest)
    values, weights = _merged(units)
    chance = _below(np.append(values, reach) - bound, np.append(weights, 1.0))
    return bool(reach) and chance > (1 + confidence) / 2


def _reach(units: Units, largest: float | None) -> float:
    """The largest difference that another unit may have, either way."""
    seen = max(map(abs, units.values))
    return 2 * seen if largest is None else max(largest, seen)


def unpaired(new: Units, old: Units, confidence: float, largest: float | None = None) -> Difference:
    """The difference of the means of two sets of units.

    The distances of their ends are added as squares (Newcombe, Statistics in Medicine 17, 1998; Zou
    and Donner, Statistics in Medicine 27, 2008).

    Args:
        new: of the new side.
        old: of the old side.
        confidence: two-sided.
        largest: value that another unit may have; without it, units may be off by their range.
    """
    low, high = min(*new.values, *old.values), max(*new.values, *old.values)
    if largest is None:
        reach = (low - (high - low), high + (high - low))
    else:
        reach = (min(low, 0.0), largest if high <= largest else max(high, low + largest))
    shift = new.mean - old.mean
    if reach[0] == reach[1]:
        return Difference(shift, None, None)
    ours, theirs = _ends(new, reach, confidence), _ends(old, reach, confidence)
    down = math.hypot(new.mean - ours[0], theirs[1] - old.mean)
    up = math.hypot(ours[1] - new.mean, old.mean - theirs[0])
    return Difference(shift, shift - down, shift + up)


def fewest(confidence: float) -> int:
    """Pairs that can show a difference: equal ones of n have its opposite with 1 in 2^n."""
    return math.ceil(math.log2(2 / (1 - confidence)) - 1e-9)


def fewest_unpaired(confidence: float) -> int:
    """Units, half of them on each side, that can show a difference, see `unpaired`."""
    return 2 * math.ceil(math.log((1 - confidence) / 2) / math.log(1 - math.sqrt(0.5)) - 1e-9)


def by_chance(more: int, fewer: int) -> float:
    """Probability of at least ``more`` heads in ``more + fewer`` tosses (sign test)."""
    tosses = more + fewer
    return sum(math.comb(tosses, heads) for heads in range(more, tosses + 1)) / 2**tosses


def _ends(units: Units, reach: tuple[float, float], confidence: float) -> tuple[float, float]:
    """Both ends, with the least and the greatest value that another unit may have."""
    tail = (1 - confidence) / 2
    values, weights = _merged(units)
    low = -_quantile(np.append(-values, -reach[0]), np.append(weights, 1.0), 1 - tail)
    high = _quantile(np.append(values, reach[1]), np.append(weights, 1.0), 1 - tail)
    return min(low, units.mean), max(high, units.mean)  # of equal values but for the last bit


def _merged(units: Units) -> tuple[Floats, Floats]:
    """Different values with their weights, and of very many the means of neighbours."""
    values, where = np.unique(units.values, return_inverse=True)
    weights: Floats = np.bincount(where, weights=units.weights).astype(float)
    if len(values) <= _MOST_VALUES:
        return values, weights
    group = np.arange(len(values)) * _MOST_VALUES // len(values)
    total: Floats = np.bincount(group, weights=weights).astype(float)
    return np.bincount(group, weights=weights * values) / total, total


def _quantile(values: Floats, weights: Floats, level: float) -> float:
    """Of the mean of values with Dirichlet shares; (K,) values and parameters of the shares."""
    low, high = float(values.min()), float(values.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        return high

    from scipy.optimize import brentq  # 0.4 s that a live session does not need

    def excess(at: float) -> float:
        return _below(values - at, weights) - level

    return float(brentq(excess, low, high, xtol=1e-9 * (high - low)))


def _below(values: Floats, weights: Floats) -> float:
    """Probability that the sum of independent Gamma(weight) variables times values is negative."""
    if values.max() <= 0:
        return 1.0
    if values.min() >= 0:
        return 0.0
    if values @ weights <= 0:
        return 1.0 - _positive(values, weights)
    return _positive(-values, weights)


def _positive(values: Floats, weights: Floats) -> float:
    """Probability that the sum is positive, whose mean is not."""
    at = _saddle(values, weights)
    shrunk = 1.0 - at * values
    curvature = weights @ (values / shrunk) ** 2 + at**-2
    away = _SINH / math.sqrt(curvature)
    ratio = np.outer(values / shrunk, away)
    size = np.exp(-(weights @ np.log(shrunk)) - 0.5 * (weights @ np.log1p(ratio**2)))
    turn = weights @ np.arctan(ratio)
    real = (np.cos(turn) * at + np.sin(turn) * away) / (at**2 + away**2)
    return float((size * real) @ _COSH) * _STEP / (math.pi * math.sqrt(curvature))


def _saddle(values: Floats, weights: Floats) -> float:
    """Where the integrand is least along the real axis, between 0 and the pole: Newton's method."""
    low, high = 0.0, 1.0 / float(values.max())
    at = high / 2
    for _ in range(60):
        terms = values / (1.0 - at * values)
        slope = float(weights @ terms) - 1.0 / at
        low, high = (low, at) if slope > 0 else (at, high)
        new = at - slope / float(weights @ terms**2 + at**-2)
        new = new if low < new < high else (low + high) / 2
        if abs(new - at) < 1e-6 * at:
            return new
        at = new
    return at


PLACE_CONFIDENCE: Final = 0.9
_BIAS: Final = 0.05
"""The mean has the prior Beta(0.05, 1) for the lower end and Beta(1, 0.05) for the upper one: the
exact interval of one rate is of two Beta distributions, too."""
_LIKELY: Final = 1e-3


def place_rates(places: Mapping[str, Units]) -> dict[str, Interval]:
    """Of places, from the zeros and ones of their attacks: the rate to expect, 90 % interval.

    The rates of places are taken as drawn from one Beta distribution (Hauer, "Observational
    Before-After Studies in Road Safety", 1997), of which nothing is known but the counts. A place
    alone has nothing to borrow from: its interval is exact.
    """
    counts = {
        place: (round(sum(units.weights) * units.mean, 9), round(sum(units.weights), 9))
        for place, units in places.items()
    }
    if len(places) == 1:
        [(place, units)] = places.items()
        exact = _ends(units, (0.0, 1.0), PLACE_CONFIDENCE)
        expected = _place_rates(tuple(counts.values()))[0][counts[place]].rate
        return {place: Interval(expected, *exact)}
    known, _ = _place_rates(tuple(sorted(counts.values())))
    return {place: known[count] for place, count in counts.items()}


@cache
def _nodes() -> tuple[Floats, Floats]:
    """Means and strengths (J,) of Beta distributions of rates.

    A strength is a number of attacks; weak ones are likelier.
    """
    from scipy.special import expit

    means = expit(np.linspace(-7.0, 7.0, 43))
    mean, strength = np.meshgrid(means, np.geomspace(1.0, 64.0, 9))
    return mean.ravel(), strength.ravel()


@lru_cache(maxsize=64)
def _place_rates(
    counts: tuple[tuple[float, float], ...], confidence: float = PLACE_CONFIDENCE
) -> tuple[dict[tuple[float, float], Interval], float]:
    """The interval of each (events, attacks) among those of all places; the mean of all rates."""
    if not counts:
        return {}, 0.0
    from scipy.special import betaln

    mean, strength = _nodes()
    different, number = np.unique(np.array(counts), axis=0, return_counts=True)
    events, misses = different[:, :1], different[:, 1:] - different[:, :1]
    a, b = mean * strength, (1 - mean) * strength
    log_likelihood = number @ (betaln(a + events, b + misses) - betaln(a, b))
    log_likelihood -= 0.5 * np.log(strength)

    def posterior(of_low: float, of_high: float) -> Floats:
        logs = log_likelihood + of_high * np.log(mean) + of_low * np.log1p(-mean)
        weights = np.exp(logs - logs.max())
        return np.where(weights > _LIKELY, weights, 0.0)

    tail = (1 - confidence) / 2
    middle = posterior(0.5, 0.5)
    rates = (a + events) / (a + b + events + misses) @ (middle / middle.sum())
    low = _mixture_quantile(a, b, events, misses, posterior(1.0, _BIAS), tail)
    high = _mixture_quantile(a, b, events, misses, posterior(_BIAS, 1.0), 1 - tail)
    low[events[:, 0] == 0], high[misses[:, 0] == 0] = 0.0, 1.0
    intervals = {
        (float(one[0]), float(one[1])): Interval(*map(float, found))
        for one, *found in zip(different, rates, low, high, strict=True)
    }
    return intervals, float(mean @ middle / middle.sum())


def _mixture_quantile(
    a: Floats, b: Floats, events: Floats, misses: Floats, weights: Floats, level: float
) -> Floats:
    """(C,) of the Beta distributions of (J,) nodes given (C, 1) counts."""
    from scipy.special import betainc

    kept = weights > 0
    share = weights[kept] / weights[kept].sum()
    own, rest = a[kept] + events, b[kept] + misses

    def below(rates: Floats) -> Floats:
        chances: Floats = betainc(own, rest, rates[:, None]) @ share
        return chances

    return _bisected(below, level, np.zeros(len(events)), np.ones(len(events)))


def _bisected(below: Callable[[Floats], Floats], level: float, low: Floats, high: Floats) -> Floats:
    """Where distribution functions reach a level, to 1e-9 of the bracket."""
    for _ in range(30):
        middle = (low + high) / 2
        under = below(middle) < level
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return high


class PlaceMean(NamedTuple):
    """A place's mean: of its attacks, and ``shrunk`` towards the others, with a 90 % interval.

    ``typical`` is the mean of the distribution that the means of its kind are drawn from.
    """

    attacks: int
    mean: float
    typical: float
    shrunk: float
    low: float
    high: float

    @property
    def excess(self) -> float:
        """By how much the place is worse than the typical one."""
        return self.shrunk - self.typical

    @property
    def surely(self) -> float:
        """By how much it is worse at least: the interval's lower end, 0 if it may be typical."""
        return max(0.0, round(self.low - self.typical, 9))

    @property
    def stands_out(self) -> bool:
        """Whether the whole interval is above the typical place."""
        return self.surely > 0


_ALIKE: Final = 8.0
"""Attacks that vary as much as is possible, added: few equal attacks do not make places certain."""
_QUASI: Final = 0.94
"""With this the intervals hold 90 %, since what attacks are worth is estimated from few."""
_MOST_WORTH: Final = 50.0


def place_means(
    places: Mapping[str, Units], kinds: Mapping[str, str] | None = None
) -> dict[str, PlaceMean]:
    """Of places, from values between 0 and 1 of their attacks; without attacks they are typical.

    Places of one kind are compared. Their means are drawn from one Beta distribution as rates are
    in `place_rates`. Attacks that vary less than zeros and ones of the same mean would are worth
    more attacks in proportion (quasi-likelihood: McCullagh and Nelder, 1989).
    """
    of_kind: dict[str, dict[str, Units]] = {}
    for place, units in places.items():
        of_kind.setdefault(kinds[place] if kinds else "", {})[place] = units
    found = {
        place: one for group in of_kind.values() for place, one in _means_of_kind(group).items()
    }
    return {place: found[place] for place in places}


def _means_of_kind(places: Mapping[str, Units]) -> dict[str, PlaceMean]:
    values = {place: units.values for place, units in places.items() if units.values}
    worth = _worth(list(values.values()))
    counts = {
        place: (
            round(worth * math.fsum(map(operator.mul, units.values, units.weights)), 9),
            round(worth * math.fsum(units.weights), 9),
        )
        for place, units in places.items()
        if units.values
    }
    known, typical = _place_rates(tuple(sorted(counts.values())), _QUASI)
    means = {}
    for place, units in places.items():
        shrunk, low, high = known[counts[place]] if place in counts else (typical, 0.0, 1.0)
        if place in counts and len(counts) == 1:
            low, high = _ends(units, (0.0, 1.0), PLACE_CONFIDENCE)
        own = units.mean if units.values else typical
        means[place] = PlaceMean(len(units.values), own, typical, shrunk, low, high)
    return means


def _worth(groups: Sequence[Sequence[float]]) -> float:
    """How many zeros and ones a value is worth, by how much values vary within groups."""
    attacks = sum(map(len, groups))
    mean = (sum(map(sum, groups)) + 0.5) / (attacks + 1.0)
    most = mean * (1 - mean)
    squares = sum(len(group) * float(np.var(group)) for group in groups)
    variance = (squares + _ALIKE * most) / (attacks - len(groups) + _ALIKE)
    return min(max(most / variance, 1.0), _MOST_WORTH)


def ranks(worse: Mapping[str, float]) -> dict[str, float]:
    """1 for the place that is worse by most; equals share the mean of their ranks.

    Of `PlaceMean.surely`: places that cannot be told from the typical one have one rank, not an
    order by chance.
    """
    number = np.round(list(worse.values()), 6)
    return {
        place: float((number > mine).sum() + ((number == mine).sum() + 1) / 2)
        for place, mine in zip(worse, number, strict=True)
    }
