"""Goals of a vehicle: places on the paths ahead, each with the timing of a whole trajectory.

An anchor is a goal by a path and a speed profile; the profiles are fitted on data. Dense goals (Gu
et al. 2021, "DenseTNT", section 3.2) are places where a vehicle may be in 8 s, on a grid of 1 m
along and beside the paths. Each dense goal has the timing of a constant acceleration, or of braking
to a stop, that ends there. The network scores and completes goals of both kinds.

All arguments are tensors in the vehicle's frame; the same code serves training and prediction.
Shapes: B scenes, P paths, R goals on each, S stations.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.encode import OwnMotion, PathAgent
from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M, NODES, PathInfo
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


class GoalShape(IntEnum):
    """Columns of `goal_features`.

    Distance (ALONG) and SPEED each second; GAP to the vehicle ahead and way OVER a closed stop line
    at these seconds; largest SIDEWAYS acceleration; way beyond the END of the lane graph; speed
    above the LIMIT; log PRIOR; START speed.
    """

    ALONG_1, ALONG_2, ALONG_3, ALONG_4, ALONG_5, ALONG_6, ALONG_7, ALONG_8 = range(8)
    SPEED_1, SPEED_2, SPEED_3, SPEED_4, SPEED_5, SPEED_6, SPEED_7, SPEED_8 = range(8, 16)
    GAP_2, GAP_4, GAP_8, OVER_4, OVER_8, SIDEWAYS, END, LIMIT, PRIOR, START = range(16, 26)


def goal_features(batch: dict[str, Tensor], along: Tensor, log_prior: Tensor) -> Tensor:
    """(B, P, R) of `GoalShape`."""
    paths, info = batch["paths"], batch["path_info"]
    seconds = along[..., 9::10]  # (B, P, R, 8) at 1..8 s
    speed = torch.diff(along, dim=-1)[..., 8::10] * 10.0
    stop = seconds[..., [3, 7]] - info[..., PathInfo.STOP, None, None]
    closed = info[..., PathInfo.RED, None, None] + info[..., PathInfo.YELLOW, None, None]
    over = (stop / 10.0).clamp(-2.0, 2.0) * closed
    node = (seconds / NODE_SPACING_M).long().clamp(0, paths.shape[2] - 3)
    bend = curvature(paths).gather(2, node.flatten(2)).view_as(node)
    sideways = (bend.abs() * speed**2).amax(-1, keepdim=True)
    length = (seconds[..., 7:] - info[..., PathInfo.END, None, None]) / 20.0
    limit = info[..., PathInfo.LIMIT, None, None]
    fast = ((speed.amax(-1, keepdim=True) - limit) / 10.0) * (limit > 0)
    start = batch["motion"][:, OwnMotion.SPEED].view(-1, 1, 1, 1).expand_as(fast) / 15.0
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
    along, beside = others[..., PathAgent.ALONG], others[..., PathAgent.LEFT].abs()
    ahead = (beside < 2.0) & (along > 0.5) & (others[..., PathAgent.THERE] > 0)
    times = seconds.new_tensor([2.0, 4.0, 8.0])
    tail = (along - 0.5 * others[..., PathAgent.LENGTH]).unsqueeze(-1)
    tail = tail + others[..., PathAgent.SPEED_ALONG].unsqueeze(-1) * times  # (B, P, 8, 3)
    tail = tail.masked_fill(~ahead.unsqueeze(-1), 1e3).amin(2)  # (B, P, 3)
    gap = tail.unsqueeze(2) - seconds[..., [1, 3, 7]]
    return (gap / 20.0).clamp(-1.0, 3.0)


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
    """`decode.GoalSet.block` for this number of goals a path: a 40th of the way, full width."""
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
    """(B) farthest goals: as far as the lane graph is followed, see `lanes.path_set`."""
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
