"""Every interval contains the truth as often as it says, minus 3 points at most."""

import numpy as np
import pytest

from deepmf_sumo.results.quantities import COMPARABLE

from tests.support import coverage
from tests.support.coverage import RATES, UNITS

NOMINAL, PLACES = 0.92, 0.87
"""95 % and 90 %, minus 3 points."""
LARGEST = COMPARABLE["impact_mps"].largest


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("units", UNITS)
def test_rates(units, rate):
    assert coverage.of_rate(units, rate) >= NOMINAL


@pytest.mark.parametrize("units", [5, 10])
def test_rates_of_specs_with_several_seeds(units):
    assert coverage.of_seeds(units, 4, 0.1, 1.0, 100) >= NOMINAL
    assert coverage.of_seeds(units, 4, 0.5, 0.2, 100) >= NOMINAL


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("units", UNITS)
def test_paired_rates(units, rate):
    """One side alone has hits; at 2 % most samples are equal pairs."""
    assert coverage.of_paired(units, {1.0: rate, 0.0: 1 - rate}) >= NOMINAL


@pytest.mark.parametrize("units", [5, 10])
def test_paired_rates_of_equal_sides(units):
    assert coverage.of_paired(units, {1.0: 0.1, -1.0: 0.1, 0.0: 0.8}) >= NOMINAL


@pytest.mark.parametrize(("new", "old"), [(0.1, 0.1), (0.5, 0.02)])
@pytest.mark.parametrize("units", [5, 10])
def test_rates_without_pairs(units, new, old):
    assert coverage.of_unpaired(units, new, old) >= NOMINAL


@pytest.mark.parametrize("confidence", [0.9, 0.95])
@pytest.mark.parametrize(("size", "share"), [(12.0, 0.1), (12.0, 0.3), (-18.0, 0.05)])
@pytest.mark.parametrize("units", UNITS)
def test_rare_large_values(units, size, share, confidence):
    found = coverage.of_paired(units, {size: share, 0.0: 1 - share}, LARGEST, confidence)
    assert found >= confidence - 0.03


def test_rare_large_values_among_small_ones():
    def draw(rng, n):
        return rng.normal(-0.5, 0.3, n) + 12.0 * (rng.random(n) < 0.1)

    assert coverage.of_values(10, draw, 0.7, LARGEST, 100) >= NOMINAL


@pytest.mark.parametrize("places", [(5, 1), (6, 1), (6, 2)])
@pytest.mark.parametrize(("mean", "strength"), [(0.1, 4.0), (0.3, 8.0), (0.5, 2.0)])
def test_rates_of_places(places, mean, strength):
    assert coverage.of_place_rates(*places, mean, strength, 100) >= PLACES


def test_rates_of_many_places():
    assert coverage.of_place_rates(40, 5, 0.3, 8.0, 12) >= PLACES


@pytest.mark.parametrize("draw", [coverage.near_misses(0.1, 4), coverage.around(0.3, 0.1, 0.25)])
@pytest.mark.parametrize("places", [(5, 1), (6, 2)])
def test_criticality_of_places(places, draw):
    covered, empty = coverage.of_place_means(*places, draw, 60)
    assert covered >= PLACES
    assert empty == 0


def test_no_interval_of_a_place_has_width_0():
    nothing = lambda _, places, attacks: (np.zeros(places), np.zeros((places, attacks)))  # noqa: E731
    for places in (1, 6):
        assert coverage.of_place_means(places, 1, nothing, 1) == (1.0, 0.0)


MEAN_VALUES = {
    "normal": (lambda rng, n: rng.normal(1.0, 1.0, n), 1.0),
    "uniform": (lambda rng, n: rng.random(n), 0.5),
    "exponential": (lambda rng, n: rng.exponential(1.0, n), 1.0),
}


@pytest.mark.parametrize("name", MEAN_VALUES)
def test_means_of_unknown_limits(name):
    assert coverage.of_mean(8, *MEAN_VALUES[name], 80) >= NOMINAL


@pytest.mark.slow
def test_the_large_grid():
    low = []
    for units in UNITS:
        for rate in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 0.95):
            cases = {
                "rate": coverage.of_rate(units, rate),
                "seeds": coverage.of_seeds(units, 3, rate, 1.0, 300),
                "one": coverage.of_paired(units, {1.0: rate, 0.0: 1 - rate}),
                "both": coverage.of_paired(
                    units, {1.0: 0.6 * rate, -1.0: 0.4 * rate, 0.0: 1 - rate}
                ),
                "unpaired": coverage.of_unpaired(units, rate, 0.1),
                "large": coverage.of_paired(units, {15.0: rate, 0.0: 1 - rate}, LARGEST),
            }
            low += [(units, rate, *case) for case in cases.items() if case[1] < NOMINAL]
        for name, (draw, truth) in MEAN_VALUES.items():
            cases = {
                "mean": coverage.of_mean(units, draw, truth, 300),
                "paired": coverage.of_values(units, draw, truth, None, 300),
            }
            low += [(units, name, *case) for case in cases.items() if case[1] < NOMINAL - 0.02]
    assert not low


@pytest.mark.slow
@pytest.mark.parametrize("mean", [0.02, 0.1, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("places", [(1, 6), (5, 1), (6, 1), (6, 2), (20, 2), (40, 5)])
def test_the_large_grid_of_rates_of_places(places, mean):
    samples = 60 if places[0] == 40 else 200
    for strength in (1.0, 2.0, 4.0, 8.0, 32.0):
        assert coverage.of_place_rates(*places, mean, strength, samples) >= PLACES


@pytest.mark.slow
@pytest.mark.parametrize("places", [(1, 6), (5, 1), (6, 1), (6, 2), (20, 2), (40, 5)])
def test_the_large_grid_of_criticality(places):
    for draw in (
        coverage.near_misses(0.02, 8), coverage.near_misses(0.1, 4), coverage.near_misses(0.5, 4),
        coverage.around(0.3, 0.0, 0.25), coverage.around(0.3, 0.1, 0.25),
        coverage.around(0.5, 0.3, 0.1), coverage.around(0.5, 0.05, 0.05),
    ):  # fmt: skip
        covered, empty = coverage.of_place_means(*places, draw, 200)
        assert covered >= PLACES
        assert empty == 0
