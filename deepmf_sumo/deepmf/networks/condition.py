"""The condition: another vehicle's future as input of a network, and what a driver makes of it.

A network reads the given future as a vector polyline, as raster channels, and by its relations to
paths and goals. A reactive network also reads where a car-following driver would be on each path:
the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000), behind the given vehicle while it
reaches into the path, and behind the vehicle that is next ahead on it now. That tells the network
what braking in time amounts to; it learns how planners and people differ from it.

Shapes: B scenes, K given futures, P paths, R goals a path.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Self

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.anchors import look_up
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.encode import (
    POSITION_SCALE_M,
    SPEED_SCALE_MPS,
    OwnMotion,
    PathAgent,
    span,
)
from deepmf_sumo.deepmf.networks.lanes import NODE_SPACING_M, PathInfo
from deepmf_sumo.deepmf.networks.vgg import draw_future
from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.car_following import TREIBER

EVERY: Final = 5
"""Relations look at every fifth step: 2 Hz."""
_CLOSE_M: Final = 3.5


class Token(IntEnum):
    """Columns of ``Condition.tokens``: the given vehicle; APART is its distance to the target."""

    X, Y, COS, SIN, VX, VY, TIME, APART = range(8)


class PathRelation(IntEnum):
    """How a given future meets a path: columns of the first result of `relations`.

    LEAST distance to the path; whether it is closer than 3.5 m (MET); when FIRST and LAST, and then
    where along the path (PLACE), in which relative direction (COS) and at which SPEED.
    """

    LEAST, MET, FIRST, LAST, PLACE, COS, SPEED = range(7)


class GoalRelation(IntEnum):
    """How a given future meets a goal: columns of the second result of `relations`.

    CLOSE: closeness at 2, 4, 6, 8 s; the LEAST distance, its closeness and time. Order at the
    conflict: arrival AFTER its first and LATER than its last presence, whether the goal REACHES the
    place, and how far BEYOND. LEAD: how far the other is ahead on the path at 2, 4, 6, 8 s.
    """

    CLOSE_2, CLOSE_4, CLOSE_6, CLOSE_8, LEAST, CLOSEST, CLOSEST_TIME = range(7)
    AFTER, LATER, REACHES, BEYOND, LEAD_2, LEAD_4, LEAD_6, LEAD_8 = range(7, 15)


class Following(IntEnum):
    """A goal and the car-following driver on its path: columns of `following`.

    The goal's LEAD at 2, 4, 6, 8 s, and its closeness over all times, on two scales.
    """

    LEAD_2, LEAD_4, LEAD_6, LEAD_8, CLOSE, NEAR = range(6)


_FACING: Final = span(Token.COS, Token.SIN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """K futures of another vehicle, in the target's frame.

    Attributes:
        tokens: (B*K, 16) of `Token`: the vector polyline, one vector each half second.
        image: (B*K, C, S', S') the raster channels; None for networks without images.
        position_m: (B, K, 80, 2) for the relations to goals.
        given: (B, K) 0 where there is no condition: the prediction is then marginal.
    """

    tokens: Tensor
    image: Tensor | None
    position_m: Tensor
    given: Tensor

    @classmethod
    def of(cls, position_m: Tensor, heading_rad: Tensor, given: Tensor, preset: Preset) -> Self:
        """From positions (B, K, 80, 2) and headings (B, K, 80) in the target's frame."""
        image = None
        if preset.raster:
            image = draw_future(position_m, preset) * given.reshape(-1, 1, 1, 1)
        return cls(
            tokens=_tokens(position_m, heading_rad).flatten(0, 1),
            image=image,
            position_m=position_m,
            given=given,
        )

    @property
    def futures(self) -> int:
        """K."""
        return self.given.shape[1]

    @property
    def facing(self) -> Tensor:
        """(B, K, 16, 2) cosine and sine of the headings at 2 Hz."""
        _, steps, columns = self.tokens.shape
        return self.tokens.view(-1, self.futures, steps, columns)[..., _FACING]


