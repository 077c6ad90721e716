"""Training of the marginal and the conditional network."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors import anchors, conditioning, decoding, marginal
from deepmf_sumo.predictors.conditioning import Condition
from deepmf_sumo.predictors.config import Preset
from deepmf_sumo.predictors.densetnt import DenseTNT
from deepmf_sumo.training import augmentation, losses, profiles
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.loop import Loss, tensors

_RARE = -6.9
"""log .001: prior of profiles that are not fitted on data."""
_GIVEN = 0.6
"""Share of samples whose partner's future is given; the others keep the network marginal too."""
CONDITION_LAYERS = ("given_line", "target_to_given", "film", "goal_met", "goal_follow")
"""Begin anew where the conditional network begins from the marginal one."""
_TEMPERATURES = np.round(np.arange(0.7, 3.01, 0.1), 1)


def start(net: DenseTNT, cache: Cache, seed: int) -> None:
    """Fit the speed profiles on the samples that are trained on, and put them into the network."""
    rows = cache.rows(held_out=False)
    known = rows[np.asarray(cache.arrays["future_valid"][rows]).all(1)]
    table = profiles.fit(
        np.asarray(cache.arrays["driven"][known], float),
        np.asarray(cache.arrays["motion"][known, 0], float),
        net.preset.profiles,
        np.random.default_rng([seed, 1]),
    )
    fitted = torch.from_numpy(table.relative_m).float()
    speeds = torch.tensor(anchors.START_SPEEDS_MPS)
    braking = anchors.braking(speeds)[:, : net.profiles.shape[1] - fitted.shape[1]]
    net.profiles.copy_(torch.cat([fitted, braking], 1))
    prior = torch.from_numpy(table.log_prior).float()
    rare = prior.new_full(braking.shape[:2], _RARE)
    net.prior.copy_(torch.cat([prior, rare], 1))


def loss_of(net: DenseTNT) -> Loss:
    """Mixture likelihood; a conditional network is given most of the partners' futures."""

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        if net.training:
            batch = augmentation.augmented(batch, net.preset, generator)
        given = partner_condition(batch, net.preset, generator) if net.conditional else None
        return losses.mixture(net, net(batch, given), batch).mean()

    return loss


def partner_condition(
    batch: dict[str, Tensor],
    preset: Preset,
    generator: torch.Generator | None,
) -> Condition:
    """The partner's future as condition; with a generator some are left out at random."""
    position, heading = batch["partner"][..., :2], batch["partner"][..., 2]
    given = batch["partner_known"]
    if generator is not None:
        keep = torch.rand(len(given), generator=generator) < _GIVEN
        given = given * keep.to(given.device)
    return conditioning.encode(position[:, None], heading[:, None], given[:, None], preset)


def _given(net: DenseTNT, batch: dict[str, Tensor]) -> Condition | None:
    return partner_condition(batch, net.preset, None) if net.conditional else None


@torch.inference_mode()
def fit_temperature(
    nets: Sequence[DenseTNT], cache: Cache, modes: int, samples: int = 600
) -> float:
    """The temperature at which modes nearest to true ends are likeliest, on held-out scenes.

    Of one network, or of the mixture of several.
    """
    for net in nets:
        net.eval().cpu()
    rows = cache.rows(held_out=True)
    rows = rows[np.asarray(cache.arrays["future_valid"][rows, -1]) > 0]
    rows = rows[np.random.default_rng(0).permutation(len(rows))[:samples]]
    if len(rows) == 0:
        return 1.0
    nll = np.zeros(len(_TEMPERATURES))
    for begin in range(0, len(rows), 64):
        batch = tensors(cache.batch(rows[begin : begin + 64]))
        goals = marginal.pooled([net(batch, _given(net, batch)) for net in nets])
        logits = goals.logits[:, 0].flatten(1)
        ends = goals.ends()[:, 0]
        chosen, _ = decoding.select(logits.softmax(-1), ends, modes)
        at = ends.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 2))
        nearest = (at - batch["future"][:, -1:]).norm(dim=-1).argmin(1, keepdim=True)
        for row, temperature in enumerate(_TEMPERATURES):
            mass = decoding.mass((logits / temperature).softmax(-1), ends, at)
            nll[row] -= float(mass.gather(1, nearest).clamp_min(1e-4).log().sum())
    return float(_TEMPERATURES[nll.argmin()])
