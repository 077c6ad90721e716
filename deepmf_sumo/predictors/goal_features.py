"""What a dense goal looks like before any network: distances, speeds, gaps, stop line, bend."""

from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.predictors import anchors
from deepmf_sumo.predictors.paths import NODE_SPACING_M

GOAL: Final = 26
"""Columns of `goal_features`."""


def goal_features(batch: dict[str, Tensor], along: Tensor, log_prior: Tensor) -> Tensor:
    """(B, P, R, 26) distances and speeds each second, gaps, stop line, bend, prior."""
    paths, info = batch["paths"], batch["path_info"]
    seconds = along[..., 9::10]  # (B, P, R, 8) at 1..8 s
    speed = torch.diff(along, dim=-1)[..., 8::10] * 10.0
    stop = seconds[..., [3, 7]] - info[..., 6, None, None]
    over = (stop / 10.0).clamp(-2.0, 2.0) * (info[..., 8, None, None] + info[..., 9, None, None])
    node = (seconds / NODE_SPACING_M).long().clamp(0, paths.shape[2] - 3)
    bend = anchors.curvature(paths).gather(2, node.flatten(2)).view_as(node)
    sideways = (bend.abs() * speed**2).amax(-1, keepdim=True)
    length = (seconds[..., 7:] - info[..., 4, None, None]) / 20.0
    limit = info[..., 5, None, None]
    fast = ((speed.amax(-1, keepdim=True) - limit) / 10.0) * (limit > 0)
    start = batch["motion"][:, 0].view(-1, 1, 1, 1).expand_as(fast) / 15.0
    columns = [
        seconds / 50.0,
        speed / 15.0,
        _gaps(batch["path_agents"], seconds),
        over,
        (sideways / 4.0).clamp_max(3.0),
        length.clamp(-3.0, 3.0),
        fast.clamp(-3.0, 3.0),
        log_prior[:, None, :, None].expand_as(fast),
        start,
    ]
    return torch.cat(columns, -1)


def _gaps(others: Tensor, seconds: Tensor) -> Tensor:
    """(B, P, R, 3) gap to the vehicle ahead on the path at 2, 4, 8 s, if it keeps its speed."""
    ahead = (others[..., 1].abs() < 2.0) & (others[..., 0] > 0.5) & (others[..., 7] > 0)
    times = seconds.new_tensor([2.0, 4.0, 8.0])
    tail = others[..., 0:1] - 0.5 * others[..., 6:7] + others[..., 2:3] * times  # (B, P, 8, 3)
    tail = tail.masked_fill(~ahead.unsqueeze(-1), 1e3).amin(2)  # (B, P, 3)
    gap = tail.unsqueeze(2) - seconds[..., [1, 3, 7]]
    return (gap / 20.0).clamp(-1.0, 3.0)
