"""DiffScene's network: a diffusion model of how a vehicle drives in the next 8 s.

Source: Xu et al., DiffScene, AdvML-Frontiers workshop at ICML 2023, which publishes no code and no
sizes. Ours: motions are principal components of the positions (MotionDiffuser: Jiang et al.,
CVPR 2023), so that samples are smooth and a gradient on a position moves the whole motion; the
preconditioning, noise levels and sampler are those of EDM (Karras et al., NeurIPS 2022), with
components of unit variance. The network reads what STRIVE's reads: the past of a graph of
vehicles, and the ways that the lanes offer.
"""

import math
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from deepmf_sumo.baselines.priors.messages import Messages, linked
from deepmf_sumo.baselines.priors.strive import (
    edges_of,
    kept_nodes,
    mlp,
    past_of,
    paths_of,
)
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.lanes import PathInfo
from deepmf_sumo.scene import HISTORY_STEPS

KNOTS: Final = 16
"""Positions of a motion: every 0.5 s."""
KNOT_S: Final = 0.5
COMPONENTS: Final = 10
NOISIEST: Final = 10.0
CLEANEST: Final = 0.02
_CURVED: Final = 7.0  # rho of EDM's noise levels
_BLOCKS: Final = 3
_FREQUENCIES: Final = 8


class Seen(NamedTuple):
    """What the past says of vehicles (...): nodes (..., H), keys (..., P, H), offered (..., P)."""

    nodes: Tensor
    keys: Tensor
    offered: Tensor

    def of(self, row: int, count: int) -> "Seen":
        """One vehicle of one graph, repeated."""
        return Seen(*(part[0, row].expand(count, *part.shape[2:]) for part in self))


Guide = Callable[[Tensor], Tensor]
"""Clean components (S, C) -> costs (S), differentiable."""


class DiffusionPrior(nn.Module):
    """p(motion | past, map) of each vehicle, by denoising.

    Attributes:
        mean: (32) of the positions less those at constant speed. basis: (C, 32) of components
            with unit variance. Both are fitted before the training.
    """

    mean: Tensor
    basis: Tensor

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.preset = preset
        hidden = preset.hidden
        self.past = mlp(HISTORY_STEPS * 7 + 8, hidden)
        self.path = mlp(2 * kept_nodes() + len(PathInfo), hidden)
        self.choice = nn.Linear(hidden, hidden)
        self.node = mlp(2 * hidden, hidden)
        self.messages = Messages(hidden)
        self.context = mlp(2 * hidden, hidden)
        self.begin = mlp(COMPONENTS + hidden + 2 * _FREQUENCIES, 2 * hidden)
        self.blocks = nn.ModuleList(_Block(hidden) for _ in range(_BLOCKS))
        self.end = nn.Linear(2 * hidden, COMPONENTS)
        nn.init.zeros_(self.end.weight)
        nn.init.zeros_(self.end.bias)
        self.register_buffer("mean", torch.zeros(2 * KNOTS))
        self.register_buffer("basis", torch.zeros(COMPONENTS, 2 * KNOTS))

    def encode(self, graph: dict[str, Tensor]) -> Seen:
        """What a graph says before any future is known."""
        there = graph["kind"][..., 2] > 0
        past = self.past(past_of(graph))
        keys = self.path(paths_of(graph))
        offered = graph["way_info"][..., 0] > 0
        read = _read(self.choice(past), keys, offered)
        nodes = self.node(torch.cat([past, read], -1))
        heard = self.messages(nodes, edges_of(graph), linked(there))
        return Seen(self.context(torch.cat([nodes, heard], -1)), keys, offered)

    def denoised(self, noisy: Tensor, level: Tensor, seen: Seen) -> Tensor:
        """The expected clean components (..., C) of noisy ones at noise levels (...)."""
        level = level.unsqueeze(-1)
        scale = (1 + level**2).rsqrt()
        steps = torch.arange(_FREQUENCIES, device=noisy.device)
        turn = level.log() * 0.25 * (2.0**steps)
        inputs = torch.cat([noisy * scale, seen.nodes, turn.sin(), turn.cos()], -1)
        hidden = self.begin(inputs)
        for block in self.blocks:
            hidden = block(hidden, seen)
        found: Tensor = noisy * scale**2 + self.end(hidden) * level * scale
        return found

    def positions(self, clean: Tensor, speed: Tensor) -> Tensor:
        """(..., 16, 2) every 0.5 s, in the own frame, of components (..., C) and speeds now."""
        moved = self.mean + clean @ self.basis
        return moved.view(*clean.shape[:-1], KNOTS, 2) + at_constant_speed(speed)

    def components(self, position: Tensor, speed: Tensor) -> Tensor:
        """Components (..., C) of positions (..., 16, 2): the inverse of `positions`."""
        moved = (position - at_constant_speed(speed)).flatten(-2) - self.mean
        return moved @ torch.linalg.pinv(self.basis)

    def sample(
        self,
        seen: Seen,
        noise: Tensor,
        steps: int,
        guide: Guide,
        reach: float,
        deadline: float = math.inf,
    ) -> Tensor:
        """Clean components (S, C) from normal noise (S, C), moved towards lower costs of the guide.

        EDM's deterministic sampler by Euler steps. The guide's gradient goes through the network,
        and moves the expected motion by at most ``reach`` times the noise that is left (with
        respect to 1): a motion is guided as long as it is still undecided. After the deadline, of
        `time.perf_counter`, the expected motions of the level that was reached are returned.
        """
        levels = noise_levels(steps)
        noisy = noise * levels[0]
        for now, after in pairwise(levels.tolist()):
            late = deadline < math.inf and time.perf_counter() > deadline
            noisy = noisy.detach().requires_grad_(reach > 0 and not late)
            clean = self.denoised(noisy, noisy.new_full(noisy.shape[:-1], now), seen)
            if late:
                return clean.detach()
            if reach > 0:
                (pull,) = torch.autograd.grad(guide(clean).sum(), noisy)
                clean = clean - _bounded(now**2 * pull, reach * now / (1 + now))
            noisy = (noisy + (after - now) * (noisy - clean) / now).detach()
        return noisy


