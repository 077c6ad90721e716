"""Anchors (goals) on the paths ahead of a vehicle, and their features.

An anchor is a path and a speed profile, in the vehicle's frame. All arguments are tensors; the same
code serves training and prediction. P paths, R profiles, S times.
"""

from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.paths import NODE_SPACING_M
from deepmf_sumo.scene import DT_S, FUTURE_STEPS

BRAKING: Final = (
    (3.0, 8.0),
    (5.0, 8.0),
    (8.0, 8.0),
    (3.0, 1.5),
    (5.0, 1.5),
    (8.0, 1.5),
)
"""Deceleration, m/s2, and duration, s, of braking profiles too rare in data to form clusters.

Attacked drivers brake like this: to a stop, or briefly, and then keep the remaining speed.
"""
START_SPEEDS_MPS: Final = (0.0, 1.0, 2.0, 3.5, 5.0, 7.0, 9.0, 11.0, 13.5, 16.0, 20.0, 25.0, 30.0)


def profiles_at(table: Tensor, speed_mps: Tensor) -> Tensor:
    """Distances driven (B, R, 80) at start speeds (B); table (13, R, 80) of s(t) - v0 t."""
    knots = table.new_tensor(START_SPEEDS_MPS)
    clamped = speed_mps.clamp(0.0, START_SPEEDS_MPS[-1] - 1e-3)
    low = (clamped.unsqueeze(-1) >= knots).sum(-1) - 1  # ONNX has no search in sorted tables
    share = ((clamped - knots[low]) / (knots[low + 1] - knots[low])).view(-1, 1, 1)
    relative = (1 - share) * table[low] + share * table[low + 1]
    time = torch.arange(1, FUTURE_STEPS + 1, device=table.device) * DT_S
    distance = relative + speed_mps.view(-1, 1, 1) * time
    return _never_back(distance.clamp_min(0.0))


def _never_back(distance: Tensor) -> Tensor:
    """(..., 80) the largest so far, as `torch.cummax`, which ONNX lacks."""
    reach = 1
    while reach < distance.shape[-1]:
        before = distance[..., :-reach]
        rest = torch.maximum(distance[..., reach:], before)
        distance = torch.cat([distance[..., :reach], rest], -1)
        reach *= 2
    return distance


def braking(speeds_mps: Tensor) -> Tensor:
    """(V, 6, 80) s(t) - v0 t of `BRAKING` at start speeds (V)."""
    time = torch.arange(1, FUTURE_STEPS + 1) * DT_S
    start = speeds_mps.view(-1, 1, 1)
    rate, seconds = torch.tensor(BRAKING).view(1, -1, 2, 1).unbind(2)
    busy = torch.minimum(torch.minimum(time, seconds), start / rate)
    left = (start - rate * seconds).clamp_min(0.0)
    driven = start * busy - rate * busy**2 / 2 + left * (time - seconds).clamp_min(0.0)
    return driven - start * time


def look_up(paths: Tensor, along_m: Tensor) -> tuple[Tensor, Tensor]:
    """Points and unit tangents (B, P, N, 2) of paths (B, P, 121, 2) at distances (B, P, N).

    Straight on past the last node. Tangents change linearly between nodes.
    """
    numbers = torch.arange(paths.shape[0] * paths.shape[1], device=paths.device)
    return look_up_on(paths.flatten(0, 1), numbers.view(*paths.shape[:2], 1), along_m)


def look_up_on(paths: Tensor, path: Tensor, along_m: Tensor) -> tuple[Tensor, Tensor]:
    """As `look_up`, (..., 2) on the path (...) of paths (P, 121, 2) at each distance (...)."""
    line = paths.movedim(-1, 0)  # x and y apart, which is twice as fast
    step = torch.diff(line, dim=2)
    after = torch.cat([step[:, :, 1:], step[:, :, -1:]], 2)
    segments = torch.cat([line[:, :, :-1], step, after]).flatten(1)  # (6, P * 120)
    place = along_m / NODE_SPACING_M
    base = place.floor().clamp(0, step.shape[2] - 1)
    share = place - base
    row = base.long() + path * step.shape[2]
    found = segments.index_select(1, row.flatten()).view(-1, *along_m.shape)
    start, here, after = found[0:2], found[2:4], found[4:6]
    tangent = torch.lerp(here, after, (share - 0.5).clamp(0.0, 0.5))
    square = tangent[0] ** 2 + tangent[1] ** 2
    tangent = tangent / square.clamp_min(1e-12).sqrt()  # differentiable where it is zero
    return (start + share * here).movedim(0, -1), tangent.movedim(0, -1)


def curvature(paths: Tensor) -> Tensor:
    """(B, P, 119) 1/m at the inner nodes."""
    step = (paths[:, :, 1:] - paths[:, :, :-1]) / NODE_SPACING_M
    cross = step[..., :-1, 0] * step[..., 1:, 1] - step[..., :-1, 1] * step[..., 1:, 0]
    return cross / NODE_SPACING_M


def placed(paths: Tensor, along_m: Tensor, left_m: Tensor) -> tuple[Tensor, Tensor]:
    """Positions (B, P, ..., 2) at path coordinates (B, P, ...), and the path's tangents there."""
    size = paths.shape[:2]
    numbers = torch.arange(size.numel(), device=paths.device)
    path = numbers.view(*size, *[1] * (along_m.ndim - 2))
    return placed_on(paths.flatten(0, 1), path, along_m, left_m)


def placed_on(
    paths: Tensor, path: Tensor, along_m: Tensor, left_m: Tensor
) -> tuple[Tensor, Tensor]:
    """As `placed`, (..., 2) on the path (...) of paths (P, 121, 2), with coordinates (...)."""
    point, tangent = look_up_on(paths, path, along_m)
    normal = torch.stack([-tangent[..., 1], tangent[..., 0]]).movedim(0, -1)
    return point + left_m.unsqueeze(-1) * normal, tangent


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
    bend = curvature(paths).gather(2, node.flatten(2)).view_as(node)
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
