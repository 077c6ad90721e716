import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from deepmf_sumo.metrics.statistics import wilson


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_as_published(counts):
    ours = wilson(*counts)
    theirs = binomtest(*counts).proportion_ci(0.95, method="wilson")
    assert ours.low == pytest.approx(theirs.low, abs=1e-9)
    assert ours.high == pytest.approx(theirs.high, abs=1e-9)
    assert ours.low <= ours.rate <= ours.high


@pytest.mark.parametrize("counts", [(0, 0), (3, 2), (-1, 4)])
def test_no_rate(counts):
    with pytest.raises(ValueError, match="not a rate"):
        wilson(*counts)