class _Block(nn.Module):
    """Reads the ways that a noisy motion asks for."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(2 * hidden)
        self.query = nn.Linear(2 * hidden, hidden)
        self.change = nn.Sequential(
            nn.Linear(4 * hidden, 2 * hidden), nn.ReLU(), nn.Linear(2 * hidden, 2 * hidden)
        )

    def forward(self, hidden: Tensor, seen: Seen) -> Tensor:
        """(..., 2H) changed."""
        normed = self.norm(hidden)
        read = _read(self.query(normed), seen.keys, seen.offered)
        changed: Tensor = hidden + self.change(torch.cat([normed, read, seen.nodes], -1))
        return changed


def noise_levels(steps: int) -> Tensor:
    """(steps + 1) EDM's levels, from the noisiest to 0."""
    share = torch.linspace(0, 1, steps)
    first, last = NOISIEST ** (1 / _CURVED), CLEANEST ** (1 / _CURVED)
    return torch.cat([(first + share * (last - first)) ** _CURVED, torch.zeros(1)])


def at_constant_speed(speed: Tensor) -> Tensor:
    """(..., 16, 2) positions straight on at speeds (...)."""
    times = torch.arange(1, KNOTS + 1, device=speed.device) * KNOT_S
    ahead = speed.unsqueeze(-1) * times
    return torch.stack([ahead, torch.zeros_like(ahead)], -1)


def _read(query: Tensor, keys: Tensor, offered: Tensor) -> Tensor:
    """(..., H) the ways (..., P, H) that queries (..., H) ask for."""
    scores = (keys * query.unsqueeze(-2)).sum(-1) / keys.shape[-1] ** 0.5
    share = scores.masked_fill(~offered, -1e4).softmax(-1)
    return (share.unsqueeze(-1) * keys).sum(-2)


def _bounded(shift: Tensor, most: float) -> Tensor:
    """(S, C) no longer than ``most``."""
    return shift * (most / shift.norm(dim=-1, keepdim=True).clamp_min(most))