def _tokens(position_m: Tensor, heading_rad: Tensor) -> Tensor:
    """(B, K, 16) of `Token`."""
    rows = torch.arange(EVERY - 1, position_m.shape[2], EVERY, device=position_m.device)
    here, before = position_m[:, :, rows], position_m[:, :, rows - EVERY + 1]
    velocity = (here - before) / ((EVERY - 1) * DT_S)
    heading = heading_rad[:, :, rows]
    columns = {
        Token.X: here[..., 0] / POSITION_SCALE_M,
        Token.Y: here[..., 1] / POSITION_SCALE_M,
        Token.COS: heading.cos(),
        Token.SIN: heading.sin(),
        Token.VX: velocity[..., 0] / SPEED_SCALE_MPS,
        Token.VY: velocity[..., 1] / SPEED_SCALE_MPS,
        Token.TIME: ((rows + 1) * DT_S / 8.0).expand(heading.shape),
        Token.APART: here.norm(dim=-1) / POSITION_SCALE_M,
    }
    return torch.stack([columns[column] for column in Token], -1)


@dataclass(frozen=True, slots=True, kw_only=True)
class OnPaths:
    """Where the given futures are on each path, at the first step and at 2 Hz.

    Attributes:
        least: (B, K, 17, P) squared distance to the nearest node of each path.
        node: (B, K, 17, P) number of this node.
    """

    least: Tensor
    node: Tensor

    @classmethod
    def of(cls, paths: Tensor, position_m: Tensor) -> Self:
        """Futures (B, K, 80, 2) on paths (B, P, 121, 2); in full precision, as `relations`."""
        with torch.autocast(paths.device.type, enabled=False):
            other = _sampled(position_m)
            square = _squares(other.flatten(1, 2), paths.flatten(1, 2))
            least, node = _least(square.view(*other.shape[:3], *paths.shape[1:3]))
            return cls(least=least, node=node)


def _sampled(position_m: Tensor) -> Tensor:
    """(B, K, 17, 2) positions at the first step, 0.1 s ahead, and at 2 Hz."""
    return torch.cat([position_m[:, :, :1], position_m[:, :, EVERY - 1 :: EVERY]], 2)


def _least(values: Tensor) -> tuple[Tensor, Tensor]:
    """The least of the last axis, and its number: the first one where several are equal."""
    if values.is_cuda or torch.compiler.is_exporting():
        least, number = values.min(-1)
        return least, number
    array = values.numpy()  # more than twice as fast as torch
    found = array.argmin(-1)
    nearest = np.take_along_axis(array, found[..., None], -1)[..., 0]
    return torch.from_numpy(nearest), torch.from_numpy(found)


def _squares(one: Tensor, other: Tensor) -> Tensor:
    """(B, N, M) squared distances of points (B, N, 2) and (B, M, 2), by a product as `torch.cdist`.

    Rounding may leave them below zero. The root of the least is cheaper than that of all.
    """
    norm, other_norm = (points.square().sum(-1, keepdim=True) for points in (one, other))
    left = torch.cat([-2.0 * one, norm, torch.ones_like(norm)], -1)
    right = torch.cat([other, torch.ones_like(other_norm), other_norm], -1)
    return left @ right.mT


