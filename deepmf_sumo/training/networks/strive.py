"""Training of STRIVE's motion prior: its loss, and its errors on held-out samples."""

from collections.abc import Iterable
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepmf_sumo.baselines.priors import costs
from deepmf_sumo.baselines.priors.bicycle import SUBSTEPS
from deepmf_sumo.baselines.priors.strive import Context, DecodedMotions, Gaussian, MotionPrior
from deepmf_sumo.training.fit.loop import Loss, tensors
from deepmf_sumo.training.samples.dataset import Dataset

DIVERGENCE: Final = 0.02
"""Weight of the divergence; the reconstruction error is in metres."""
_FIRST_DIVERGENCE: Final = 0.1
"""Share of that weight at the start, so that latents become informative first."""
_ANNEALED: Final = 300
"""Batches until the full weight."""
_IMAGINED: Final = 4
_OVERLAP: Final = 0.5
_OFF_ROAD: Final = 0.05
_OFF_ROAD_M: Final = 4.0
"""A vehicle farther from all of its paths is off the road."""
_HEADING: Final = 2.0
_MEMBERS: Final = 8
"""Vehicles of a graph that are trained on, to save time: messages do not depend on the number."""
_STANDING: Final = 0.2
"""Weight of stationary vehicles, which are the majority and teach little."""
_STANDING_M: Final = 2.0
SAMPLES: Final = 16
_HELD_OUT: Final = 128
"""Number of samples that are measured, to save time."""
_BATCH: Final = 32
_MOVING_M: Final = 2.0
"""Vehicles that move less are easy to predict and are not counted."""


def loss_of(net: MotionPrior) -> Loss:
    """The variational bound of the recorded motion, and costs of samples of the prior."""

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        batch = {name: values[:, :_MEMBERS] for name, values in batch.items()}
        context = net.encode(batch)
        posterior = net.posterior(batch, context, batch["future"])
        noise = torch.randn(posterior.mean.shape, generator=generator).to(posterior.mean.device)
        motions = net.decode(batch, context, posterior.draw(noise)).knots()
        known, weight = _known(batch)
        # A sample's only known futures may be those of vehicles beyond the members.
        count = weight.sum().clamp_min(_STANDING)
        error = (_error(motions, batch["future"], known) * weight).sum() / count
        divergence = (posterior.divergence(context.prior) * weight).sum() / count
        imagined = _plausibility(net, batch, context, generator)
        total: Tensor = error + DIVERGENCE * _annealed(net) * divergence + imagined
        return total

    return loss


def _annealed(net: MotionPrior) -> float:
    """Share of the divergence's weight; 1 in evaluation."""
    if not net.training:
        return 1.0
    net.seen += 1
    return min(1.0, _FIRST_DIVERGENCE + float(net.seen) / _ANNEALED)


def _known(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """(B, N, 16) known steps, and (B, N) weights of the vehicles."""
    known = batch["future"][..., 3]
    way = (batch["future"][..., :2].norm(dim=-1) * known).amax(-1)
    weight = torch.where(way > _STANDING_M, 1.0, _STANDING) * (known.sum(-1) > 0)
    return known, weight


def _error(motions: DecodedMotions, future: Tensor, known: Tensor) -> Tensor:
    """(B, N) mean error over the known steps."""
    away = ((motions.position - future[..., :2]).square().sum(-1) + 1e-6).sqrt()
    far = functional.smooth_l1_loss(away, torch.zeros_like(away), reduction="none")
    turned = 1 - (motions.heading - future[..., 2]).cos()
    error = (far + _HEADING * turned) * known
    return error.sum(-1) / known.sum(-1).clamp_min(1.0)


def _plausibility(
    net: MotionPrior, batch: dict[str, Tensor], context: Context, generator: torch.Generator
) -> Tensor:
    """Overlap and distance off the road of samples of the prior, mean over vehicles and time.

    Only a quarter of the batch is used, to save time.
    """
    part = slice(None, None, _IMAGINED)
    graph = {name: values[part] for name, values in batch.items()}
    context = Context(
        context.nodes[part], context.keys[part], Gaussian(*(each[part] for each in context.prior))
    )
    noise = torch.randn(context.prior.mean.shape, generator=generator)
    latent = context.prior.draw(noise.to(context.prior.mean.device))
    motions = net.decode(graph, context, latent).knots()
    there = graph["kind"][..., 2] > 0
    placed = motions.placed(graph)
    depth = costs.mutual_overlap(placed.position, placed.heading, graph["size"], there)
    # Recorded boxes sometimes overlap already; the predicted motion does not cause that.
    now = costs.mutual_overlap(
        graph["pose"][:, :, None, :2], graph["pose"][:, :, 2:], graph["size"], there
    )
    depth = depth * (now == 0)
    lanes = graph["way_info"][..., 0] > graph["way_info"][..., 1]  # without the straight one
    road = (graph["ways"] * lanes[..., None, None]).flatten(2, 3)
    away = costs.off_road(motions.position, road, _OFF_ROAD_M) * lanes.any(-1, keepdim=True)
    count = there.sum() * depth.shape[-1]
    return (_OVERLAP * depth.sum() + _OFF_ROAD * away.sum()) / count


def held_out_errors(net: MotionPrior, dataset: Dataset) -> dict[str, float]:
    """`errors` on the same held-out samples each time."""
    rows = dataset.rows(held_out=True)
    if len(rows) > _HELD_OUT:
        rows = np.sort(np.random.default_rng(0).choice(rows, _HELD_OUT, replace=False))
    parts = np.array_split(rows, max(len(rows) // _BATCH, 1)) if len(rows) else []
    batches = (tensors(dataset.batch(part)) for part in parts)
    return errors(net, batches, torch.Generator().manual_seed(0))


@torch.inference_mode()
def errors(
    net: MotionPrior, batches: Iterable[dict[str, Tensor]], generator: torch.Generator
) -> dict[str, float]:
    """Mean displacement errors of moving vehicles over the known steps of the next 8 s, metres.

    ``reconstruction_ade`` of the posterior's mean, ``mean_ade`` of the prior's mean, ``min_ade_16``
    of the best of 16 samples of the prior, ``min_fde_16`` of the best last known position; and the
    number of ``vehicles``. Empty if no vehicle moves.
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
    """(vehicles, 4) the four errors of moving vehicles."""
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


def _distances(motions: DecodedMotions, batch: dict[str, Tensor]) -> Tensor:
    """(B, N, 16) metres from the futures, every 0.5 s."""
    position = motions.position[:, :, SUBSTEPS - 1 :: SUBSTEPS]
    distance: Tensor = (position - batch["future"][..., :2]).norm(dim=-1)
    return distance
