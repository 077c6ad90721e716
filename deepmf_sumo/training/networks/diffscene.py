"""Training of DiffScene's diffusion model: its components, its loss, its errors when held out."""

from typing import Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.baselines.priors.diffscene import (
    COMPONENTS,
    KNOTS,
    DiffusionPrior,
    Seen,
    at_constant_speed,
)
from deepmf_sumo.errors import RunError
from deepmf_sumo.training.fit.loop import Loss, in_batches
from deepmf_sumo.training.samples.dataset import Dataset

LEAST_KNOWN: Final = 10
"""Knots of 16 that a future must have; the rest continues at the last velocity."""
SAMPLES: Final = 16
STEPS: Final = 20
_MEMBERS: Final = 8
"""Vehicles of a graph that are trained on, to save time: messages do not depend on the number."""
_LEVEL_MEAN: Final = -0.5
_LEVEL_SPREAD: Final = 1.4
"""Of the logarithm of the noise: EDM's, for data of unit variance."""
_STANDING: Final = 0.2
"""Weight of stationary vehicles, which are the majority and teach little."""
_MOVING_M: Final = 2.0
_HELD_OUT: Final = 256
_FITTED: Final = 4096


def fit_components(net: DiffusionPrior, dataset: Dataset, seed: int) -> None:
    """Set the principal components of the training samples. Raises RunError with too few."""
    rows = dataset.rows(held_out=False)
    if len(rows) > _FITTED:
        rows = np.sort(np.random.default_rng([seed, 3]).choice(rows, _FITTED, replace=False))
    moved = []
    for batch in in_batches(dataset, rows, 256):
        position, weight = futures(batch)
        offset = (position - at_constant_speed(batch["motion"][..., 0])).flatten(-2)
        moved.append(offset[weight == 1])
    known = torch.cat(moved).double()
    if len(known) < 2 * KNOTS:
        raise RunError(f"Only {len(known)} vehicles move in the recordings; give more of them.")
    mean = known.mean(0)
    _, scale, basis = torch.linalg.svd(known - mean, full_matrices=False)
    spread = scale[:COMPONENTS] / len(known) ** 0.5
    net.mean.copy_(mean)
    net.basis.copy_(spread.clamp_min(1e-3).unsqueeze(-1) * basis[:COMPONENTS])


def loss_of(net: DiffusionPrior) -> Loss:
    """EDM's: squared errors of the clean components, weighted by what each noise level allows."""

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        batch = {name: values[:, :_MEMBERS] for name, values in batch.items()}
        position, weight = futures(batch)
        clean = net.components(position, batch["motion"][..., 0])
        draw = torch.randn(weight.shape, generator=generator).to(clean.device)
        level = (_LEVEL_MEAN + _LEVEL_SPREAD * draw).exp()
        noise = torch.randn(clean.shape, generator=generator).to(clean.device)
        noisy = clean + noise * level.unsqueeze(-1)
        error = (net.denoised(noisy, level, net.encode(batch)) - clean).square().mean(-1)
        share = (level**2 + 1) / level**2
        # A sample's only known futures may be those of vehicles beyond the members.
        total: Tensor = (error * share * weight).sum() / weight.sum().clamp_min(_STANDING)
        return total

    return loss


def futures(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Positions (B, N, 16, 2), continued at the last velocity, and weights (B, N) of vehicles.

    0: not known long enough, or with gaps; 0.2: stationary; 1: the others.
    """
    position, known = batch["future"][..., :2], batch["future"][..., 3]
    count = known.sum(-1).long()
    whole = (known[..., 1:] <= known[..., :-1]).all(-1) & (count >= LEAST_KNOWN)
    last = (count - 1).clamp_min(1)
    at = last[..., None, None].expand(*last.shape, 1, 2)
    velocity = position.gather(-2, at) - position.gather(-2, at - 1)
    beyond = (torch.arange(KNOTS, device=last.device) - last.unsqueeze(-1)).clamp_min(0)
    filled = torch.where(
        beyond.unsqueeze(-1) > 0,
        position.gather(-2, at) + beyond.unsqueeze(-1) * velocity,
        position,
    )
    way = filled.norm(dim=-1).amax(-1)
    weight = torch.where(way > _MOVING_M, 1.0, _STANDING) * whole
    return filled * whole[..., None, None], weight


@torch.no_grad()
def held_out_errors(net: DiffusionPrior, dataset: Dataset) -> dict[str, float]:
    """Errors of 16 unguided samples of moving vehicles at 8 s and on the way, metres.

    ``components_ade``: of the true motion's own components, the least that any sample could have.
    """
    rows = dataset.rows(held_out=True)
    if len(rows) > _HELD_OUT:
        rows = np.sort(np.random.default_rng(0).choice(rows, _HELD_OUT, replace=False))
    generator, found = torch.Generator().manual_seed(0), []
    for batch in in_batches(dataset, rows, 32):
        position, weight = futures(batch)
        whole = (weight == 1) & (batch["future"][..., 3].sum(-1) == KNOTS)
        seen = Seen(*(part[whole] for part in net.encode(batch)))
        found.append(_errors(net, seen, position[whole], batch["motion"][..., 0][whole], generator))
    each = torch.cat(found) if found else torch.zeros(0, 3)
    if not len(each):
        return {}
    names = ("components_ade", f"min_ade_{SAMPLES}", f"min_fde_{SAMPLES}")
    means = {name: round(float(value), 3) for name, value in zip(names, each.mean(0), strict=True)}
    return {**means, "vehicles": len(each)}


def _errors(
    net: DiffusionPrior, seen: Seen, true: Tensor, speed: Tensor, generator: torch.Generator
) -> Tensor:
    """(vehicles, 3) the three errors."""
    kept = net.positions(net.components(true, speed), speed)
    away = []
    for _ in range(SAMPLES):
        noise = torch.randn(len(true), COMPONENTS, generator=generator)
        drawn = net.sample(seen, noise, STEPS, torch.zeros_like, reach=0.0)
        away.append((net.positions(drawn, speed) - true).norm(dim=-1))
    apart = torch.stack(away)
    return torch.stack(
        [(kept - true).norm(dim=-1).mean(-1), apart.mean(-1).amin(0), apart[..., -1].amin(0)], -1
    )
