"""STRIVE's network: prior and posterior over a latent of each vehicle, and the decoder.

Source: Rempe et al., CVPR 2022: a conditional VAE over a graph of agents. Adapted: encoded lane
paths in place of a raster of the map, latents of 16 numbers, one GRU layer, controls every 0.5 s
joined linearly.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from deepmf_sumo.baselines.priors import bicycle
from deepmf_sumo.baselines.priors.bicycle import CONTROLS, SUBSTEPS
from deepmf_sumo.baselines.priors.graph import NODES, SPACING_M
from deepmf_sumo.baselines.priors.messages import Messages, edge_features, linked
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.lanes import PathInfo
from deepmf_sumo.scene import HISTORY_STEPS

LATENT: Final = 16
_NODE_STRIDE: Final = 2
_LOOK_M: Final = (0.0, 2.0, 5.0, 10.0)
_LOOK_S: Final = (0.0, 0.3, 0.8, 1.5)
"""Points of its way that a driver steers by: metres, and seconds at its speed, ahead."""
_INPUTS: Final = 3 + 2 * len(_LOOK_M) + len(PathInfo)
_LOG_SIGMA: Final = (-4.0, 2.0)


class Gaussian(NamedTuple):
    """Independent normal distributions: mean and log of the standard deviation, (B, N, 16)."""

    mean: Tensor
    log_sigma: Tensor

    def draw(self, noise: Tensor) -> Tensor:
        """A sample, differentiable in the parameters."""
        return self.mean + self.log_sigma.exp() * noise

    def divergence(self, other: "Gaussian") -> Tensor:
        """(B, N) KL(self || other), nats."""
        ratio = (2 * (self.log_sigma - other.log_sigma)).exp()
        shift = ((self.mean - other.mean) * (-other.log_sigma).exp()).square()
        return 0.5 * (ratio + shift - 1).sum(-1) + (other.log_sigma - self.log_sigma).sum(-1)


class Context(NamedTuple):
    """What the past says: nodes (B, N, H), keys of the paths (B, N, P, H), and the prior."""

    nodes: Tensor
    keys: Tensor
    prior: Gaussian


class DecodedMotions(NamedTuple):
    """Decoded motion of each vehicle in its own frame: (B, N, 80, 2), (B, N, 80), (B, N, 80)."""

    position: Tensor
    heading: Tensor
    speed: Tensor

    def placed(self, graph: dict[str, Tensor]) -> "DecodedMotions":
        """The same in the graph's frame: that of its first vehicle."""
        pose = graph["pose"].unsqueeze(2)
        position = pose[..., :2] + turned(self.position, pose[..., 2])
        return DecodedMotions(position, pose[..., 2] + self.heading, self.speed)

    def knots(self) -> "DecodedMotions":
        """Every 0.5 s only."""
        every = slice(SUBSTEPS - 1, None, SUBSTEPS)
        return DecodedMotions(
            self.position[:, :, every], self.heading[:, :, every], self.speed[:, :, every]
        )


