"""Positions of a car-following driver on each path, given the future of another vehicle.

The Intelligent Driver Model (Treiber, Hennecke, Helbing 2000) on every path: behind the given
vehicle while it reaches into the path, and behind the vehicle that is next ahead on it now. As a
feature it tells networks what braking in time amounts to; they learn how planners and people
differ from it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.anchors import look_up
from deepmf_sumo.deepmf.networks.conditioning import EVERY, Condition, nearest_nodes
from deepmf_sumo.deepmf.networks.paths import NODE_SPACING_M
from deepmf_sumo.scene import DT_S

FOLLOWING: Final = 6
"""Columns of `relations`."""

_SUBSTEPS: Final = 2
_ACCEL_MPS2, _DECEL_MPS2, _HARD_MPS2, _HEADWAY_S, _GAP_M = 1.5, 2.0, 8.0, 1.5, 2.0
"""As `planners.idm.TREIBER`, which predictors cannot import."""
_LENGTH_M, _WIDTH_M, _MARGIN_M = 4.8, 2.0, 0.2
"""Size of both vehicles, and the margin beside the own one that has to be free."""
_SLOW_MPS, _FREE_MPS = 3.0, 12.0
"""Least desired speed, and the desired speed where no limit is known."""
_BESIDE_M, _SAME_M, _FAR_M = 1.8, 3.0, 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class Road:
    """The follower's paths.

    Attributes:
        paths: (B, P, 121, 2). limit_mps: (B, P), 0 where unknown. speed_mps: (B) the follower's.
        agents: (B, P, 8, 8), see `features.Features`.
    """

    paths: Tensor
    limit_mps: Tensor
    speed_mps: Tensor
    agents: Tensor

    @classmethod
    def of(cls, batch: dict[str, Tensor]) -> Self:
        """Of a batch of `features.Features`."""
        return cls(
            paths=batch["paths"],
            limit_mps=batch["path_info"][..., 5],
            speed_mps=batch["motion"][:, 0],
            agents=batch["path_agents"],
        )


def relations(road: Road, along_m: Tensor, given: Condition) -> Tensor:
    """(B, K, P, R, 6) differences of goals, (B, P, R, 16) along at 2 Hz, from the follower.

    The goal's lead at 2, 4, 6, 8 s, and its closeness over all times, on two scales. Always in full
    precision, as `conditioning.relations`.
    """
    with torch.autocast(along_m.device.type, enabled=False):
        driven = followed(road, given)  # (B, K, P, 16)
        off = -_apart(along_m, driven) / driven.shape[-1]
        lead = along_m[..., 3::4].unsqueeze(1) - driven[..., 3::4].unsqueeze(3)
        at = (lead / 10.0).clamp_(-2.0, 2.0)  # (B, K, P, R, 4)
        return torch.cat([at, torch.stack([off.exp(), (off / 4.0).exp_()], -1)], -1)


def _apart(along_m: Tensor, driven: Tensor) -> Tensor:
    """(B, K, P, R) sums of the distances between (B, P, R, 16) and (B, K, P, 16)."""
    if torch.compiler.is_exporting():  # ONNX has no such distance
        return (along_m.unsqueeze(1) - driven.unsqueeze(3)).abs().sum(-1)
    return torch.cdist(along_m, driven.transpose(1, 2), p=1.0).permute(0, 3, 1, 2)


def followed(road: Road, given: Condition) -> Tensor:
    """(B, K, P, 16) distances that the follower drives along each path, at 2 Hz, m."""
    ahead, pace = _ahead(road, given)  # (16 * substeps, 2, B, K, P), (16, 2, B, K, P)
    free = torch.where(road.limit_mps > 0, road.limit_mps, _FREE_MPS).unsqueeze(1)
    start = road.speed_mps.view(-1, 1, 1)
    slowness = 1.0 / torch.maximum(free, start).clamp_min(_SLOW_MPS)  # (B, 1, P)
    parts = ahead, pace, start, slowness
    if torch.compiler.is_exporting():
        return torch.stack(list(_driven(parts, torch)), -1)
    # a thousand small operations: numpy is five times as fast as torch
    driven = np.stack(list(_driven([each.cpu().numpy() for each in parts], np)), -1)
    return torch.from_numpy(driven).to(ahead.device)


def _driven(parts: Sequence[Any], of: Any) -> Iterator[Any]:
    """(B, K, P) distances at 2 Hz, see `followed`; arrays of ``of``, numpy or torch."""
    ahead, pace, start, slowness = parts
    seconds, brisk = EVERY * DT_S / _SUBSTEPS, 0.5 / (_ACCEL_MPS2 * _DECEL_MPS2) ** 0.5
    along = of.zeros_like(ahead[0, 0])
    speed = along + start
    for step in range(len(ahead)):
        gap = ahead[step] - along
        first = of.where(gap[0] < -_LENGTH_M, _FAR_M, gap[0])  # passed: no leader any more
        keep = (speed - pace[step // _SUBSTEPS]) * brisk + _HEADWAY_S
        wanted = (keep * speed).clip(0.0) + _GAP_M
        use = of.maximum(wanted[0] / first.clip(0.1), wanted[1] / gap[1].clip(0.1))
        busy = of.square(speed * slowness)
        gain = _ACCEL_MPS2 * (1.0 - busy * busy - use * use)
        faster = (speed + gain.clip(-_HARD_MPS2) * seconds).clip(0.0)
        along = along + (0.5 * seconds) * (speed + faster)
        speed = faster
        if step % _SUBSTEPS == _SUBSTEPS - 1:
            yield along


def _ahead(road: Road, given: Condition) -> tuple[Tensor, Tensor]:
    """Distances to the tails of two leaders, the given vehicle and the next one, and speeds."""
    place, left, there = _leader(road.paths, given)  # (17, B, K, P)
    tail, pace = _next_ahead(road.agents, place[0], left[0])  # (B, K, P)
    moves = torch.diff(place, dim=0)
    shares = torch.arange(_SUBSTEPS, device=place.device).view(1, -1, 1, 1, 1) / _SUBSTEPS
    met = (place[:-1] - _LENGTH_M).unsqueeze(1) + shares * moves.unsqueeze(1)
    met = met.masked_fill_(~there[:-1].unsqueeze(1), _FAR_M).flatten(0, 1)
    times = torch.arange(len(met), device=place.device).view(-1, 1, 1, 1) / _SUBSTEPS
    rest = tail + pace * (times * (EVERY * DT_S))
    speeds = (moves / (EVERY * DT_S)).clamp_min_(0.0)
    return torch.stack([met, rest], 1), torch.stack([speeds, pace.expand_as(speeds)], 1)


def _leader(paths: Tensor, given: Condition) -> tuple[Tensor, Tensor, Tensor]:
    """(17, B, K, P) the given vehicle at its first step and at 2 Hz: along, left, in the path.

    The first step, 0.1 s ahead, stands for now, because a fast vehicle drives far in half a second.
    """
    moves, turns = given.position_m, given.facing  # (B, K, 80, 2), (B, K, 16, 2)
    other = torch.cat([moves[:, :, :1], moves[:, :, EVERY - 1 :: EVERY]], 2).flatten(1, 2)
    facing = torch.cat([turns[:, :, :1], turns], 2).flatten(1, 2).unsqueeze(1)  # (B, 1, N, 2)
    node = nearest_nodes(paths, other)[1].transpose(1, 2)  # (B, P, N), N = 17 K
    base = node * NODE_SPACING_M
    point, tangent = look_up(paths, base)
    x, y = (other.unsqueeze(1) - point).unbind(-1)
    tangent_x, tangent_y = tangent.unbind(-1)
    left = tangent_x * y - tangent_y * x
    cos = (facing[..., 0] * tangent_x + facing[..., 1] * tangent_y).abs()
    sin = (facing[..., 1] * tangent_x - facing[..., 0] * tangent_y).abs()
    half_width = 0.5 * (_LENGTH_M * sin + _WIDTH_M * cos)
    half_length = 0.5 * (_LENGTH_M * cos + _WIDTH_M * sin)
    there = left.abs() < half_width + 0.5 * _WIDTH_M + _MARGIN_M
    # one length whatever its direction: the nearer end counts
    along = base + tangent_x * x + tangent_y * y + 0.5 * _LENGTH_M - half_length
    shape = (*paths.shape[:2], given.futures, -1)  # (B, P, K, 17)
    return (
        along.view(shape).permute(3, 0, 2, 1),
        left.view(shape).permute(3, 0, 2, 1),
        there.view(shape).permute(3, 0, 2, 1),
    )


def _next_ahead(agents: Tensor, place_m: Tensor, left_m: Tensor) -> tuple[Tensor, Tensor]:
    """(B, K, P) gap to and speed of the next vehicle ahead on each path, except the given one."""
    along, left, speed = (agents[..., row].unsqueeze(1) for row in range(3))
    length, there = agents[..., 6].unsqueeze(1), agents[..., 7].unsqueeze(1)
    apart = (along - place_m.unsqueeze(-1)).abs() + (left - left_m.unsqueeze(-1)).abs()
    ahead = (there > 0) & (left.abs() < _BESIDE_M) & (along > 1.0) & (apart > _SAME_M)
    gaps = torch.where(ahead, along - 0.5 * (length + _LENGTH_M), _FAR_M)
    gap, row = gaps.min(-1)
    pace = speed.expand_as(gaps).gather(-1, row.unsqueeze(-1)).squeeze(-1)
    return gap, pace.clamp_min(0.0)
