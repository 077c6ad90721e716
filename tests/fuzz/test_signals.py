"""A few signals to a sweep; ``make signals`` sends 50 of each kind."""

import sys

import pytest

from tests.fuzz import signals


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
def test_nothing_is_lost_doubled_or_left(tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path))
    sent, wrong = signals.run(tmp_path, 4, seed=2)
    assert wrong == []
    assert sent.total() == 12
