"""Another vehicle's future as input: a vector polyline, raster channels, and relations to goals."""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.anchors import look_up
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.paths import NODE_SPACING_M
from deepmf_sumo.deepmf.networks.vectornet import POSITION_SCALE_M, SPEED_SCALE_MPS
from deepmf_sumo.deepmf.networks.vgg import draw_future
from deepmf_sumo.scene import DT_S

TOKEN: Final = 8
PATH_RELATION: Final = 7
GOAL_RELATION: Final = 15
EVERY: Final = 5
"""Relations look at every fifth step: 2 Hz."""
_CLOSE_M: Final = 3.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """K futures of another vehicle, in the target's frame.

    Attributes:
        tokens: (B*K, 16, 8) the vector polyline: one vector each half second.
        image: (B*K, C, S', S') the raster channels; None for networks without images.
        position_m: (B, K, 80, 2) for the relations to goals.
        given: (B, K) 0 where there is no condition: the prediction is then marginal.
    """

    tokens: Tensor
    image: Tensor | None
    position_m: Tensor
    given: Tensor

    @property
    def futures(self) -> int:
        """K."""
        return self.given.shape[1]

    @property
    def facing(self) -> Tensor:
        """(B, K, 16, 2) cosine and sine of the headings at 2 Hz."""
        _, steps, columns = self.tokens.shape
        return self.tokens.view(-1, self.futures, steps, columns)[..., 2:4]


def encode(position_m: Tensor, heading_rad: Tensor, given: Tensor, preset: Preset) -> Condition:
    """A condition from positions (B, K, 80, 2) and headings (B, K, 80) in the target's frame."""
    image = None
    if preset.raster:
        image = draw_future(position_m, preset) * given.reshape(-1, 1, 1, 1)
    return Condition(
        tokens=_tokens(position_m, heading_rad).flatten(0, 1),
        image=image,
        position_m=position_m,
        given=given,
    )


def _tokens(position_m: Tensor, heading_rad: Tensor) -> Tensor:
    """(B, K, 16, 8): position, heading, velocity, time, distance from the target's pose."""
    rows = torch.arange(EVERY - 1, position_m.shape[2], EVERY, device=position_m.device)
    here, before = position_m[:, :, rows], position_m[:, :, rows - EVERY + 1]
    velocity = (here - before) / ((EVERY - 1) * DT_S)
    heading = heading_rad[:, :, rows]
    when = ((rows + 1) * DT_S / 8.0).expand(heading.shape)
    return torch.stack(
        [
            here[..., 0] / POSITION_SCALE_M,
            here[..., 1] / POSITION_SCALE_M,
            heading.cos(),
            heading.sin(),
            velocity[..., 0] / SPEED_SCALE_MPS,
            velocity[..., 1] / SPEED_SCALE_MPS,
            when,
            here.norm(dim=-1) / POSITION_SCALE_M,
        ],
        -1,
    )


def relations(paths: Tensor, along_m: Tensor, position_m: Tensor) -> tuple[Tensor, Tensor]:
    """How each future meets each path, and each goal on it.

    Args:
        paths: (B, P, 121, 2).
        along_m: (B, P, R, 16) distance of the goals' profiles at 2 Hz.
        position_m: (B, K, 80, 2).

    Returns:
        (B, K, P, 7): least distance to the path, whether closer than 3.5 m, when first and last,
        where, relative direction, speed.
        (B, K, P, R, 15): closeness at 2, 4, 6, 8 s, least distance, its closeness and time; order
        at the conflict: arrival after first and after last presence, whether the goal passes the
        place, and by how far; how far the other is ahead on the path at 2, 4, 6, 8 s.

    Always in full precision: in bf16 squares of 100 m are wrong by 40 square metres.
    """
    with torch.autocast(paths.device.type, enabled=False):
        return _relations(paths, along_m, position_m)


def _relations(paths: Tensor, along_m: Tensor, position_m: Tensor) -> tuple[Tensor, Tensor]:
    other = position_m[:, :, EVERY - 1 :: EVERY]  # (B, K, 16, 2)
    met, enter, leave, where, path, ahead = _on_paths(paths, other)
    goal = _same_time(paths, along_m, other)
    spread = where[..., None, None]  # (B, K, P, 1, 1)
    reached = along_m.unsqueeze(1) >= spread - 3.0  # (B, K, P, R, 16)
    arrival = 8.0 - reached.sum(-1) * 0.5  # (B, K, P, R) s
    beyond = along_m[:, None, :, :, -1] - where.unsqueeze(-1)
    order = torch.stack(
        [
            ((arrival - enter.unsqueeze(-1)) / 4.0).clamp(-2.0, 2.0),
            torch.tanh(arrival - leave.unsqueeze(-1)),
            reached[..., -1].float(),
            (beyond / 20.0).clamp(-2.0, 2.0),
        ]
    )
    columns = torch.cat([goal, order * met.unsqueeze(-1), _lead(along_m, *ahead)])
    return path, columns.movedim(0, -1)


