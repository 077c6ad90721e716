"""How often intervals contain the truth: ``python -m tests.support.coverage`` prints the tables.

Where a sample is counts, all samples are taken with their probability; else samples are drawn.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import product

import numpy as np
from scipy.stats import beta, binom, multinomial

from deepmf_sumo.results import statistics
from deepmf_sumo.results.quantities import COMPARABLE
from deepmf_sumo.results.statistics import Units, units_of

UNITS = (5, 10, 40)
RATES = (0.02, 0.1, 0.5)
_RARE = 1e-5
"""Less likely samples are left out, and count as missed."""


def holds(interval: tuple[float, float, float], truth: float) -> bool:
    return interval[1] - 1e-9 <= truth <= interval[2] + 1e-9


@cache
def _rate(ones: int, n: int, confidence: float) -> statistics.Interval:
    return statistics.rate([[float(one < ones)] for one in range(n)], confidence)


def of_rate(n: int, rate: float, confidence: float = 0.95) -> float:
    """Of n units with one run each."""
    return sum(
        binom.pmf(ones, n, rate)
        for ones in range(n + 1)
        if binom.pmf(ones, n, rate) > _RARE and holds(_rate(ones, n, confidence), rate)
    )


def of_seeds(n: int, seeds: int, rate: float, strength: float, samples: int) -> float:
    """Of n units whose own rates differ, with several runs each."""
    rng = np.random.default_rng([n, seeds, round(100 * rate)])
    own = rng.beta(rate * strength, (1 - rate) * strength, (samples, n))
    ones = np.sort(rng.binomial(seeds, own))
    found = [
        holds(statistics.rate([[1.0] * k + [0.0] * (seeds - k) for k in one]), rate)
        for one in ones.tolist()
    ]
    return float(np.mean(found))


@cache
def _paired(values: tuple[tuple[float, int], ...], confidence: float, largest: float | None):
    groups = [[value] for value, count in values for _ in range(count)]
    return statistics.paired(groups, confidence, largest)


def of_paired(
    n: int, chances: dict[float, float], largest: float | None = 1.0, confidence: float = 0.95
) -> float:
    """Of differences with given values and their chances."""
    values = list(chances)
    truth = sum(value * chance for value, chance in chances.items())
    covered = 0.0
    for counts in _counts(n, len(values)):
        chance = multinomial.pmf(counts, n, list(chances.values()))
        if chance > _RARE:
            sample = tuple((v, c) for v, c in zip(values, counts, strict=True) if c)
            covered += chance * holds(_paired(sample, confidence, largest), truth)
    return covered


def _counts(n: int, kinds: int):
    if kinds == 1:
        return [(n,)]
    return [(k, *rest) for k in range(n + 1) for rest in _counts(n - k, kinds - 1)]


@cache
def _unpaired(new: int, old: int, n: int, confidence: float):
    sides = [statistics.units_of([[float(k < ones)] for k in range(n)]) for ones in (new, old)]
    return statistics.unpaired(*sides, confidence, 1.0)


def of_unpaired(n: int, new: float, old: float, confidence: float = 0.95) -> float:
    """Of two rates, each of n other units."""
    sides = [
        [(k, chance) for k in range(n + 1) if (chance := binom.pmf(k, n, rate)) > 1e-3]
        for rate in (new, old)
    ]
    return sum(
        a * b
        for (i, a), (j, b) in product(*sides)
        if holds(_unpaired(i, j, n, confidence), new - old)
    )


def of_values(
    n: int,
    draw: Callable[[np.random.Generator, int], np.ndarray],
    truth: float,
    largest: float | None,
    samples: int,
    confidence: float = 0.95,
) -> float:
    """Of differences with any distribution."""
    rng = np.random.default_rng([n, 7])
    found = [
        holds(statistics.paired([[v] for v in draw(rng, n)], confidence, largest), truth)
        for _ in range(samples)
    ]
    return float(np.mean(found))


def of_mean(n: int, draw: Callable[..., np.ndarray], truth: float, samples: int) -> float:
    """Of values without known limits."""
    rng = np.random.default_rng([n, 8])
    found = [holds(statistics.mean([[v] for v in draw(rng, n)]), truth) for _ in range(samples)]
    return float(np.mean(found))


def of_place_rates(places: int, attacks: int, mean: float, strength: float, samples: int) -> float:
    """Of places whose rates are Beta distributed; each counts with the chance that it is covered.

    Given its counts, a rate of that distribution is Beta distributed again.
    """
    rng = np.random.default_rng([places, attacks, round(100 * mean), round(strength)])
    a, b = mean * strength, (1 - mean) * strength
    hits = np.sort(rng.binomial(attacks, rng.beta(a, b, (samples, places))))
    covered = 0.0
    for sample, times in zip(*np.unique(hits, axis=0, return_counts=True), strict=True):
        units = of_counts([(x, attacks) for x in sample.tolist()])
        low, high = np.array([one[1:] for one in statistics.place_rates(units).values()]).T
        own = beta(a + sample, b + attacks - sample)
        covered += times * (own.cdf(high) - own.cdf(low - 1e-9)).mean()
    return float(covered / samples)


def of_counts(counts: Sequence[tuple[int, int]]) -> dict[str, Units]:
    """Places with so many hits of so many attacks."""
    return {
        str(place): units_of([[float(attack < hits)] for attack in range(attacks)])
        for place, (hits, attacks) in enumerate(counts)
    }


Places = Callable[[np.random.Generator, int, int], tuple[np.ndarray, Sequence[np.ndarray]]]


def near_misses(mean: float, strength: float) -> Places:
    """Criticalities: most attacks are none, the others are anywhere from 0.2 to 1."""

    def draw(rng: np.random.Generator, places: int, attacks: int):
        rates = rng.beta(mean * strength, (1 - mean) * strength, places)
        values = [(rng.random(attacks) < rate) * rng.uniform(0.2, 1.0, attacks) for rate in rates]
        return 0.6 * rates, values

    return draw


def around(mean: float, between: float, within: float) -> Places:
    """Criticalities near those of their place; Beta distributed, so that their means are known."""

    def draw(rng: np.random.Generator, places: int, attacks: int):
        means = np.clip(rng.normal(mean, between, places), 0.02, 0.98)
        strength = means * (1 - means) / within**2
        return means, [
            rng.beta(m * s, (1 - m) * s, attacks) for m, s in zip(means, strength, strict=True)
        ]

    return draw


def of_place_means(places: int, attacks: int, draw: Places, samples: int) -> tuple[float, float]:
    """Coverage, and the share of intervals of width 0."""
    rng = np.random.default_rng([places, attacks, 3])
    covered = empty = 0
    for _ in range(samples):
        means, values = draw(rng, places, attacks)
        groups = {str(k): statistics.units_of([[v] for v in one]) for k, one in enumerate(values)}
        for mean, one in zip(means, statistics.place_means(groups).values(), strict=True):
            covered += one.low - 1e-9 <= mean <= one.high + 1e-9
            empty += one.high - one.low < 1e-6
    return covered / (samples * places), empty / (samples * places)


def main() -> None:
    """Print what `docs/explain/statistics.md` says."""
    impact = COMPARABLE["impact_mps"].largest
    rows = {
        "rate": [[of_rate(n, rate) for rate in RATES] for n in UNITS],
        "paired rates, one side only": [
            [of_paired(n, {1.0: r, 0.0: 1 - r}) for r in RATES] for n in UNITS
        ],
        "paired rates, both sides": [
            [of_paired(n, {1.0: r / 2, -1.0: r / 2, 0.0: 1 - r}) for r in RATES] for n in UNITS
        ],
        "rates without pairs, equal": [[of_unpaired(n, r, r) for r in RATES] for n in UNITS],
        "12 m/s more in some units": [
            [of_paired(n, {12.0: r, 0.0: 1 - r}, impact) for r in RATES] for n in UNITS
        ],
    }
    print(f"95 % intervals; rates {RATES}, by number of units {UNITS}")
    for name, found in rows.items():
        print(f"{name:30}", "  ".join(" ".join(f"{100 * c:5.1f}" for c in one) for one in found))
    print("90 % intervals of places: places x attacks; rates of hits, criticality (width 0)")
    for places, attacks in ((5, 1), (6, 1), (6, 2), (20, 2), (40, 5)):
        rates = [
            of_place_rates(places, attacks, m, s, 100) for m in (0.1, 0.3, 0.5) for s in (2, 8)
        ]
        means = [
            of_place_means(places, attacks, draw, 60)
            for draw in (near_misses(0.1, 4), near_misses(0.5, 4), around(0.3, 0.1, 0.2))
        ]
        print(
            f"{places:3} x {attacks}", " ".join(f"{100 * c:5.1f}" for c in rates), " ",
            " ".join(f"{100 * c:5.1f} ({100 * e:.0f})" for c, e in means),
        )  # fmt: skip


if __name__ == "__main__":
    main()
