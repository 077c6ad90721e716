"""Guided samples of `diffscene`: what pulls a motion to the AV, and what holds it on the road.

Costs are in metres: a weight converts its term into distance to the AV.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.adversaries._episodes import Motion, Scouted
from deepmf_sumo.adversaries._scene_graph import DISCS, Path, Situation, situation_of
from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, AgentId, Floats
from deepmf_sumo.predictors.motion_priors import costs
from deepmf_sumo.predictors.motion_priors.diffscene import (
    COMPONENTS,
    KNOT_S,
    KNOTS,
    DiffusionPrior,
)
from deepmf_sumo.predictors.motion_priors.strive import turned

_EVERY: Final = 2
"""Costs use every second step: at 20 m/s, vehicles move 4 m in between."""
_SPARSE: Final = 2
"""The road and others use every second of these."""
_FREE: Final = 10
"""Of these steps: gaps of the first 2 s can hardly be changed."""
_DEPTH_M: Final = 0.4  # desired overlap, so that tracking errors keep the contact
_ROAD_M: Final = 120.0
_SLOW_M: Final = 0.1
"""Shorter moves of 0.2 s are straight on: they have no direction of their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """Weights of the constraints, and the limits of motion."""

    off_road: float
    others: float
    hardness: float
    accel_mps2: float
    brake_mps2: float
    lateral_mps2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """Samples (S, 80, 2) in the opponent's frame of now, and what they cost the constraints (S)."""

    position_m: Floats
    cost_m: Floats


def draw(
    net: DiffusionPrior,
    scouted: Scouted,
    av: Motion,
    terms: Terms,
    samples: int,
    steps: int,
    reach: float,
    rng: np.random.Generator,
) -> Drawn:
    """Motions of the opponent, guided to the AV's rollout."""
    situation = situation_of(scouted, [scouted.opponent_id])
    costs_of = _Costs(net, situation, scouted.opponent_id, situation.to_path(av), terms)
    noise = torch.from_numpy(rng.standard_normal((samples, COMPONENTS))).float()
    with torch.no_grad():
        seen = net.encode(situation.graph).of(situation.row(scouted.opponent_id), samples)
    clean = net.sample(seen, noise, steps, costs_of, reach)
    with torch.no_grad():
        position = joined(net.positions(clean, costs_of.speed), costs_of.speed)
        cost = costs_of.constraints(position)
    return Drawn(position_m=position.double().numpy(), cost_m=cost.double().numpy())