def relations(
    paths: Tensor, along_m: Tensor, position_m: Tensor, on_paths: OnPaths
) -> tuple[Tensor, Tensor]:
    """How each future meets each path, and each goal on it.

    Args:
        paths: (B, P, 121, 2).
        along_m: (B, P, R, 16) distance of the goals' profiles at 2 Hz.
        position_m: (B, K, 80, 2).
        on_paths: where these futures are.

    Returns:
        (B, K, P) of `PathRelation`, (B, K, P, R) of `GoalRelation`.

    Always in full precision: in bf16 squares of 100 m are wrong by 40 square metres.
    """
    with torch.autocast(paths.device.type, enabled=False):
        other = position_m[:, :, EVERY - 1 :: EVERY]  # (B, K, 16, 2)
        met = _Met.of(paths, other, on_paths)
        columns = _same_time(paths, along_m, other) | _order(along_m, met) | _lead(along_m, met)
        goals = torch.stack([columns[each] for each in GoalRelation])  # last axis: 3 times as slow
        return met.columns, goals.movedim(0, -1)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Met:
    """Presence of futures on paths.

    Attributes:
        met, enter_s, leave_s, place_m: (B, K, P) whether they are close, times in and out, where.
        columns: (B, K, P) of `PathRelation`.
        close: (B, K, 16, P) at each time. along_m: (B, K, 16, P) the nearest node.
    """

    met: Tensor
    enter_s: Tensor
    leave_s: Tensor
    place_m: Tensor
    columns: Tensor
    close: Tensor
    along_m: Tensor

    @classmethod
    def of(cls, paths: Tensor, other: Tensor, on_paths: OnPaths) -> Self:
        """Of futures (B, K, 16, 2) at 2 Hz."""
        node, steps = on_paths.node[:, :, 1:], other.shape[2]
        distance = on_paths.least[:, :, 1:].clamp_min(0.0).sqrt()
        close = distance < _CLOSE_M
        met = close.any(2).float()  # (B, K, P)
        time = torch.arange(steps, device=other.device).view(-1, 1)
        first = torch.where(close, time, steps).amin(2)  # of no meaning where they do not meet
        last = torch.where(close, time, -1).amax(2)
        nearest = distance.min(2)
        step = torch.where(met > 0, first, nearest.indices)  # (B, K, P)
        place = node.gather(2, step.unsqueeze(2)).squeeze(2) * NODE_SPACING_M
        _, tangent = look_up(paths, place.transpose(1, 2).float())  # (B, P, K, 2)
        motion = torch.diff(other, dim=2, append=2 * other[:, :, -1:] - other[:, :, -2:-1]) / 0.5
        moved = motion.gather(2, step.unsqueeze(-1).expand(-1, -1, -1, 2))  # (B, K, P, 2)
        speed = moved.norm(dim=-1)
        cosine = (moved * tangent.transpose(1, 2)).sum(-1) / speed.clamp_min(0.5)
        enter, leave = (first + 1) * 0.5, (last + 1) * 0.5
        columns = {
            PathRelation.LEAST: (nearest.values / 10.0).clamp_max(3.0),
            PathRelation.MET: met,
            PathRelation.FIRST: met * enter / 8.0,
            PathRelation.LAST: met * leave / 8.0,
            PathRelation.PLACE: met * place / 50.0,
            PathRelation.COS: met * cosine,
            PathRelation.SPEED: met * speed / SPEED_SCALE_MPS,
        }
        return cls(
            met=met,
            enter_s=enter,
            leave_s=leave,
            place_m=place,
            columns=torch.stack([columns[column] for column in PathRelation], -1),
            close=close,
            along_m=node * NODE_SPACING_M,
        )


def _order(along_m: Tensor, met: _Met) -> dict[GoalRelation, Tensor]:
    """(B, K, P, R) the order of goals and futures at the places where these meet the path."""
    reached = along_m.unsqueeze(1) >= met.place_m[..., None, None] - 3.0  # (B, K, P, R, 16)
    arrival = 8.0 - reached.sum(-1) * 0.5  # (B, K, P, R) s
    beyond = along_m[:, None, :, :, -1] - met.place_m.unsqueeze(-1)
    flag = met.met.unsqueeze(-1)
    after = ((arrival - met.enter_s.unsqueeze(-1)) / 4.0).clamp(-2.0, 2.0)
    return {
        GoalRelation.AFTER: after * flag,
        GoalRelation.LATER: torch.tanh(arrival - met.leave_s.unsqueeze(-1)) * flag,
        GoalRelation.REACHES: reached[..., -1].float() * flag,
        GoalRelation.BEYOND: (beyond / 20.0).clamp(-2.0, 2.0) * flag,
    }


