import numpy as np
import pytest
import torch

from deepmf_sumo.training.networks import opponent


class Net:
    """Logits are as given, of two members."""

    def eval(self):
        return self

    def cpu(self):
        return self

    def __call__(self, batch):
        return torch.stack([batch["logits"] - 1.0, batch["logits"] + 1.0])


class Cache:
    """Held-out samples of five vehicles, four of which are there; half of them name a partner."""

    def __init__(self, samples):
        generator = torch.Generator().manual_seed(0)
        logits = 2.0 * torch.randn(samples, 5, 2, generator=generator)
        drawn = torch.rand(samples, 5, generator=generator)
        known = torch.arange(samples) % 2
        partner = drawn < (2 * logits[..., 1]).sigmoid()
        partner = torch.where(known[:, None] > 0, partner, ~partner)  # of no meaning
        there = torch.ones(samples, 5)
        there[:, 4] = 0
        self.arrays = {
            "logits": logits, "partner": partner, "partner_known": known, "vehicle": there,
        }  # fmt: skip

    def rows(self, *, held_out):
        return np.arange(len(self.arrays["logits"]) if held_out else 0)

    def batch(self, rows):
        return {name: values[rows].float().numpy() for name, values in self.arrays.items()}


def test_the_partner_s_head_is_fitted_where_a_partner_is_named():
    found = opponent.calibrate(Net(), Cache(1000))
    assert found.partner_temperature == pytest.approx(0.5, abs=0.051)


@pytest.mark.parametrize("samples", [0, 1000])
def test_the_first_head_has_what_its_loss_implies(samples):
    found = opponent.calibrate(Net(), Cache(samples))
    assert (found.temperature, found.offset) == opponent.focal_link()


def test_without_held_out_scenes_the_partner_s_logits_stay():
    assert opponent.calibrate(Net(), Cache(0)).partner_temperature == 1.0


@pytest.mark.parametrize(("alpha", "gamma"), [(0.75, 2.0), (0.5, 1.0), (0.6, 0.0)])
@pytest.mark.parametrize("frequency", [0.03, 0.2, 0.5, 0.8, 0.97])
def test_where_the_focal_loss_is_least_its_link_gives_the_frequency(frequency, alpha, gamma):
    logits = torch.linspace(-6.0, 6.0, 12001)
    yes, no = (
        opponent.focal(logits, torch.full_like(logits, each), alpha, gamma) for each in (1.0, 0.0)
    )
    least = float(logits[(frequency * yes + (1 - frequency) * no).argmin()])
    temperature, offset = opponent.focal_link(alpha, gamma)
    found = 1 / (1 + np.exp(-(least / temperature + offset)))
    assert found == pytest.approx(frequency, abs=0.012)
