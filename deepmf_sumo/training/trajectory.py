"""Training of the marginal and the conditional network."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deepmf_sumo.predictors import condition, selection
from deepmf_sumo.predictors.condition import Condition
from deepmf_sumo.predictors.densetnt import DenseTNT
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.training import losses, profiles
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.loop import Loss, tensors

_GIVEN = 0.75
"""Share of samples whose partner's future is given; half of them disturbed."""
_NEAR_M = 15.0
"""The conditional network learns from pairs whose ways come as near as this, at any two times."""
CONDITION_LAYERS = ("given_line", "target_to_given", "film", "goal_met")
"""Begin anew where the conditional network begins from the marginal one."""
_WARP, _DRIFT_M = 0.04, 0.4
"""A given future is disturbed as a prediction errs: in its pace, and sideways at 8 s."""
_TEMPERATURES = np.round(np.arange(0.7, 3.01, 0.1), 1)


def start(net: DenseTNT, cache: Cache, seed: int) -> None:
    """Fit the speed profiles on the samples that are trained on, and put them into the network."""
    rows = cache.rows(held_out=False)
    known = rows[np.asarray(cache.arrays["future_valid"][rows]).all(1)]
    table = profiles.fit(
        np.asarray(cache.arrays["driven"][known], float),
        np.asarray(cache.arrays["motion"][known, 0], float),
        np.random.default_rng([seed, 1]),
    )
    net.profiles.copy_(torch.from_numpy(table.relative_m))
    net.prior.copy_(torch.from_numpy(table.log_prior))


def interacting(cache: Cache) -> NDArray[np.bool_]:
    """(N) samples with a partner whose way comes near."""
    near = np.zeros(len(cache.scene), bool)
    for begin in range(0, len(near), 1024):
        rows = slice(begin, begin + 1024)
        own = np.asarray(cache.arrays["future"][rows, 4::5])
        other = np.asarray(cache.arrays["partner"][rows, 4::5, :2])
        apart = np.linalg.norm(own[:, :, None] - other[:, None], axis=-1)  # (., 16, 16)
        unknown = np.asarray(cache.arrays["future_valid"][rows, 4::5]) == 0
        least = np.where(unknown[:, :, None], np.inf, apart).min(axis=(1, 2))
        near[rows] = (least < _NEAR_M) & (np.asarray(cache.arrays["partner_known"][rows]) > 0)
    return near


def loss_of(net: DenseTNT) -> Loss:
    """Mixture likelihood; a conditional network is given most of the partners' futures."""

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        given = partner_condition(batch, net.preset, generator) if net.conditional else None
        return losses.mixture(net, net(batch, given), batch).mean()

    return loss


def partner_condition(
    batch: dict[str, Tensor],
    preset: Preset,
    generator: torch.Generator | None,
) -> Condition:
    """The partner's future as condition; with a generator it is dropped and disturbed at random."""
    position, heading = batch["partner"][..., :2], batch["partner"][..., 2]
    given = batch["partner_known"]
    if generator is not None:
        keep = torch.rand(len(given), generator=generator) < _GIVEN
        given = given * keep.to(given.device)
        position = _disturbed(position, generator)
    return condition.encode(position[:, None], heading[:, None], given[:, None], preset)


def _disturbed(position: Tensor, generator: torch.Generator) -> Tensor:
    """Half of the futures (B, 80, 2) run through faster or slower, and drift sideways."""
    batch, steps, _ = position.shape
    noise = torch.randn(batch, 2, generator=generator)
    noise = (noise * (torch.rand(batch, 1, generator=generator) < 0.5)).to(position.device)
    time = torch.arange(steps, device=position.device, dtype=position.dtype)
    place = (time * (1 + _WARP * noise[:, :1])).clamp(0, steps - 1.001)
    base = place.floor().long()
    share = (place - base).unsqueeze(-1)
    index = base.unsqueeze(-1).expand(-1, -1, 2)
    moved = torch.lerp(position.gather(1, index), position.gather(1, index + 1), share)
    way = moved[:, -1] - moved[:, 0]
    left = torch.stack([-way[:, 1], way[:, 0]], -1) / way.norm(dim=-1, keepdim=True).clamp_min(1.0)
    drift = _DRIFT_M * noise[:, 1:] * (time / steps)
    disturbed: Tensor = moved + drift.unsqueeze(-1) * left.unsqueeze(1)
    return disturbed


@torch.inference_mode()
def fit_temperature(net: DenseTNT, cache: Cache, modes: int, samples: int = 600) -> float:
    """The temperature at which modes nearest to true ends are likeliest, on held-out scenes."""
    net.eval().cpu()
    rows = cache.rows(held_out=True)
    rows = rows[np.asarray(cache.arrays["future_valid"][rows, -1]) > 0]
    rows = rows[np.random.default_rng(0).permutation(len(rows))[:samples]]
    if len(rows) == 0:
        return 1.0
    nll = np.zeros(len(_TEMPERATURES))
    for begin in range(0, len(rows), 64):
        batch = tensors(cache.batch(rows[begin : begin + 64]))
        given = partner_condition(batch, net.preset, None) if net.conditional else None
        goals = net(batch, given)
        logits = goals.logits[:, 0].flatten(1)
        ends = goals.ends()[:, 0]
        chosen, _ = selection.select(logits.softmax(-1), ends, modes)
        at = ends.gather(1, chosen.unsqueeze(-1).expand(-1, -1, 2))
        nearest = (at - batch["future"][:, -1:]).norm(dim=-1).argmin(1, keepdim=True)
        for row, temperature in enumerate(_TEMPERATURES):
            mass = selection.mass((logits / temperature).softmax(-1), ends, at)
            nll[row] -= float(mass.gather(1, nearest).clamp_min(1e-4).log().sum())
    return float(_TEMPERATURES[nll.argmin()])