class MotionPrior(nn.Module):
    """p(z | past, map), q(z | past, map, future) and the decoder p(motion | z, past, map).

    Attributes:
        seen: batches trained on so far; the weight of the divergence grows with them.
    """

    seen: Tensor

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.preset = preset
        hidden = preset.hidden
        self.past = mlp(HISTORY_STEPS * 7 + 8, hidden)
        self.path = mlp(2 * kept_nodes() + len(PathInfo), hidden)
        self.choice = nn.Linear(hidden, hidden)
        self.node = mlp(2 * hidden, hidden)
        self.prior_messages = Messages(hidden)
        self.prior_head = _gaussian_head(2 * hidden, hidden)
        self.future = mlp(CONTROLS * 4 + hidden, hidden)
        self.posterior_messages = Messages(hidden)
        self.posterior_head = _gaussian_head(2 * hidden, hidden)
        self.begin = mlp(hidden + LATENT, hidden)
        self.way = nn.Linear(hidden, hidden)
        self.heard = Messages(hidden)
        self.gru = nn.GRUCell(hidden + _INPUTS + LATENT, hidden)
        self.control = nn.Linear(hidden, 2)
        nn.init.zeros_(self.control.bias)
        self.control.weight.data *= 0.1  # begins with straight motion at constant speed
        self.register_buffer("seen", torch.zeros((), dtype=torch.long))

    def encode(self, graph: dict[str, Tensor]) -> Context:
        """What a graph says before any future is known."""
        there = graph["kind"][..., 2] > 0
        past = self.past(past_of(graph))
        keys = self.path(paths_of(graph))
        offered = graph["way_info"][..., 0] > 0
        scores = (keys * self.choice(past).unsqueeze(2)).sum(-1) / keys.shape[-1] ** 0.5
        share = scores.masked_fill(~offered, -1e4).softmax(-1)
        nodes = self.node(torch.cat([past, (share.unsqueeze(-1) * keys).sum(2)], -1))
        heard = self.prior_messages(nodes, edges_of(graph), linked(there))
        prior = _gaussian(self.prior_head(torch.cat([nodes, heard], -1)))
        return Context(nodes, keys, prior)

    def posterior(self, graph: dict[str, Tensor], context: Context, future: Tensor) -> Gaussian:
        """Futures (B, N, 16, 4): x, y, heading in the own frame every 0.5 s, and whether known."""
        known = future[..., 3:]
        scale = future.new_tensor([1 / 30.0, 1 / 30.0, 1.0])
        shown = torch.cat([future[..., :3] * scale * known, known], -1).flatten(2)
        nodes = self.future(torch.cat([shown, context.nodes], -1))
        there = graph["kind"][..., 2] > 0
        heard = self.posterior_messages(nodes, edges_of(graph), linked(there))
        return _gaussian(self.posterior_head(torch.cat([nodes, heard], -1)))

    def decode(self, graph: dict[str, Tensor], context: Context, latent: Tensor) -> DecodedMotions:
        """The next 8 s of all vehicles under latents (B, N, 16): each sees where the others are."""
        there = linked(graph["kind"][..., 2] > 0)
        hidden = self.begin(torch.cat([context.nodes, latent], -1))
        way, info = self._way(graph, context, hidden)
        state = bicycle.start(graph["motion"])
        pose, driven, legs = graph["pose"], torch.zeros_like(state.speed), []
        for _ in range(CONTROLS):
            position = pose[..., :2] + turned(state.position, pose[..., 2])
            edges = edge_features(
                position, pose[..., 2] + state.heading, state.speed, graph["size"]
            )
            heard = self.heard(hidden, edges, there)
            seen = torch.cat([heard, _seen(state, way, info, driven), latent], -1)
            hidden = self.gru(seen.flatten(0, 1), hidden.flatten(0, 1)).view_as(hidden)
            controls = bicycle.controlled(self.control(hidden), state.speed)
            state, leg = bicycle.advance(state, *controls)
            driven = driven + leg.speed.mean(-1) * (SUBSTEPS * bicycle.STEP_S)
            legs.append(leg)
        return DecodedMotions(
            torch.cat([leg.position for leg in legs], 2),
            torch.cat([leg.heading for leg in legs], 2),
            torch.cat([leg.speed for leg in legs], 2),
        )

    def _way(
        self, graph: dict[str, Tensor], context: Context, hidden: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The way that the latent takes, a mixture of those offered (B, N, 49, 2); its info."""
        offered = graph["way_info"][..., 0] > 0
        scores = (context.keys * self.way(hidden).unsqueeze(2)).sum(-1) / hidden.shape[-1] ** 0.5
        share = scores.masked_fill(~offered, -1e4).softmax(-1)
        way = (share[..., None, None] * graph["ways"]).sum(2)
        return way, (share.unsqueeze(-1) * graph["way_info"]).sum(2)


def mlp(inputs: int, hidden: int) -> nn.Sequential:
    """Two layers with norms."""
    return nn.Sequential(
        nn.Linear(inputs, hidden), nn.LayerNorm(hidden), nn.ReLU(),
        nn.Linear(hidden, hidden), nn.LayerNorm(hidden), nn.ReLU(),
    )  # fmt: skip


def _gaussian_head(inputs: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, 2 * LATENT))


def _gaussian(numbers: Tensor) -> Gaussian:
    mean, log_sigma = numbers.chunk(2, -1)
    return Gaussian(mean, log_sigma.clamp(*_LOG_SIGMA))


def kept_nodes() -> int:
    """Nodes of a path that the networks read."""
    return len(range(0, NODES, _NODE_STRIDE))


def past_of(graph: dict[str, Tensor]) -> Tensor:
    """(B, N, 85) history, size, kind and motion, scaled."""
    scale = graph["history"].new_tensor([0.1, 0.1, 1, 1, 0.1, 0.1, 1])
    history = (graph["history"] * scale).flatten(2)
    motion = graph["motion"] * graph["motion"].new_tensor([0.1, 0.3, 1.0])
    return torch.cat([history, graph["size"] * 0.2, graph["kind"], motion], -1)


def paths_of(graph: dict[str, Tensor]) -> Tensor:
    """(B, N, 7, 64) every other node, and what is known of the path, scaled."""
    nodes = graph["ways"][..., ::_NODE_STRIDE, :].flatten(3) / 50.0
    return torch.cat([nodes, _scaled(graph["way_info"])], -1)


def _scaled(info: Tensor) -> Tensor:
    scale = [1, 1, 0.3, 1, 0.01, 0.1, 0.02, 1, 1, 1, 1, 1, 0.3, 0.2]
    return info * info.new_tensor(scale)


def edges_of(graph: dict[str, Tensor]) -> Tensor:
    """(B, N, N, 9) `edge_features` now."""
    pose = graph["pose"]
    return edge_features(pose[..., :2], pose[..., 2], graph["motion"][..., 0], graph["size"])


def turned(vectors: Tensor, angle: Tensor) -> Tensor:
    """(..., 2) turned counter-clockwise by (...)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors.unbind(-1)
    return torch.stack([x * cos - y * sin, x * sin + y * cos], -1)


def _seen(state: bicycle.BicycleState, way: Tensor, info: Tensor, driven: Tensor) -> Tensor:
    """(B, N, 25) own motion, points of the way ahead in the frame of now, the way's info."""
    metres, seconds = driven.new_tensor(_LOOK_M), driven.new_tensor(_LOOK_S)
    along = driven.unsqueeze(-1) + metres + seconds * state.speed.unsqueeze(-1)
    points = turned(
        _points_at(way, along) - state.position.unsqueeze(-2), -state.heading.unsqueeze(-1)
    )
    left = info.clone()
    left[..., 6] = (info[..., 6] - driven).clamp(-50.0, 100.0)  # to the stop line
    left[..., 4] = (info[..., 4] - driven).clamp_min(-50.0)  # to the end of the lanes
    own = torch.stack([state.speed / 10, state.acceleration / 3, state.curvature * 10], -1)
    return torch.cat([own, points.flatten(-2) / 10.0, _scaled(left)], -1)


def _points_at(way: Tensor, along: Tensor) -> Tensor:
    """(B, N, Q, 2) points of ways (B, N, 49, 2) at distances (B, N, Q); straight past the end."""
    place = along / SPACING_M
    before = place.detach().floor().clamp(0, way.shape[2] - 2).long()
    share = (place - before).unsqueeze(-1)
    index = before.unsqueeze(-1).expand(*before.shape, 2)
    first, last = way.gather(2, index), way.gather(2, index + 1)
    return first + share * (last - first)
