"""Guided samples of `diffscene`: the costs of a motion, and the motions that they guide.

Costs are in metres: a weight converts its term into distance to the AV.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from deepmf_sumo.attacks._episodes import AgentMotion, Scouted
from deepmf_sumo.baselines._art_descent import DEPTH_M
from deepmf_sumo.baselines._scene_graph import DISCS, ROAD_M, Obstacles, Path, situation_of
from deepmf_sumo.baselines.priors import costs
from deepmf_sumo.baselines.priors.diffscene import (
    COMPONENTS,
    KNOT_S,
    KNOTS,
    DiffusionPrior,
)
from deepmf_sumo.baselines.priors.strive import turned
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, AgentId, Floats, Ints

_EVERY: Final = 2
"""Costs use every second step: at 20 m/s, vehicles move 4 m in between."""
_SPARSE: Final = 2
"""The road and others use every second of these."""
_FREE: Final = 10
"""Of these steps: gaps of the first 2 s can hardly be changed."""
_KNOWN_M: Final = ROAD_M - 10.0
"""Nothing is said about the road farther from the AV's place of now."""
_BESIDE_M: Final = 30.0
"""Others farther from the rectangle around the opponent and the AV's rollout are left out."""
_SLOW_M: Final = 0.1
"""Shorter moves of 0.2 s have no direction of their own: the vehicle keeps the one before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidanceTerms:
    """Weights of the constraints, and the limits of motion."""

    off_road: float
    others: float
    hardness: float
    accel_mps2: float
    brake_mps2: float
    lateral_mps2: float


class Guide:
    """Pulls motions of the opponent to the AV's rollout, in the graph's frame.

    Args:
        net: the diffusion model.
        scouted: the unattacked episode.
        av: the AV's rollout.
        terms: of the constraints.
    """

    def __init__(
        self, net: DiffusionPrior, scouted: Scouted, av: AgentMotion, terms: GuidanceTerms
    ) -> None:
        situation, opponent = situation_of(scouted, [scouted.opponent_id]), scouted.opponent_id
        self._situation = situation
        self._aim(opponent, situation.to_path(av))
        self._row = situation.row(opponent)
        self._net, self._terms = net, terms
        self.speed = situation.graph["motion"][0, self._row, 0]
        self._pose = situation.graph["pose"][0, self._row]
        self._size, self._allowed = situation.sizes[opponent], situation.allowed[self._row]
        self._road = situation.road
        self._tree = KDTree(situation.road.numpy()) if len(situation.road) else None
        self._others = self._between(situation.obstacles([situation.ids[0], opponent], {}))

    def _aim(self, opponent: AgentId, av: Path) -> None:
        situation, name = self._situation, self._situation.ids[0]
        every = slice(_EVERY - 1, None, _EVERY)
        self._av = situation.discs(name, av)[every]
        self._there = av.there[every]
        self._reach = situation.radius(name) + situation.radius(opponent)

    def _between(self, others: Obstacles | None) -> Obstacles | None:
        """Those that come between the opponent and the AV's rollout, or near them."""
        if others is None:
            return None
        ends = torch.cat([self._pose[None, :2], self._av[self._there].flatten(0, 1)])
        low, high = ends.amin(0) - _BESIDE_M, ends.amax(0) + _BESIDE_M
        rare = slice(_EVERY * _SPARSE - 1, None, _EVERY * _SPARSE)
        discs, there = others.discs[:, rare], others.there[:, rare]
        inside = ((discs > low) & (discs < high)).all(-1).any(-1) & there
        kept = inside.any(-1)
        return Obstacles(discs[kept], others.radius[kept], there[kept])

    def draw(
        self, samples: int, steps: int, reach: float, rng: np.random.Generator, deadline: float
    ) -> Floats:
        """(S, 80, 2) guided motions in the opponent's frame of now; see `DiffusionPrior.sample`."""
        noise = torch.from_numpy(rng.standard_normal((samples, COMPONENTS))).float()
        with torch.no_grad():
            seen = self._net.encode(self._situation.graph).of(self._row, samples)
        clean = self._net.sample(seen, noise, steps, self, reach, deadline)
        position = joined(self._net.positions(clean, self.speed), self.speed)
        return np.asarray(position.detach().double())

    def __call__(self, clean: Tensor) -> Tensor:
        """(S) costs of components (S, C)."""
        position = joined(self._net.positions(clean, self.speed), self.speed)
        rare, hard = self.constraints(position).mean(-1), self._beyond_limits(position)
        return self.gap(position) + rare + self._terms.hardness * hard

    def costs_until(self, position_m: Floats, steps: Ints) -> Floats:
        """(S) costs of road and others of motions (S, 80, 2), mean over their first steps (S)."""
        at = torch.arange(_EVERY * _SPARSE, FUTURE_STEPS + 1, _EVERY * _SPARSE)
        counts = (at <= torch.from_numpy(steps).unsqueeze(-1)).double()
        with torch.no_grad():
            each = self.constraints(torch.from_numpy(position_m).float()).double()
        return np.asarray((each * counts).sum(-1) / counts.sum(-1).clamp_min(1.0))

    def gap(self, position: Tensor) -> Tensor:
        """(S) soft least distance to the AV from 2 s on; 0 in contact."""
        place, heading = self._placed(position)
        own = costs.disc_centres(place, heading, self._size, DISCS)
        apart = costs.apart(own, self._av) - self._reach
        near = apart.masked_fill(~self._there, 1e4)[:, _FREE:]
        soft = ((-near.detach()).softmax(-1) * near).sum(-1)
        return (soft + DEPTH_M).clamp_min(0.0)

    def constraints(self, position: Tensor) -> Tensor:
        """(S, 20) of motions (S, 80, 2), every 0.4 s: off the road, and overlap with others."""
        terms, rare = self._terms, slice(_SPARSE - 1, None, _SPARSE)
        place, heading = self._placed(position)
        place, heading = place[:, rare], heading[:, rare]
        total = torch.zeros_like(heading)
        if self._tree is not None:
            # The nearest point of a place hardly changes with it, so that it needs no gradient.
            _, nearest = self._tree.query(place.detach().numpy())
            offset = place - self._road[torch.from_numpy(nearest)]
            distance = (offset.square().sum(-1) + 1e-6).sqrt()
            away = (distance - self._allowed).clamp_min(0.0)
            total = terms.off_road * away * (place.norm(dim=-1) < _KNOWN_M)
        others = self._others
        if others is not None and len(others.radius):
            own = costs.disc_centres(place, heading, self._size, DISCS)
            radius = costs.disc_radius(self._size)
            depth = costs.overlap(own.unsqueeze(1), others.discs, radius, others.radius[:, None])
            total = total + terms.others * (depth * others.there).sum(1)
        return total

    def _placed(self, position: Tensor) -> tuple[Tensor, Tensor]:
        """Motions (S, 80, 2) every 0.2 s in the graph's frame, and headings (S, 40)."""
        moved = position[:, _EVERY - 1 :: _EVERY]
        before = torch.cat([torch.zeros_like(moved[:, :1]), moved[:, :-1]], 1)
        step = moved - before
        fast = step.norm(dim=-1) >= _SLOW_M
        step = torch.where(fast.unsqueeze(-1), step, step.new_tensor([1.0, 0.0]))
        turn = torch.atan2(step[..., 1], step[..., 0])
        known = torch.cat([torch.zeros_like(turn[:, :1]), turn], 1)
        valid = torch.arange(1, fast.shape[1] + 1) * fast  # 0: the direction of now
        heading = known.gather(1, valid.cummax(1).values) + self._pose[2]
        return self._pose[:2] + turned(moved, self._pose[2].expand(moved.shape[:-1])), heading

    def _beyond_limits(self, position: Tensor) -> Tensor:
        """(S) mean m/s2 beyond the limits, over time."""
        terms, span = self._terms, round(KNOT_S / DT_S)
        knots = torch.cat([torch.zeros_like(position[:, :1]), position[:, span - 1 :: span]], 1)
        now = torch.stack([self.speed, torch.zeros_like(self.speed)]).expand(len(knots), 1, 2)
        velocity = torch.cat([now, torch.diff(knots, dim=1) / KNOT_S], 1)
        # A mean velocity is that of the middle: the first is half as far from now.
        span_s = velocity.new_tensor([KNOT_S / 2] + [KNOT_S] * (KNOTS - 1))
        speed = (velocity.square().sum(-1) + 1e-4).sqrt()
        accel = torch.diff(speed, dim=1) / span_s
        cross = velocity[:, :-1, 0] * velocity[:, 1:, 1] - velocity[:, :-1, 1] * velocity[:, 1:, 0]
        lateral = cross.abs() / speed[:, 1:].clamp_min(1.0) / span_s
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
