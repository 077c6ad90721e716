"""How far the motion prior is from what happened: reconstructed, and at the best of its samples."""

from collections.abc import Iterable
from typing import Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors.strive.bicycle import SUBSTEPS
from deepmf_sumo.predictors.strive.motion_prior import Context, MotionPrior, Motions
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.schedule import tensors

SAMPLES: Final = 16
_HELD_OUT: Final = 128
"""Samples looked at, for time's sake."""
_BATCH: Final = 32
_MOVING_M: Final = 2.0
"""Who moves less is easy to predict, and not counted."""


def of_held_out(net: MotionPrior, cache: Cache) -> dict[str, float]:
    """`errors` on samples that were kept from training, always the same ones."""
    rows = cache.rows(held_out=True)
    if len(rows) > _HELD_OUT:
        rows = np.sort(np.random.default_rng(0).choice(rows, _HELD_OUT, replace=False))
    parts = np.array_split(rows, max(len(rows) // _BATCH, 1)) if len(rows) else []
    batches = (tensors(cache.batch(part)) for part in parts)
    return errors(net, batches, torch.Generator().manual_seed(0))


@torch.inference_mode()
def errors(
    net: MotionPrior, batches: Iterable[dict[str, Tensor]], generator: torch.Generator
) -> dict[str, float]:
    """Mean displacement errors of moving vehicles over the known steps of the next 8 s, metres.

    ``reconstruction_ade`` of the posterior's mean, ``mean_ade`` of the prior's mean, ``min_ade_16``
    of the best of 16 samples of the prior, ``min_fde_16`` of the best last known position; and the
    number of ``vehicles``. Empty where nobody moves.
    """
    net.eval()
    rows: list[Tensor] = []
    for batch in batches:
        context = net.encode(batch)
        posterior = net.posterior(batch, context, batch["future"]).mean
        rows.append(_of_batch(net, batch, context, posterior, generator))
    found = torch.cat(rows) if rows else torch.zeros(0, 4)
    if not len(found):
        return {}
    names = ("reconstruction_ade", "mean_ade", f"min_ade_{SAMPLES}", f"min_fde_{SAMPLES}")
    means = {name: round(float(value), 3) for name, value in zip(names, found.mean(0), strict=True)}
    return {**means, "vehicles": len(found)}


def _of_batch(
    net: MotionPrior,
    batch: dict[str, Tensor],
    context: Context,
    posterior: Tensor,
    generator: torch.Generator,
) -> Tensor:
    """(vehicles, 4) the four errors of those that move."""
    known = batch["future"][..., 3]
    last = (torch.arange(known.shape[-1]) * known).amax(-1, keepdim=True).long()

    def mean(distance: Tensor) -> Tensor:
        return (distance * known).sum(-1) / known.sum(-1).clamp_min(1.0)

    least, least_at_last = (
        torch.full(last.shape[:2], torch.inf),
        torch.full(last.shape[:2], torch.inf),
    )
    for _ in range(SAMPLES):
        latent = context.prior.draw(torch.randn(posterior.shape, generator=generator))
        distance = _distances(net.decode(batch, context, latent), batch)
        least = torch.minimum(least, mean(distance))
        least_at_last = torch.minimum(least_at_last, distance.gather(-1, last).squeeze(-1))
    reconstructed = mean(_distances(net.decode(batch, context, posterior), batch))
    central = mean(_distances(net.decode(batch, context, context.prior.mean), batch))
    moves = (batch["future"][..., :2].norm(dim=-1) * known).amax(-1) > _MOVING_M
    return torch.stack([reconstructed, central, least, least_at_last], dim=-1)[moves]


def _distances(motions: Motions, batch: dict[str, Tensor]) -> Tensor:
    """(B, N, 16) metres from the futures, every 0.5 s."""
    position = motions.position[:, :, SUBSTEPS - 1 :: SUBSTEPS]
    distance: Tensor = (position - batch["future"][..., :2]).norm(dim=-1)
    return distance
