import numpy as np
import pytest
from scipy.stats import beta

from deepmf_sumo.risk.criticality import STRENGTHS, Prior, prior, shrink


@pytest.mark.parametrize("events", [0, 1, 3, 20, 200])
@pytest.mark.parametrize("others", [0, 1, 5, 77])
def test_ends_are_those_of_the_mixture_of_the_textbook(events, others):
    given = Prior(0.3, (0.05, 0.1, 0.15, 0.2, 0.2, 0.3))
    found = shrink(events, events + others, given)
    a, b = (0.3 * np.array(STRENGTHS) + events, 0.7 * np.array(STRENGTHS) + others)
    chances = [float(np.array(given.chances) @ beta.cdf(end, a, b)) for end in found[1:]]
    assert chances == pytest.approx([0.05, 0.95], abs=1e-8)
    assert found.rate == pytest.approx(np.array(given.chances) @ beta.mean(a, b))


def test_one_strength_is_one_beta_distribution():
    given = Prior(0.25, tuple(float(strength == 4.0) for strength in STRENGTHS))
    found = shrink(3, 5, given)  # Beta(1 + 3, 3 + 2)
    assert found.rate == pytest.approx(4 / 9)
    assert found[1:] == pytest.approx(beta.ppf([0.05, 0.95], 4, 5), abs=1e-6)


def test_one_lucky_hit_does_not_lead():
    counts = [(1, 1), (7, 10), *[(1, 10)] * 10]
    given = prior(counts)
    lucky, steady = shrink(1, 1, given), shrink(7, 10, given)
    assert steady.low > lucky.low
    assert steady.rate > lucky.rate


def test_places_that_are_alike_are_drawn_together_and_different_ones_are_not():
    rng = np.random.default_rng(0)
    alike = [(int(hits), 20) for hits in rng.binomial(20, 0.3, 40)]
    apart = [(18, 20)] * 4 + [(2, 20)] * 36
    assert shrink(18, 20, prior(apart)).rate > 0.75
    worst = max(alike)[0]
    assert shrink(worst, 20, prior(alike)).rate < 0.7 * worst / 20


def test_nothing_known_is_no_certainty():
    found = shrink(0, 1, prior([(0, 1)]))
    assert 0 < found.low < found.rate < found.high < 1