def _lead(along_m: Tensor, met: _Met) -> dict[GoalRelation, Tensor]:
    """(B, K, P, R) signed distance to the other along the path, where it is on the path."""
    leads = GoalRelation.LEAD_2, GoalRelation.LEAD_4, GoalRelation.LEAD_6, GoalRelation.LEAD_8
    rows = slice(3, None, 4)  # 2, 4, 6, 8 s
    place = met.along_m[:, :, rows].movedim(2, 0).unsqueeze(4)  # (4, B, K, P, 1)
    there = met.close[:, :, rows].movedim(2, 0).unsqueeze(4)
    along = along_m[..., rows].movedim(3, 0).unsqueeze(2)  # (4, B, 1, P, R)
    found = ((place - along) / 20.0).clamp(-2.0, 2.0) * there
    return dict(zip(leads, found, strict=True))


def _same_time(paths: Tensor, along_m: Tensor, other: Tensor) -> dict[GoalRelation, Tensor]:
    """(B, K, P, R) distances between goals and futures at the same times."""
    point, _ = look_up(paths, along_m.flatten(2))
    point = point.view(*along_m.shape, 2)  # (B, P, R, 16, 2)
    x, y = point.movedim((4, 3), (0, 1)).unsqueeze(3).contiguous()  # (16, B, 1, P, R) each
    other_x, other_y = other.movedim((3, 2), (0, 1))[..., None, None]  # (16, B, K, 1, 1) each
    square = (x - other_x).square_()
    square += (y - other_y).square_()
    nearest = square.min(0)
    least = nearest.values.sqrt()
    at = torch.exp(-square[3::4].sqrt() / 12.0)  # 2, 4, 6, 8 s
    return {
        GoalRelation.CLOSE_2: at[0],
        GoalRelation.CLOSE_4: at[1],
        GoalRelation.CLOSE_6: at[2],
        GoalRelation.CLOSE_8: at[3],
        GoalRelation.LEAST: (least / 10.0).clamp_max(3.0),
        GoalRelation.CLOSEST: torch.exp(-least / 3.0),
        GoalRelation.CLOSEST_TIME: nearest.indices / 16.0,
    }


