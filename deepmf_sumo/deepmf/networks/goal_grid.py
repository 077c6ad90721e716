"""Dense goals (Gu et al. 2021, "DenseTNT", section 3.2): places where a vehicle may be in 8 s.

They lie on a grid of 1 m along and beside the paths ahead. Each goal has the timing of a constant
acceleration, or of braking to a stop, that ends there; the network completes it. Shapes: B scenes,
P paths, R goals on each, S stations.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.anchors import look_up, placed
from deepmf_sumo.deepmf.networks.paths import NODE_SPACING_M, NODES
from deepmf_sumo.scene import DT_S, FUTURE_STEPS

SPACING_M: Final = 1.0
BESIDE_M: Final = (0.0, 1.0, -1.0, 2.0, -2.0)
"""Left of the path, in an order that `nearest` relies on; neighbouring lanes have own goals."""
LANES: Final = 6
"""In prediction only the likeliest paths have goals (DenseTNT's lane scoring)."""
_BLOCKS: Final = 40
_SAME_M: Final = 1.0
_LEFT_PER_M: Final = 0.5
"""A vehicle that drives 1 m gets no farther to the side than this."""
_HORIZON_S: Final = FUTURE_STEPS * DT_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Goals of a batch.

    Attributes:
        along_m, left_m: (B, P, R) place at 8 s in path coordinates.
        there: (B, P, R) False where there is no such goal.
        log_count: (B, P, R) log of the number of goals that each one stands for: 0 unless drawn.
    """

    along_m: Tensor
    left_m: Tensor
    there: Tensor
    log_count: Tensor


def every(paths: Tensor, exists: Tensor, speed_mps: Tensor) -> Grid:
    """All goals on paths (B, P, 121, 2) that exist (B, P), at start speeds (B)."""
    along, left = _slots(_reach_m(speed_mps).max(), paths)
    there = _there(paths, exists, speed_mps, along, left)
    shape = there.shape
    return Grid(
        along_m=along.expand(shape),
        left_m=left.expand(shape),
        there=there,
        log_count=along.new_zeros(()).expand(shape),
    )


def drawn(grid: Grid, count: int, generator: torch.Generator) -> Grid:
    """``count`` goals of each path, drawn from all of them with replacement."""
    number = grid.there.cumsum(-1)
    most = number[..., -1:]  # (B, P, 1)
    share = torch.rand((*most.shape[:2], count), generator=generator).to(most.device)
    slot = torch.searchsorted(number, (share * most).long() + 1).clamp_max(number.shape[-1] - 1)
    return Grid(
        along_m=grid.along_m.gather(2, slot),
        left_m=grid.left_m.gather(2, slot),
        there=(most > 0).expand(slot.shape),
        log_count=(most.clamp_min(1) / count).log().expand(slot.shape),
    )


def nearest(paths: Tensor, grid: Grid, end_m: Tensor) -> tuple[Grid, Tensor]:
    """The goal of each path, R = 1, that is nearest to an end (B, 2), and the path (B) of the best.

    ``grid`` has all goals (`every`). Ties belong to the first path.
    """
    beside = len(BESIDE_M)
    along, there = grid.along_m[..., ::beside], grid.there[..., ::beside]  # (B, P, S)
    point, tangent = look_up(paths, along)
    x, y = (end_m[:, None, None] - point).unbind(-1)
    square = (x**2 + y**2).masked_fill(~there, float("inf"))
    station = square.argmin(-1, keepdim=True)  # (B, P, 1)
    left = (tangent[..., 0] * y - tangent[..., 1] * x).gather(2, station)
    most = (_LEFT_PER_M * along.gather(2, station)).floor().clamp_max(max(BESIDE_M))
    metre = torch.maximum(torch.minimum(left.round(), most), -most).long()
    slot = station * beside + torch.where(metre > 0, 2 * metre - 1, -2 * metre)
    found = Grid(
        along_m=grid.along_m.gather(2, slot),
        left_m=grid.left_m.gather(2, slot),
        there=there.gather(2, station),
        log_count=end_m.new_zeros(()).expand(slot.shape),
    )
    position, _ = placed(paths, found.along_m, found.left_m)  # (B, P, 1, 2)
    off = (position - end_m[:, None, None]).norm(dim=-1).masked_fill(~found.there, float("inf"))
    return found, off.squeeze(-1).argmin(-1)


def within_reach(speed_mps: Tensor) -> Tensor:
    """(B) number of goals that each path of `every` has at these start speeds, duplicates too."""
    return ((_reach_m(speed_mps) / SPACING_M).long() + 1) * len(BESIDE_M)


def block(goals: int) -> int:
    """`decoding.GoalSet.block` for this number of goals a path: a 40th of the way, full width."""
    beside = len(BESIDE_M)
    return beside * max(round(goals / beside / _BLOCKS), 1)


def joined(one: Grid, other: Grid) -> Grid:
    """The goals of both on each path."""
    return Grid(
        along_m=torch.cat([one.along_m, other.along_m], 2),
        left_m=torch.cat([one.left_m, other.left_m], 2),
        there=torch.cat([one.there, other.there], 2),
        log_count=torch.cat([one.log_count, other.log_count], 2),
    )


def driven(along_m: Tensor, speed_mps: Tensor) -> Tensor:
    """(B, P, R, 80) distances of goals (B, P, R): constant acceleration, or braking to a stop."""
    time = torch.arange(1, FUTURE_STEPS + 1, device=along_m.device) * DT_S
    start, end = speed_mps.view(-1, 1, 1, 1), along_m.unsqueeze(-1)
    moving = start * time + (end - start * _HORIZON_S) * (time / _HORIZON_S) ** 2
    stop = 2.0 * end / start.clamp_min(1e-3)  # s, of a vehicle that brakes evenly
    busy = torch.minimum(time, stop)
    braking = start * busy - start * busy**2 / (2.0 * stop).clamp_min(1e-3)
    return torch.where(end * 2.0 < start * _HORIZON_S, braking, moving)


def _reach_m(speed_mps: Tensor) -> Tensor:
    """(B) farthest goals: as far as the lane graph is followed, see `paths.path_set`."""
    return (_HORIZON_S * speed_mps + 60.0).clamp_max(230.0)


def _slots(reach_m: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
    """(R) along and left of all goals on a path, nearest first."""
    stations = torch.arange(int(reach_m / SPACING_M) + 1, device=like.device) * SPACING_M
    beside = like.new_tensor(BESIDE_M)
    shape = len(stations), len(beside)
    return stations.unsqueeze(1).expand(shape).flatten(), beside.expand(shape).flatten()


def _there(paths: Tensor, exists: Tensor, speed_mps: Tensor, along: Tensor, left: Tensor) -> Tensor:
    """(B, P, R) goals within reach that no earlier path has."""
    near = along <= _reach_m(speed_mps).view(-1, 1, 1)
    node = (along / NODE_SPACING_M).round().long().clamp_max(NODES - 1)
    own = _own_nodes(paths, exists)[..., node]
    return near & own & (left.abs() <= _LEFT_PER_M * along)


def _own_nodes(paths: Tensor, exists: Tensor) -> Tensor:
    """(B, P, 121) nodes that are not also on an earlier path, at the same distance along it."""
    own = [exists[:, :1, None].expand(-1, -1, NODES)]
    for path in range(1, paths.shape[1]):
        step = paths[:, :path] - paths[:, path : path + 1]
        same = ((step.square().sum(-1) < _SAME_M**2) & exists[:, :path, None]).any(1)
        own.append((exists[:, path : path + 1] & ~same).unsqueeze(1))
    return torch.cat(own, 1)
