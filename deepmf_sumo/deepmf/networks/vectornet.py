"""VectorNet (Gao et al. 2020): polylines of vectors -> one feature each -> attention among them."""

import torch
from torch import Tensor, nn

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.features import Features

AGENT_VECTOR = 18
LANE_VECTOR = 16
POSITION_SCALE_M = 30.0
SPEED_SCALE_MPS = 15.0
_UNSEEN = -1e4
"""Score of missing elements: their share is zero, and defined even if all are missing."""


def as_batch(features: Features, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """A batch of one scene."""
    return {name: torch.from_numpy(values)[None].to(device) for name, values in features.items()}


class SubGraph(nn.Module):
    """Three layers of (linear, norm, ReLU, maximum, concatenate), then the maximum."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            nn.Sequential(nn.Linear(width, hidden // 2), nn.LayerNorm(hidden // 2), nn.ReLU())
            for width in (inputs, hidden, hidden)
        )

    def forward(self, vectors: Tensor, there: Tensor) -> Tensor:
        """(N, V, inputs) and mask (N, V) -> (N, hidden); zero for polylines without vectors."""
        gone = ~there.unsqueeze(-1)
        pooled = vectors
        for layer in self.layers:
            vectors = layer(vectors).masked_fill(gone, 0.0)  # ReLU: zero is below all others
            pooled = vectors.amax(1, keepdim=True).expand_as(vectors)
            vectors = torch.cat([vectors, pooled], -1)
        return vectors.amax(1)


class Attention(nn.Module):
    """Queries attend to elements (multi-head), with a residual and layer norm."""

    def __init__(self, hidden: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(hidden, hidden)
        self.keys = nn.Linear(hidden, 2 * hidden)
        self.out = nn.Linear(hidden, hidden)
        self.norm = nn.LayerNorm(hidden)

    def forward(self, queries: Tensor, elements: Tensor, there: Tensor) -> Tensor:
        """(B, Q, H) on elements (B, E, H) with mask (B, E), True where there -> (B, Q, H)."""
        query = self._heads(self.query(queries))
        key, value = map(self._heads, self.keys(elements).chunk(2, -1))
        scores = (query @ key.transpose(2, 3)).masked_fill(~there[:, None, None], _UNSEEN)
        return self._mixed(queries, self._share(scores) @ value)

    def with_own(
        self, query: Tensor, elements: Tensor, there: Tensor, own: Tensor, own_there: Tensor
    ) -> Tensor:
        """One query (B, 1, H) in K situations: each adds an element of its own to the shared ones.

        ``own`` (B, K, H) with mask (B, K) -> (B, K, H): as attending to (B*K, E + 1, H), but the
        keys of the shared elements are made once.
        """
        asked = self._heads(self.query(query))  # (B, heads, 1, D)
        key, value = map(self._heads, self.keys(elements).chunk(2, -1))
        own_key, own_value = map(self._heads, self.keys(own).chunk(2, -1))  # (B, heads, K, D)
        shared = (asked @ key.transpose(2, 3)).masked_fill(~there[:, None, None], _UNSEEN)
        alone = (asked @ own_key.transpose(2, 3)).masked_fill(~own_there[:, None, None], _UNSEEN)
        shared = shared.expand(-1, -1, own.shape[1], -1)  # (B, heads, K, E)
        share = self._share(torch.cat([shared, alone.transpose(2, 3)], -1))
        return self._mixed(query, share[..., :-1] @ value + share[..., -1:] * own_value)

    def _heads(self, vectors: Tensor) -> Tensor:
        """(B, N, H) -> (B, heads, N, D)."""
        return vectors.reshape(*vectors.shape[:2], self.heads, -1).transpose(1, 2)

    def _share(self, scores: Tensor) -> Tensor:
        return (scores / (self.query.out_features // self.heads) ** 0.5).softmax(-1)

    def _mixed(self, queries: Tensor, seen: Tensor) -> Tensor:
        """Queries (B, Q or 1, H) and what their heads saw (B, heads, Q, D) -> (B, Q, H)."""
        return self.norm(queries + self.out(seen.transpose(1, 2).flatten(2)))


class VectorNet(nn.Module):
    """Agents and lane pieces around a pose -> one feature each, aware of the others."""

    def __init__(self, preset: Preset) -> None:
        super().__init__()
        self.agents = SubGraph(AGENT_VECTOR, preset.hidden)
        self.lanes = SubGraph(LANE_VECTOR, preset.hidden)
        self.everything = Attention(preset.hidden, preset.heads)

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """`features.Features` -> features (B, A+L, H), agents first, and the mask (B, A+L)."""
        vectors, there = agent_vectors(batch["agents"], batch["agent_info"])
        agents = self.agents(vectors.flatten(0, 1), there.flatten(0, 1))  # (B*A, H)
        pieces, lane_there = lane_vectors(batch["lanes"], batch["lane_info"])
        lanes = self.lanes(pieces.flatten(0, 1), lane_there.flatten(0, 1))  # (B*L, H)
        size = len(batch["agents"])
        elements = torch.cat([agents.view(size, -1, agents.shape[-1]),
                              lanes.view(size, -1, lanes.shape[-1])], 1)  # fmt: skip
        mask = torch.cat([batch["agent_info"][..., 7], batch["lane_info"][..., 9]], 1) > 0
        return self.everything(elements, elements, mask), mask


def agent_vectors(agents: Tensor, info: Tensor) -> tuple[Tensor, Tensor]:
    """(B, A, 11, 7) and (B, A, 8) -> ten vectors an agent (B, A, 10, 18) and their mask."""
    start, end = agents[..., :-1, :], agents[..., 1:, :]
    there = (start[..., 6] > 0) & (end[..., 6] > 0)
    when = torch.linspace(-1.0, -0.1, 10, device=agents.device).expand(there.shape)
    vectors = torch.cat(
        [
            start[..., 0:2] / POSITION_SCALE_M,
            end[..., 0:2] / POSITION_SCALE_M,
            end[..., 2:4],
            end[..., 4:6] / SPEED_SCALE_MPS,
            (end[..., 0:2] - start[..., 0:2]),
            when.unsqueeze(-1),
            info.unsqueeze(-2).expand(*there.shape, 8)[..., 0:7]
            * info.new_tensor([0.2, 0.5, 1, 1, 1, 1, 1]),
        ],
        -1,
    )
    return vectors, there


def lane_vectors(lanes: Tensor, info: Tensor) -> tuple[Tensor, Tensor]:
    """(B, L, 10, 2) and (B, L, 10) -> nine vectors a piece (B, L, 9, 16) and their mask."""
    start, end = lanes[..., :-1, :], lanes[..., 1:, :]
    there = (info[..., 9:10] > 0).expand(start.shape[:-1])
    share = torch.linspace(0.0, 1.0, 9, device=lanes.device).expand(there.shape)
    scaled = info[..., 0:9] * info.new_tensor([1, 1, 1, 1, 1 / SPEED_SCALE_MPS, 1, 1, 1, 1])
    vectors = torch.cat(
        [
            start / POSITION_SCALE_M,
            end / POSITION_SCALE_M,
            (end - start) / 2.0,
            share.unsqueeze(-1),
            scaled.unsqueeze(-2).expand(*there.shape, 9),
        ],
        -1,
    )
    return vectors, there
