import numpy as np
import pytest
import torch

from deepmf_sumo.training import opponent


def held_out(*, asked_share=0.5, samples=4000):
    """Logits whose sigmoid is a frequency at 2 x - 1.5 where asked, and at x elsewhere."""
    generator = torch.Generator().manual_seed(0)
    logits = 2.0 * torch.randn(samples, 2, generator=generator)
    asked = torch.rand(samples, generator=generator) < asked_share
    true = torch.where(asked, 2 * logits[:, 0] - 1.5, logits[:, 0])
    labels = (torch.rand(samples, 2, generator=generator) < true.sigmoid()[:, None]).float()
    return opponent.HeldOut(
        logits=logits, labels=labels, known=torch.ones(samples) > 0, asked=asked
    )


class Cache:
    def __init__(self, count):
        self.count = count

    def rows(self, *, held_out):
        return np.arange(self.count)


def test_frequencies_are_those_where_an_attack_asks(monkeypatch):
    monkeypatch.setattr(opponent, "held_out", lambda *_: held_out())
    found = opponent.calibrate(None, Cache(1))
    assert found.temperature == pytest.approx(0.5, abs=0.06)
    assert found.offset == pytest.approx(-1.5, abs=0.25)


def test_where_nothing_asked_interacts_all_count(monkeypatch):
    monkeypatch.setattr(opponent, "held_out", lambda *_: held_out(asked_share=0.0))
    found = opponent.calibrate(None, Cache(1))
    assert found.temperature == pytest.approx(1.0, abs=0.11)
    assert found.offset == pytest.approx(0.0, abs=0.15)


def test_without_held_out_scenes_logits_stay():
    assert opponent.calibrate(None, Cache(0)) == opponent.Calibration()