def _lead(along_m: Tensor, where_m: Tensor, close: Tensor) -> Tensor:
    """(4, B, K, P, R) signed distance to the other along the path, where it is on the path."""
    rows = slice(3, None, 4)  # 2, 4, 6, 8 s
    place = where_m[:, :, rows].movedim(2, 0).unsqueeze(4)  # (4, B, K, P, 1)
    there = close[:, :, rows].movedim(2, 0).unsqueeze(4)
    along = along_m[..., rows].movedim(3, 0).unsqueeze(2)  # (4, B, 1, P, R)
    return ((place - along) / 20.0).clamp(-2.0, 2.0) * there


def _on_paths(
    paths: Tensor, other: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
    """Presence of futures (B, K, 16, 2) on paths: flag, times in and out, place, features.

    And at each time (B, K, 16, P) the place on the path and whether it is on it.
    """
    steps = other.shape[2]
    shape = (*other.shape[:3], paths.shape[1])  # (B, K, 16, P)
    least, node = (each.view(shape) for each in nearest_nodes(paths, other.flatten(1, 2)))
    distance = least.clamp_min(0.0).sqrt()
    close = distance < _CLOSE_M
    met = close.any(2).float()  # (B, K, P)
    time = torch.arange(steps, device=other.device).view(-1, 1)
    first = torch.where(close, time, steps).amin(2)  # of no meaning where they do not meet
    last = torch.where(close, time, -1).amax(2)
    nearest = distance.min(2)
    step = torch.where(met > 0, first, nearest.indices)  # (B, K, P)
    place = node.gather(2, step.unsqueeze(2)).squeeze(2)
    where = place * NODE_SPACING_M
    _, tangent = look_up(paths, where.transpose(1, 2).float())  # (B, P, K, 2)
    motion = torch.diff(other, dim=2, append=2 * other[:, :, -1:] - other[:, :, -2:-1]) / 0.5
    moved = motion.gather(2, step.unsqueeze(-1).expand(-1, -1, -1, 2))  # (B, K, P, 2)
    speed = moved.norm(dim=-1)
    cosine = (moved * tangent.transpose(1, 2)).sum(-1) / speed.clamp_min(0.5)
    enter, leave = (first + 1) * 0.5, (last + 1) * 0.5
    path = torch.stack(
        [
            (nearest.values / 10.0).clamp_max(3.0),
            met,
            met * enter / 8.0,
            met * leave / 8.0,
            met * where / 50.0,
            met * cosine,
            met * speed / SPEED_SCALE_MPS,
        ],
        -1,
    )
    return met, enter, leave, where, path, (node * NODE_SPACING_M, close)


def nearest_nodes(paths: Tensor, points_m: Tensor) -> tuple[Tensor, Tensor]:
    """(B, N, P) squared distance and number of the path's node that is nearest to each point."""
    square = _squares(points_m, paths.flatten(1, 2))
    least, node = square.view(*points_m.shape[:2], *paths.shape[1:3]).min(-1)
    return least, node


def _squares(one: Tensor, other: Tensor) -> Tensor:
    """(B, N, M) squared distances of points (B, N, 2) and (B, M, 2), by a product as `torch.cdist`.

    Rounding may leave them below zero. The root of the least is cheaper than that of all.
    """
    norm, other_norm = (points.square().sum(-1, keepdim=True) for points in (one, other))
    left = torch.cat([-2.0 * one, norm, torch.ones_like(norm)], -1)
    right = torch.cat([other, torch.ones_like(other_norm), other_norm], -1)
    return left @ right.mT


def _same_time(paths: Tensor, along_m: Tensor, other: Tensor) -> Tensor:
    """(7, B, K, P, R) distances between goals and futures at the same times."""
    point, _ = look_up(paths, along_m.flatten(2))
    point = point.view(*along_m.shape, 2)  # (B, P, R, 16, 2)
    x, y = point.movedim((4, 3), (0, 1)).unsqueeze(3).contiguous()  # (16, B, 1, P, R) each
    other_x, other_y = other.movedim((3, 2), (0, 1))[..., None, None]  # (16, B, K, 1, 1) each
    square = (x - other_x) ** 2 + (y - other_y) ** 2
    nearest = square.min(0)
    least = nearest.values.sqrt()
    at = square[3::4].sqrt()  # 2, 4, 6, 8 s
    last = [(least / 10.0).clamp_max(3.0), torch.exp(-least / 3.0), nearest.indices / 16.0]
    return torch.cat([torch.exp(-at / 12.0), torch.stack(last)])
