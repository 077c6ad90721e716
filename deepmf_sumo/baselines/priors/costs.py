"""Differentiable costs of motions: vehicles that overlap, and vehicles that leave the road."""

from typing import Final

import torch
from torch import Tensor

DISCS: Final = 3


def disc_centres(position: Tensor, heading: Tensor, size: Tensor, count: int = DISCS) -> Tensor:
    """(..., D, 2) centres of D discs along boxes; size (..., 2), position (..., 2)."""
    reach = ((size[..., 0] - size[..., 1]) / 2).clamp_min(0.0)
    along = torch.linspace(-1.0, 1.0, count, device=position.device) * reach.unsqueeze(-1)
    direction = torch.stack([heading.cos(), heading.sin()], -1)
    return position.unsqueeze(-2) + along.unsqueeze(-1) * direction.unsqueeze(-2)


def disc_radius(size: Tensor) -> Tensor:
    """(...) radius of a box's discs: they reach its front and rear, and stick out at the sides.

    Not zero where there is no vehicle, so that nothing is divided by it.
    """
    return (size[..., 1] / 2 * 1.1).clamp_min(0.1)


def overlap(first: Tensor, second: Tensor, radius_first: Tensor, radius_second: Tensor) -> Tensor:
    """(...) how deep two groups of discs (..., D, 2) overlap: 0 apart, 1 on one place."""
    return (1.0 - apart(first, second) / (radius_first + radius_second)).clamp_min(0.0)


def apart(first: Tensor, second: Tensor) -> Tensor:
    """(...) least distance between the centres of two groups of discs (..., D, 2)."""
    square = (first.unsqueeze(-2) - second.unsqueeze(-3)).square().sum(-1)
    return (square.flatten(-2).amin(-1) + 1e-6).sqrt()


def mutual_overlap(position: Tensor, heading: Tensor, size: Tensor, there: Tensor) -> Tensor:
    """(B, N, T) sum of the overlaps of each vehicle with all others at the same time.

    Position (B, N, T, 2) in one frame, heading (B, N, T), size (B, N, 2), there (B, N).
    """
    discs = disc_centres(position, heading, size.unsqueeze(2))
    radius = disc_radius(size).unsqueeze(2)
    depth = overlap(
        discs.unsqueeze(2), discs.unsqueeze(1), radius.unsqueeze(2), radius.unsqueeze(1)
    )
    others = ~torch.eye(there.shape[1], dtype=torch.bool, device=there.device)
    pairs = there.unsqueeze(1) & there.unsqueeze(2) & others
    return (depth * pairs.unsqueeze(-1)).sum(2)


def off_road(points: Tensor, road: Tensor, allowed: Tensor | float) -> Tensor:
    """(..., T) metres that points (..., T, 2) are farther than allowed from points on lanes (Q, 2).

    With lanes given for each row, ``road`` is (..., Q, 2).
    """
    near = torch.cdist(points, road, compute_mode="donot_use_mm_for_euclid_dist").amin(-1)
    return (near - allowed).clamp_min(0.0)
