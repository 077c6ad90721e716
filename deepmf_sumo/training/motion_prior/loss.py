"""What the motion prior minimises: reconstruction, divergence, overlaps, leaving the road."""

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from deepmf_sumo.predictors.strive import costs
from deepmf_sumo.predictors.strive.motion_prior import Context, Gaussian, MotionPrior, Motions
from deepmf_sumo.training.schedule import Loss

DIVERGENCE: Final = 0.02
"""Weight of the divergence; the reconstruction's scale is metres."""
_FIRST_DIVERGENCE: Final = 0.1
"""Share of it at the start: latents learn to say something before they learn to say little."""
_ANNEALED: Final = 300
"""Batches until all of it counts."""
_IMAGINED: Final = 4
_OVERLAP: Final = 0.5
_OFF_ROAD: Final = 0.05
_OFF_ROAD_M: Final = 4.0
"""Farther from all of its ways a vehicle is beside the road."""
_HEADING: Final = 2.0
_MEMBERS: Final = 8
"""Vehicles of a graph that are trained on, for time's sake: messages do not count them."""
_STANDING: Final = 0.2
"""Weight of vehicles that stand: most do, and there is little to learn from them."""
_STANDING_M: Final = 2.0


def loss_of(net: MotionPrior) -> Loss:
    """The variational bound on what happened, and costs of what the prior itself makes happen."""

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
    """Share of the divergence; all of it in evaluation."""
    if not net.training:
        return 1.0
    net.seen += 1
    return min(1.0, _FIRST_DIVERGENCE + float(net.seen) / _ANNEALED)


def _known(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """(B, N, 16) steps to learn from, and (B, N) weights of the vehicles."""
    known = batch["future"][..., 3]
    way = (batch["future"][..., :2].norm(dim=-1) * known).amax(-1)
    weight = torch.where(way > _STANDING_M, 1.0, _STANDING) * (known.sum(-1) > 0)
    return known, weight


def _error(motions: Motions, future: Tensor, known: Tensor) -> Tensor:
    """(B, N) mean error over the known steps."""
    away = ((motions.position - future[..., :2]).square().sum(-1) + 1e-6).sqrt()
    far = functional.smooth_l1_loss(away, torch.zeros_like(away), reduction="none")
    turned = 1 - (motions.heading - future[..., 2]).cos()
    error = (far + _HEADING * turned) * known
    return error.sum(-1) / known.sum(-1).clamp_min(1.0)


def _plausibility(
    net: MotionPrior, batch: dict[str, Tensor], context: Context, generator: torch.Generator
) -> Tensor:
    """Overlaps and metres off the road of samples of the prior, in the mean over vehicles and time.

    In a quarter of the batch, for time's sake.
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
    # Boxes that overlap already, as recorded ones do now and then, are not the motion's fault.
    now = costs.mutual_overlap(
        graph["pose"][:, :, None, :2], graph["pose"][:, :, 2:], graph["size"], there
    )
    depth = depth * (now == 0)
    lanes = graph["way_info"][..., 0] > graph["way_info"][..., 1]  # but for straight on
    road = (graph["ways"] * lanes[..., None, None]).flatten(2, 3)
    away = costs.off_road(motions.position, road, _OFF_ROAD_M) * lanes.any(-1, keepdim=True)
    count = there.sum() * depth.shape[-1]
    return (_OVERLAP * depth.sum() + _OFF_ROAD * away.sum()) / count