_SUBSTEPS: Final = 2
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
        agents: (B, P, 8, 8), see `encode.Features`.
    """

    paths: Tensor
    limit_mps: Tensor
    speed_mps: Tensor
    agents: Tensor

    @classmethod
    def of(cls, batch: dict[str, Tensor]) -> Self:
        """Of a batch of `encode.Features`."""
        return cls(
            paths=batch["paths"],
            limit_mps=batch["path_info"][..., PathInfo.LIMIT],
            speed_mps=batch["motion"][:, OwnMotion.SPEED],
            agents=batch["path_agents"],
        )


def following(road: Road, along_m: Tensor, given: Condition, on_paths: OnPaths) -> Tensor:
    """(B, K, P, R) of `Following` for goals, (B, P, R, 16) along at 2 Hz.

    Always in full precision, as `relations`.
    """
    with torch.autocast(along_m.device.type, enabled=False):
        driven = followed(road, given, on_paths)  # (B, K, P, 16)
        off = -_apart(along_m, driven) / driven.shape[-1]
        lead = along_m[..., 3::4].unsqueeze(1) - driven[..., 3::4].unsqueeze(3)
        at = (lead / 10.0).clamp_(-2.0, 2.0)  # (B, K, P, R, 4)
        return torch.cat([at, torch.stack([off.exp(), (off / 4.0).exp_()], -1)], -1)


def _apart(along_m: Tensor, driven: Tensor) -> Tensor:
    """(B, K, P, R) sums of the distances between (B, P, R, 16) and (B, K, P, 16)."""
    if torch.compiler.is_exporting():  # ONNX has no such distance
        return (along_m.unsqueeze(1) - driven.unsqueeze(3)).abs().sum(-1)
    return torch.cdist(along_m, driven.transpose(1, 2), p=1.0).permute(0, 3, 1, 2)


def followed(road: Road, given: Condition, on_paths: OnPaths) -> Tensor:
    """(B, K, P, 16) distances that the follower drives along each path, at 2 Hz, m."""
    ahead, pace = _ahead(road, given, on_paths)  # (16 * substeps, 2, B, K, P), (16, 2, B, K, P)
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
    """(B, K, P) distances at 2 Hz, see `followed`; arrays of ``of``, numpy or torch.

    The desired gap is `desired_gap_m`, with speed factored out: an operation fewer per step.
    """
    ahead, pace, start, slowness = parts
    # a third of the time of `clip`, which numpy and torch have in common
    least: Any = np.maximum if of is np else torch.clamp_min
    seconds = EVERY * DT_S / _SUBSTEPS
    brisk = 0.5 / (TREIBER.accel_mps2 * TREIBER.decel_mps2) ** 0.5
    along = of.zeros_like(ahead[0, 0])
    speed = along + start
    for step in range(len(ahead)):
        gap = ahead[step] - along
        first = of.where(gap[0] < -_LENGTH_M, _FAR_M, gap[0])  # passed: no leader any more
        keep = (speed - pace[step // _SUBSTEPS]) * brisk + TREIBER.headway_s
        wanted = least(keep * speed, 0.0) + TREIBER.gap_m
        use = of.maximum(wanted[0] / least(first, 0.1), wanted[1] / least(gap[1], 0.1))
        busy = of.square(speed * slowness)
        gain = TREIBER.accel_mps2 * (1.0 - busy * busy - use * use)
        faster = least(speed + least(gain, -TREIBER.emergency_mps2) * seconds, 0.0)
        along = along + (0.5 * seconds) * (speed + faster)
        speed = faster
        if step % _SUBSTEPS == _SUBSTEPS - 1:
            yield along


def _ahead(road: Road, given: Condition, on_paths: OnPaths) -> tuple[Tensor, Tensor]:
    """Distances to the tails of two leaders, the given vehicle and the next one, and speeds."""
    place, left, there = _leader(road.paths, given, on_paths.node)  # (17, B, K, P)
    tail, pace = _next_ahead(road.agents, place[0], left[0])  # (B, K, P)
    moves = torch.diff(place, dim=0)
    shares = torch.arange(_SUBSTEPS, device=place.device).view(1, -1, 1, 1, 1) / _SUBSTEPS
    met = (place[:-1] - _LENGTH_M).unsqueeze(1) + shares * moves.unsqueeze(1)
    met = met.masked_fill_(~there[:-1].unsqueeze(1), _FAR_M).flatten(0, 1)
    times = torch.arange(len(met), device=place.device).view(-1, 1, 1, 1) / _SUBSTEPS
    rest = tail + pace * (times * (EVERY * DT_S))
    speeds = (moves / (EVERY * DT_S)).clamp_min_(0.0)
    return torch.stack([met, rest], 1), torch.stack([speeds, pace.expand_as(speeds)], 1)


def _leader(paths: Tensor, given: Condition, node: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(17, B, K, P) the given vehicle at its first step and at 2 Hz: along, left, in the path.

    The first step, 0.1 s ahead, stands for now, because a fast vehicle drives far in half a second.
    """
    turns = given.facing  # (B, K, 16, 2)
    facing = torch.cat([turns[:, :, :1], turns], 2).flatten(1, 2).unsqueeze(1)  # (B, 1, N, 2)
    other = _sampled(given.position_m).flatten(1, 2)  # N = 17 K
    node = node.flatten(1, 2).transpose(1, 2)  # (B, P, N)
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
    agents = agents.unsqueeze(1)  # (B, 1, P, 8) of `PathAgent`
    along, left = agents[..., PathAgent.ALONG], agents[..., PathAgent.LEFT]
    speed, length = agents[..., PathAgent.SPEED_ALONG], agents[..., PathAgent.LENGTH]
    apart = (along - place_m.unsqueeze(-1)).abs() + (left - left_m.unsqueeze(-1)).abs()
    ahead = (
        (agents[..., PathAgent.THERE] > 0)
        & (left.abs() < _BESIDE_M)
        & (along > 1.0)
        & (apart > _SAME_M)
    )
    gaps = torch.where(ahead, along - 0.5 * (length + _LENGTH_M), _FAR_M)
    gap, row = gaps.min(-1)
    pace = speed.expand_as(gaps).gather(-1, row.unsqueeze(-1)).squeeze(-1)
    return gap, pace.clamp_min(0.0)
