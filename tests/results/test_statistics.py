"""Intervals against scipy, known tests and sums by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, binomtest

from deepmf_sumo.results import statistics
from deepmf_sumo.results.statistics import paired, rate, units_of, unpaired

from tests.support.coverage import of_counts


def ones(count, of):
    return [[float(number < count)] for number in range(of)]


def binomial(count, of, confidence=0.95):
    found = binomtest(count, of).proportion_ci(confidence, method="exact")
    return found.low, found.high


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.999])
@pytest.mark.parametrize(
    "counts", [(0, 1), (1, 1), (0, 6), (3, 10), (10, 10), (1, 200), (77, 400), (0, 3000)]
)
def test_of_single_runs_the_rate_has_the_exact_interval(counts, confidence):
    found = rate(ones(*counts), confidence)
    assert found.rate == counts[0] / counts[1]
    assert found[1:] == pytest.approx(binomial(*counts, confidence), rel=2e-2, abs=2e-5)


def test_none_of_six_is_at_most_39_per_cent():
    assert rate(ones(0, 6), 0.9).high == pytest.approx(1 - 0.05 ** (1 / 6), abs=1e-6)


def test_ten_seeds_of_one_spec_are_one_unit():
    assert rate([[1.0] * 10]) == pytest.approx((1.0, 0.025, 1.0), abs=1e-6)
    of_both = rate([[1.0, 1.0, 0.0, 0.0], [0.0] * 4])
    assert of_both.low < 0.02 < 0.8 < of_both.high


def test_units_with_more_runs_weigh_more_and_are_worth_fewer():
    """Kish: 6 runs of one unit and 1 of each of two others are 64 / 38 equal units."""
    found = units_of([[1.0] * 6, [0.0], [0.0]])
    assert found.mean == 0.75
    assert sum(found.weights) == pytest.approx(64 / 38)


@pytest.mark.parametrize("groups", [[], [[]], [[2.0]], [[-1.0, 0.0]]])
def test_no_rate(groups):
    with pytest.raises(ValueError, match="no zeros and ones"):
        rate(groups)


@pytest.mark.parametrize(("more", "fewer", "same"), [(5, 0, 3), (6, 1, 0), (9, 3, 20), (1, 1, 1)])
def test_paired_rates_exclude_zero_where_mcnemar_does(more, fewer, same):
    values = [[1.0]] * more + [[-1.0]] * fewer + [[0.0]] * same
    chance = float(binom.sf(more - 1, more + fewer, 0.5))
    assert statistics.by_chance(more, fewer) == pytest.approx(chance)
    for confidence, excluded in ((1 - 2.02 * chance, True), (1 - 1.98 * chance, False)):
        if 0 < confidence < 1:
            assert (paired(values, confidence, 1.0).low > 0) == excluded


def test_equal_pairs_have_the_rule_of_three():
    """None of n differs: up to 1 - 0.05^(1 / n) of the others do, each by the largest amount."""
    for count in (1, 5, 20):
        mean, low, high = paired([[0.0]] * count, 0.9, 20.0)
        assert mean == 0.0
        assert high == -low == pytest.approx(20 * (1 - 0.05 ** (1 / count)), rel=1e-6)


def test_equal_values_of_unknown_size_have_no_interval():
    assert paired([[0.0]] * 8, 0.9) == (0.0, None, None)
    assert statistics.mean([[3.0]] * 8) == (3.0, None, None)
    same = units_of([[0.0]] * 5)
    assert unpaired(same, same, 0.9) == (0.0, None, None)


def test_the_distribution_is_that_of_random_shares():
    """Against a million drawn ones."""
    values = np.array([0.0, 0.0, 0.0, 1.0, 1.5, 20.0])
    shares = np.random.default_rng(0).dirichlet(np.ones(6), 1_000_000)
    expected = np.quantile(shares @ values, 0.95)
    assert paired([[one] for one in values[:-1]], 0.9, 20.0).high == pytest.approx(expected, 5e-3)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-9, 9), min_size=1, max_size=9), st.floats(0.5, 30))
def test_other_sides_have_the_opposite_interval(values, largest):
    mean, low, high = paired([[one] for one in values], 0.9, largest)
    back = paired([[-one] for one in values], 0.9, largest)
    assert back == pytest.approx((-mean, -high, -low), abs=1e-6)
    assert low <= mean <= high
    assert low < high


def test_more_units_and_less_confidence_narrow():
    values = units_of([[0.0], [0.0], [1.0], [4.0]])
    widths = []
    for count in (4, 8, 40, 400):
        _, low, high = statistics.of_pairs(values.as_many(count), 0.9, 20.0)
        widths.append(high - low)
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] < widths[0] / 8
    wide, narrow = (statistics.of_pairs(values, level, 20.0) for level in (0.99, 0.9))
    assert wide.low < narrow.low < narrow.high < wide.high


def test_many_different_values_are_those_of_the_central_limit():
    values = np.random.default_rng(3).normal(2.0, 1.0, 1500)
    _, low, high = paired([[one] for one in values], 0.95, 10.0)
    half = 1.96 * values.std() / math.sqrt(1500)
    assert low == pytest.approx(values.mean() - half, abs=0.04)
    assert high == pytest.approx(values.mean() + half, abs=0.04)


def test_unpaired_rates_are_near_newcombes():
    """His example: 56 of 70 and 48 of 80; with exact ends they are a bit wider."""
    found = unpaired(units_of(ones(56, 70)), units_of(ones(48, 80)), 0.95, 1.0)
    assert found.mean == pytest.approx(0.2)
    assert found[1:] == pytest.approx((0.0524, 0.3339), abs=0.012)


@pytest.mark.parametrize(("confidence", "units"), [(0.9, 5), (0.95, 6), (0.975, 7), (0.99, 8)])
def test_fewest_units_that_show_a_difference(confidence, units):
    assert statistics.fewest(confidence) == units
    assert paired([[1.0]] * (units - 1), confidence, 1.0).low <= 0
    assert paired([[1.0]] * units, confidence, 1.0).low > 0


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_fewest_units_without_pairs(confidence):
    each = statistics.fewest_unpaired(confidence) // 2
    for count, shown in ((each - 1, False), (each, True)):
        new, old = units_of(ones(count, count)), units_of(ones(0, count))
        assert (unpaired(new, old, confidence, 1.0).low > 0) == shown


def test_a_place_alone_has_the_exact_interval():
    found = statistics.place_rates(of_counts([(0, 6)]))["0"]
    assert (found.low, found.high) == pytest.approx(binomial(0, 6, 0.9), abs=1e-6)
    assert 0 < found.rate < 0.2


def test_three_places_are_no_surer_than_all_their_attacks_together():
    """None of two attacks at each of three: of six attacks the exact bound is 39 %."""
    found = statistics.place_rates(of_counts([(0, 2)] * 3))["0"]
    assert binomial(0, 6, 0.9)[1] < found.high < 0.5


def test_one_lucky_hit_does_not_lead():
    found = statistics.place_rates(of_counts([(1, 1), (7, 10)] + [(1, 10)] * 10))
    lucky, steady = found["0"], found["1"]
    assert steady.low > lucky.low
    assert lucky.rate < 0.75
    assert lucky.high == 1.0


def test_places_that_are_alike_are_drawn_together_and_different_ones_are_not():
    rng = np.random.default_rng(0)
    alike = [(int(hits), 20) for hits in rng.binomial(20, 0.3, 40)]
    apart = [(18, 20)] * 4 + [(2, 20)] * 36
    assert statistics.place_rates(of_counts(apart))["0"].rate > 0.75
    worst = max(range(40), key=lambda number: alike[number])
    assert statistics.place_rates(of_counts(alike))[str(worst)].rate < 0.75 * alike[worst][0] / 20


def test_more_attacks_narrow_the_rates_of_places():
    widths = []
    for factor in (1, 4, 16):
        found = statistics.place_rates(
            of_counts([(hits * factor, 4 * factor) for hits in range(5)])
        )
        widths.append(found["2"].high - found["2"].low)
    assert widths == sorted(widths, reverse=True)


def test_no_places():
    assert statistics.place_rates({}) == {}
    assert statistics.place_means({}) == {}