class _Costs:
    """The guide: the AV's rollout, the road and other road users, in the graph's frame."""

    def __init__(
        self, net: DiffusionPrior, situation: Situation, opponent: AgentId, av: Path, terms: Terms
    ) -> None:
        row, name = situation.row(opponent), situation.ids[0]
        self._net, self._terms = net, terms
        self.speed = situation.graph["motion"][0, row, 0]
        self._pose = situation.graph["pose"][0, row]
        self._size, self._allowed = situation.sizes[opponent], situation.allowed[row]
        every = slice(_EVERY - 1, None, _EVERY)
        self._av = situation.discs(name, av)[every]
        self._there = av.there[every]
        self._reach = situation.radius(name) + situation.radius(opponent)
        near = (situation.road - self._pose[:2]).norm(dim=-1) < _ROAD_M
        self._road = situation.road[near]
        others = situation.obstacles([name, opponent], {})
        rare = slice(_EVERY * _SPARSE - 1, None, _EVERY * _SPARSE)
        self._others = None if others is None else others._replace(
            discs=others.discs[:, rare], there=others.there[:, rare]
        )  # fmt: skip

    def __call__(self, clean: Tensor) -> Tensor:
        """(S) of components (S, C)."""
        position = joined(self._net.positions(clean, self.speed), self.speed)
        return self.gap(position) + self.constraints(position)

    def gap(self, position: Tensor) -> Tensor:
        """(S) soft least distance to the AV from 2 s on; 0 in contact."""
        place, heading = self._placed(position)
        own = costs.disc_centres(place, heading, self._size, DISCS)
        apart = costs.apart(own, self._av) - self._reach
        near = apart.masked_fill(~self._there, 1e4)[:, _FREE:]
        soft = ((-near.detach()).softmax(-1) * near).sum(-1)
        return (soft + _DEPTH_M).clamp_min(0.0)

    def constraints(self, position: Tensor) -> Tensor:
        """(S) of motions (S, 80, 2)."""
        terms, rare = self._terms, slice(_SPARSE - 1, None, _SPARSE)
        place, heading = self._placed(position)
        place, heading = place[:, rare], heading[:, rare]
        total = terms.hardness * self._beyond_limits(position)
        if len(self._road):
            away = costs.off_road(place, self._road, self._allowed)
            total = total + terms.off_road * away.mean(-1)
        if self._others is not None:
            others = self._others
            own = costs.disc_centres(place, heading, self._size, DISCS)
            radius = costs.disc_radius(self._size)
            depth = costs.overlap(own.unsqueeze(1), others.discs, radius, others.radius[:, None])
            total = total + terms.others * (depth * others.there).sum(1).mean(-1)
        return total

    def _placed(self, position: Tensor) -> tuple[Tensor, Tensor]:
        """Motions (S, 80, 2) every 0.2 s in the graph's frame, and headings (S, 40)."""
        moved = position[:, _EVERY - 1 :: _EVERY]
        before = torch.cat([torch.zeros_like(moved[:, :1]), moved[:, :-1]], 1)
        step = moved - before
        # A vehicle that stands keeps its direction of now, without a gradient.
        slow = step.norm(dim=-1) < _SLOW_M
        step = torch.where(slow.unsqueeze(-1), step.new_tensor([1.0, 0.0]), step)
        heading = torch.atan2(step[..., 1], step[..., 0]) + self._pose[2]
        return self._pose[:2] + turned(moved, self._pose[2].expand(moved.shape[:-1])), heading

    def _beyond_limits(self, position: Tensor) -> Tensor:
        """(S) mean m/s2 beyond the limits, over time."""
        terms, span = self._terms, round(KNOT_S / DT_S)
        knots = torch.cat([torch.zeros_like(position[:, :1]), position[:, span - 1 :: span]], 1)
        velocity = torch.diff(knots, dim=1) / KNOT_S
        speed = (velocity.square().sum(-1) + 1e-4).sqrt()
        accel = torch.diff(speed, dim=1) / KNOT_S
        cross = velocity[:, :-1, 0] * velocity[:, 1:, 1] - velocity[:, :-1, 1] * velocity[:, 1:, 0]
        lateral = cross.abs() / speed[:, 1:].clamp_min(1.0) / KNOT_S
        beyond = (
            (accel - terms.accel_mps2).clamp_min(0.0)
            + (-accel - terms.brake_mps2).clamp_min(0.0)
            + (lateral - terms.lateral_mps2).clamp_min(0.0)
        )
        return beyond.mean(-1)


def joined(knots: Tensor, speed: Tensor) -> Tensor:
    """(S, 80, 2) every 0.1 s through knots (S, 16, 2), by Hermite's cubic from the present speed.

    Velocities at knots are those of parabolas through three of them.
    """
    points = torch.cat([torch.zeros_like(knots[:, :1]), knots], 1)
    slope = torch.diff(points, dim=1)
    first = torch.stack([speed * KNOT_S, torch.zeros_like(speed)], -1).expand(len(knots), 1, 2)
    inner = (slope[:, :-1] + slope[:, 1:]) / 2
    tangent = torch.cat([first, inner, slope[:, -1:]], 1)
    per = FUTURE_STEPS // KNOTS
    share = torch.arange(1, per + 1, device=knots.device).view(1, 1, per, 1) / per
    begin, end = points[:, :-1, None], points[:, 1:, None]
    out, into = tangent[:, :-1, None], tangent[:, 1:, None]
    square, cube = share**2, share**3
    places = (
        (2 * cube - 3 * square + 1) * begin
        + (cube - 2 * square + share) * out
        + (3 * square - 2 * cube) * end
        + (cube - square) * into
    )
    return places.flatten(1, 2)
