"""One round of messages among the vehicles of a graph, gathered by their maximum."""

from typing import Final

import torch
from torch import Tensor, nn

EDGE: Final = 9
_NEAR_M: Final = 10.0


class Messages(nn.Module):
    """max over j of ReLU(W_i h_i + W_j h_j + W_e e_ij): what each vehicle hears of the others.

    The first layer is split by its inputs, so that only edge features are computed pair by pair.
    """

    def __init__(self, hidden: int) -> None:
        super().__init__()
        width = hidden // 2  # there are as many edges as vehicles squared
        self.receiver = nn.Linear(hidden, width)
        self.sender = nn.Linear(hidden, width, bias=False)
        self.edge = nn.Linear(EDGE, width, bias=False)
        self.out = nn.Linear(width, hidden)

    def forward(self, nodes: Tensor, edges: Tensor, linked: Tensor) -> Tensor:
        """(B, N, H), (B, N, N, E), mask (B, N, N) -> (B, N, H); zero without messages."""
        sent = (
            self.receiver(nodes).unsqueeze(2) + self.sender(nodes).unsqueeze(1) + self.edge(edges)
        )
        heard = sent.relu().masked_fill(~linked.unsqueeze(-1), 0.0).amax(2)
        return self.out(heard)


def edge_features(position: Tensor, heading: Tensor, speed: Tensor, size: Tensor) -> Tensor:
    """(B, N, N, 9) the other's (axis 2) place and motion as each vehicle (axis 1) sees it.

    Position (B, N, 2) in one frame, heading and speed (B, N), size (B, N, 2).
    """
    offset = position.unsqueeze(1) - position.unsqueeze(2)
    cos, sin = heading.cos().unsqueeze(2), heading.sin().unsqueeze(2)
    ahead = offset[..., 0] * cos + offset[..., 1] * sin
    left = offset[..., 1] * cos - offset[..., 0] * sin
    turn = heading.unsqueeze(1) - heading.unsqueeze(2)
    closing = speed.unsqueeze(1) * turn.cos() - speed.unsqueeze(2)
    crossing = speed.unsqueeze(1) * turn.sin()
    near = torch.exp(-(offset.square().sum(-1) + 1e-6).sqrt() / _NEAR_M)
    length = (size[..., 0].unsqueeze(1) + size[..., 0].unsqueeze(2)) / 10.0
    return torch.stack(
        [
            ahead / 30.0,
            left / 30.0,
            torch.tanh(left / 3.0),  # in or beside the way ahead
            turn.cos(),
            turn.sin(),
            closing / 10.0,
            crossing / 10.0,
            near,
            length,
        ],
        -1,
    )


def linked(there: Tensor) -> Tensor:
    """(B, N, N) pairs of different vehicles of mask (B, N)."""
    others = ~torch.eye(there.shape[1], dtype=torch.bool, device=there.device)
    return there.unsqueeze(1) & there.unsqueeze(2) & others
