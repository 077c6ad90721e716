"""Rates of moments that were drawn by what others found: unbiased, and their intervals hold."""

import math
from collections import Counter
from itertools import permutations

import numpy as np
import pytest

from deepmf_sumo.results import statistics
from deepmf_sumo.study.moments.moment import Moment
from deepmf_sumo.study.moments.promising import POOL, Promising


def moment(edge, turn="left", apart_s=0.5, number=0):
    return Moment(
        av=f"v{number}", av_type="car", start_s=float(number), edge=edge, following=f"{edge} on",
        turn=turn, speed_mps=10.0, around=1, encounter_s=apart_s,
    )  # fmt: skip


def a_pool(rng, count, rates):
    """Moments at edges that differ in how often attacks find something."""
    pool, chance = [], []
    for number in range(POOL * count):
        edge = int(rng.integers(len(rates)))
        pool.append(moment(f"e{edge}", number=number))
        chance.append(rates[edge])
    return pool, np.array(chance)


def attacked(pool, count, seed, outcomes):
    """What was drawn, and its draws, in order."""
    promising, worth, draws = Promising(pool, count, seed), {}, {}
    while drawn := promising.draw(worth):
        draws |= drawn
        worth |= {index: float(outcomes[index]) for index in drawn}
    return draws


def estimate(draws, outcomes):
    """The rate over the pool, as Horvitz and Thompson, and its interval."""
    chances = [draw.probability for draw in draws.values()]
    stands_for = statistics.drawn(chances, len(outcomes))
    found = [float(outcomes[index]) for index in draws]
    total = sum(weight * value for weight, value in zip(stands_for, found, strict=True))
    units = statistics.weighted(zip(draws, found, stands_for, strict=True))
    return total / len(outcomes), statistics.rate_of(units)


def test_weights_of_two_draws_are_unbiased_whatever_the_second_depends_on():
    """All orders of two draws from three values, with chances that depend on the first value."""
    values, expected, chance_of_all = (0.0, 1.0, 5.0), 0.0, 0.0
    for first, second, third in permutations(range(3)):
        one = (0.5, 0.3, 0.2)[first]
        greedy = 0.9 if values[first] > 0.5 else 0.4
        two = greedy if second < third else 1 - greedy
        weights = statistics.drawn([one, two], 3)
        expected += one * two * (weights[0] * values[first] + weights[1] * values[second])
        chance_of_all += one * two
    assert chance_of_all == pytest.approx(1.0)
    assert expected == pytest.approx(sum(values))


def test_equal_chances_are_inverse_probabilities():
    assert statistics.drawn([1 / 10, 1 / 9, 1 / 8], 10) == pytest.approx([10 / 3] * 3)
    assert statistics.drawn([1.0, 1.0, 1 / 8, 1 / 7], 10) == pytest.approx([1, 1, 4, 4])
    assert statistics.drawn([1.0, 1.0], 2) == [1.0, 1.0]


def test_runs_that_count_alike_are_as_before():
    values = [("a", 1.0), ("a", 0.0), ("b", 1.0), ("c", 0.0)]
    plain = statistics.units_of(statistics.by_unit(values))
    assert statistics.weighted((unit, value, 1.0) for unit, value in values) == plain
    twice = statistics.weighted((unit, value, 2.0) for unit, value in values)
    assert twice == plain
    heavy = statistics.weighted([("a", 1.0, 3.0), ("b", 0.0, 1.0)])
    assert heavy.mean == pytest.approx(0.75)
    assert sum(heavy.weights) == pytest.approx(16 / 10), "Kish: two units are worth 1.6"


RATES = ((0.02, 0.1, 0.02, 0.3), (0.0, 0.0, 0.0, 0.8), (0.3,) * 4)


def simulated(rates, samples):
    """Of many attacks: errors of three estimates of the pool's rate, and whether intervals hold."""
    rng = np.random.default_rng(5)
    errors, held = [], []
    for seed in range(samples):
        pool, chance = a_pool(rng, 24, rates)
        outcomes = rng.random(len(pool)) < chance
        draws = attacked(pool, 24, seed, outcomes)
        total, interval = estimate(draws, outcomes)
        plain = np.mean([outcomes[index] for index in draws])
        errors.append(np.array([total, interval.rate, plain]) - outcomes.mean())
        held.append(interval.low - 1e-9 <= chance.mean() <= interval.high + 1e-9)
    return np.array(errors), np.mean(held)


@pytest.mark.parametrize("rates", RATES)
def test_rates_are_those_of_the_pool_though_more_is_drawn_where_more_is_found(rates):
    errors, held = simulated(rates, 60)
    sums, ratios, plain = errors.mean(axis=0)
    assert abs(sums) < 3 * errors[:, 0].std() / math.sqrt(len(errors)), "unbiased"
    assert abs(ratios) < 0.04, "a ratio of estimates is off a little with 24 attacks"
    assert held >= 0.9
    if rates != RATES[2]:
        assert plain > 0.04 > 1.5 * abs(sums), "with an equal weight for each it is biased"


@pytest.mark.slow
@pytest.mark.parametrize("rates", RATES)
def test_intervals_of_drawn_moments_hold(rates):
    errors, held = simulated(rates, 1500)
    assert abs(errors[:, 0].mean()) < 3 * errors[:, 0].std() / math.sqrt(len(errors))
    assert abs(errors[:, 1].mean()) < 0.03
    assert held >= 0.95 - 0.03


def test_moments_are_drawn_where_attacks_found_something():
    pool = [moment(f"e{number % 4}", number=number) for number in range(96)]
    outcomes = [number % 4 == 1 for number in range(96)]
    found = [attacked(pool, 24, seed, outcomes).items() for seed in range(10)]
    at = Counter(index % 4 for draws in found for index, draw in draws if draw.drawn != "spread")
    assert at.total() == 160
    assert at[1] > 160 * 0.7
    assert max(at[0], at[2], at[3]) < 160 * 0.15


def test_the_first_third_is_spread_and_chances_add_up():
    pool = [moment(f"e{number}", number=number) for number in range(40)]
    draws = attacked(pool, 10, 7, [False] * 40)
    assert [draw.draw for draw in draws.values()] == list(range(1, 11))
    first = [index for index, draw in draws.items() if draw.drawn == "spread"]
    assert first == [0, 1, 2]
    assert len(draws) == 10
    for number, draw in enumerate(list(draws.values())[3:]):
        assert draw.probability == pytest.approx(1 / (37 - number)), "nothing was found anywhere"


def test_a_pool_that_is_too_small_is_attacked_as_a_whole():
    pool = [moment("e", number=number) for number in range(5)]
    draws = attacked(pool, 10, 7, [True] * 5)
    assert [draw.drawn for draw in draws.values()] == ["spread"] * 5
    assert {draw.probability for draw in draws.values()} == {1.0}


def test_the_seed_decides_and_what_could_not_be_attacked_says_nothing():
    rng = np.random.default_rng(1)
    pool, chance = a_pool(rng, 12, (0.1, 0.9))
    outcomes = rng.random(len(pool)) < chance
    assert attacked(pool, 12, 3, outcomes) == attacked(pool, 12, 3, outcomes)
    assert attacked(pool, 12, 3, outcomes) != attacked(pool, 12, 4, outcomes)
    promising = Promising(pool, 12, 3)
    promising.draw({})
    equal = promising.draw({})
    assert [one.probability for one in equal.values()] == pytest.approx(
        [1 / 44, 1 / 43, 1 / 42][: len(equal)]
    )
