"""A few signals to some commands; ``make signals`` sends 10 of each kind to each long one."""

import sys

import pytest

from tests.fuzz import signals


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
def test_nothing_is_lost_doubled_or_left(tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path))
    sent, wrong = signals.run(tmp_path, 2, seed=2, names=("run", "convert", "shrink"))
    assert wrong == []
    assert sent.total() == 18
