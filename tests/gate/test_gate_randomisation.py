import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.results import difference


def test_all_subsets_of_few_pairs():
    """Six equal changes: only one of 64 swaps is as extreme, so 2.5 % a side are reached."""
    found = difference.paired([[1.0]] * 6, 0.95)
    assert found == (1.0, 1.0, 1.0)
    assert difference.paired([[1.0]] * 5, 0.95) == (1.0, None, None)


@pytest.mark.parametrize(("confidence", "units"), [(0.9, 5), (0.95, 6), (0.975, 7), (0.99, 8)])
def test_fewest_units_of_an_interval(confidence, units):
    """At each end: 5 % is reached by one of 32 swaps, 2.5 % by one of 64."""
    assert difference.fewest(confidence) == units
    assert difference.paired([[1.0]] * (units - 1), confidence).low is None
    assert difference.paired([[1.0]] * units, confidence).low == 1.0


def test_worked_interval():
    """Means of the subsets of (0, 0, 0, 0, 0, 6): a single one is the greatest, 31 are 0."""
    found = difference.paired([[0.0]] * 5 + [[6.0]], 0.95)
    assert found == (1.0, 0.0, 6.0)


def test_values_of_a_unit_swap_together():
    """Twenty runs of one scene are one unit; of twenty scenes they are twenty."""
    assert difference.paired([[1.0] * 20], 0.95).low is None
    assert difference.paired([[1.0]] * 20, 0.95).low == 1.0


def test_sums_in_another_order_are_ties():
    """Thirds are no binary fractions: equal sums must not differ in their last bits."""
    thirds = [[value / 3] for value in (1, -1, 1, -1, 2, -2, 4, -4)]
    assert difference.paired(thirds, 0.95).mean == pytest.approx(0)
    low, high = difference.paired(thirds, 0.95)[1:]
    assert low == -high


@settings(max_examples=40)
@given(st.lists(st.floats(-9, 9), min_size=6, max_size=11), st.floats(-5, 5))
def test_a_shift_shifts_the_interval(values, shift):
    before = difference.paired([[value] for value in values], 0.95)
    after = difference.paired([[value + shift] for value in values], 0.95)
    assert after == pytest.approx([end + shift for end in before], abs=1e-6)
    assert before.low <= before.mean + 1e-6
    assert before.high >= before.mean - 1e-6


def test_intervals_cover_the_truth():
    rng = np.random.default_rng(1)
    missed = 0
    for _ in range(400):
        _, low, high = difference.paired([[v] for v in rng.exponential(1.0, 11)], 0.9)
        missed += not low <= 1.0 <= high
    assert 15 <= missed <= 70  # skewed, so near 10 %, not at it


def test_unpaired_agrees_with_the_textbook():
    """Of a normal shift, close to the t interval: 2.0 +- 2.0 sqrt(2 / 40) * 2.0."""
    rng = np.random.default_rng(2)
    new, old = rng.normal(2.0, 1.0, 40), rng.normal(0.0, 1.0, 40)
    mean, low, high = difference.unpaired(new, old, 0.95)
    half = 1.99 * np.sqrt((new.var(ddof=1) + old.var(ddof=1)) / 40)
    assert (low, high) == pytest.approx((mean - half, mean + half), abs=0.08)


@pytest.mark.parametrize(("each", "told"), [(1, False), (3, False), (4, True)])
def test_few_unpaired_values(each, told):
    """Of 6! / (3! 3!) = 20 arrangements one is 5 %, of 70 it is 1.4 %."""
    found = difference.unpaired([1.0] * each, [0.0] * each, 0.95)
    assert (found.low is not None) == told
    assert difference.fewest_unpaired(0.95) == 8
