import numpy as np
import pytest
import torch

from deepmf_sumo.training import losses, opponent


def held_out(*, asked_share=0.5, samples=4000):
    """Logits whose sigmoid is a frequency at 2 x - 1.5 where asked, and at 3 x elsewhere."""
    generator = torch.Generator().manual_seed(0)
    logits = 2.0 * torch.randn(samples, 2, generator=generator)
    asked = torch.rand(samples, generator=generator) < asked_share
    true = torch.where(asked, 2 * logits[:, 0] - 1.5, 3 * logits[:, 0])
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
    assert found.temperature == pytest.approx(1 / 3, abs=0.02)
    assert found.offset == pytest.approx(0.0, abs=0.15)


def test_few_vehicles_leave_what_the_loss_implies(monkeypatch):
    monkeypatch.setattr(opponent, "held_out", lambda *_: held_out(asked_share=1.0, samples=40))
    found = opponent.calibrate(None, Cache(1))
    assert (found.temperature, found.offset) == losses.focal_link()


def test_without_held_out_scenes_the_loss_alone_says_it():
    found = opponent.calibrate(None, Cache(0))
    assert (found.temperature, found.offset) == losses.focal_link()


@pytest.mark.parametrize(("alpha", "gamma"), [(0.75, 2.0), (0.5, 1.0), (0.6, 0.0)])
@pytest.mark.parametrize("frequency", [0.03, 0.2, 0.5, 0.8, 0.97])
def test_where_the_focal_loss_is_least_its_link_gives_the_frequency(frequency, alpha, gamma):
    logits = torch.linspace(-6.0, 6.0, 12001)
    yes, no = (
        losses.focal(logits, torch.full_like(logits, each), alpha, gamma) for each in (1.0, 0.0)
    )
    least = float(logits[(frequency * yes + (1 - frequency) * no).argmin()])
    temperature, offset = losses.focal_link(alpha, gamma)
    found = 1 / (1 + np.exp(-(least / temperature + offset)))
    assert found == pytest.approx(frequency, abs=0.012)
