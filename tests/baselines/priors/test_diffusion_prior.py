"""DiffScene's diffusion model: components, denoising, sampling; against closed forms and scipy."""

import numpy as np
import pytest
import torch
from scipy.stats import kstest

from deepmf_sumo.baselines.priors import diffscene, reading
from deepmf_sumo.baselines.priors.diffscene import COMPONENTS, DiffusionPrior, Seen
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards


def untrained():
    torch.manual_seed(0)
    net = DiffusionPrior(LIGHT)
    times = torch.arange(1, 17) * 0.5
    basis = torch.zeros(COMPONENTS, 16, 2)
    for order in range(COMPONENTS // 2):
        basis[2 * order, :, 0] = times ** (order + 2) / 8 ** (order + 1)
        basis[2 * order + 1, :, 1] = times ** (order + 2) / 8 ** (order + 1)
    net.basis.copy_(basis.flatten(1))
    return net.eval().requires_grad_(requires_grad=False)


def seen(count):
    hidden = LIGHT.hidden
    return Seen(torch.zeros(count, hidden), torch.zeros(count, 7, hidden),
                torch.ones(count, 7, dtype=torch.bool))  # fmt: skip


@pytest.mark.slow_unit
def test_components_describe_positions():
    net, clean = untrained(), torch.randn(5, COMPONENTS)
    speed = torch.linspace(0, 20, 5)
    position = net.positions(clean, speed)
    torch.testing.assert_close(net.components(position, speed), clean, atol=1e-2, rtol=1e-2)
    still = net.positions(torch.zeros(1, COMPONENTS), torch.tensor([8.0]))
    np.testing.assert_allclose(still[0, -1], [64.0, 0.0], atol=1e-4)


def test_noise_levels_fall_from_the_noisiest_to_none():
    levels = diffscene.noise_levels(20)
    assert len(levels) == 21
    assert (levels[0], levels[-2], levels[-1]) == pytest.approx((10.0, 0.02, 0.0), abs=1e-5)
    assert (levels[1:] < levels[:-1]).all()


@pytest.mark.slow_unit
def test_unit_variance_is_drawn_from_by_the_closed_form():
    """An untrained network is the best one for independent normal components."""
    noise = torch.randn(400, COMPONENTS, generator=torch.Generator().manual_seed(1))
    drawn = untrained().sample(seen(400), noise, 400, torch.zeros_like, 0.0)
    np.testing.assert_allclose(drawn, noise * 10 / 101**0.5, atol=0.15)
    assert kstest(drawn.flatten().numpy(), "norm").pvalue > 0.01


def test_two_ways_are_learnt():
    """The network of a mixture of two points, one of which is likelier, draws both."""
    net = untrained()
    ends = torch.tensor([[3.0], [-3.0]]) * torch.eye(COMPONENTS)[:1]

    def denoised(noisy, level, _):
        away = (noisy.unsqueeze(-2) - ends).square().sum(-1) / (2 * level.unsqueeze(-1) ** 2)
        share = (torch.tensor([0.8, 0.2]).log() - away).softmax(-1)
        return share @ ends

    net.denoised = denoised
    noise = torch.randn(1000, COMPONENTS, generator=torch.Generator().manual_seed(2))
    drawn = net.sample(seen(1000), noise, 60, torch.zeros_like, 0.0)[:, 0]
    assert (drawn.abs() - 3.0).abs().max() < 0.05
    assert float((drawn > 0).float().mean()) == pytest.approx(0.8, abs=0.05)


def test_a_guide_moves_samples_and_no_guidance_does_not():
    net, noise = (
        untrained(),
        torch.randn(64, COMPONENTS, generator=torch.Generator().manual_seed(3)),
    )
    free = net.sample(seen(64), noise, 20, lambda clean: clean[:, 0], 0.0)
    pulled = net.sample(seen(64), noise, 20, lambda clean: clean[:, 0], 0.5)
    assert (pulled[:, 0] < free[:, 0] - 0.1).all()
    torch.testing.assert_close(pulled[:, 1:], free[:, 1:])
    again = net.sample(seen(64), noise, 20, torch.zeros_like, 0.0)
    torch.testing.assert_close(again, free)


def test_a_deadline_ends_it_with_what_is_expected():
    net, noise = untrained(), torch.ones(2, COMPONENTS)
    found = net.sample(seen(2), noise, 20, torch.zeros_like, 1.0, 0.0)
    torch.testing.assert_close(found, 10 * noise / 101)


def test_a_set_without_the_model_names_the_command(tmp_path):
    message = r"diffscene\.json is missing.*deepmf-sumo train diffscene"
    with pytest.raises(WeightsError, match=message):
        reading.diffusion_prior(tmp_path)


def test_weights_are_the_same_from_a_file(tmp_path):
    net = untrained()
    torch.nn.init.normal_(net.end.weight, std=0.1)
    card = {"network": "diffscene", "preset": "light", "sizes": LIGHT.record()}
    cards.write(tmp_path / "set", "diffscene", net, card)
    again = reading.diffusion_prior(tmp_path / "set")
    noisy, level = torch.randn(3, COMPONENTS), torch.full((3,), 0.5)
    first, second = (one.denoised(noisy, level, seen(3)) for one in (net, again))
    torch.testing.assert_close(first, second, atol=1e-2, rtol=1e-2)
    torch.testing.assert_close(again.basis, net.basis)  # whole: it is a table, not a layer
