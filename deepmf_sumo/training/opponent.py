"""Training of the opponent network."""

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors.opponent import OpponentNet
from deepmf_sumo.training import losses
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.schedule import Loss, tensors

_TEMPERATURES = np.round(np.arange(0.3, 3.01, 0.05), 2)
_SCALE = 10.0
"""Of the focal losses, which are small."""
_CHOICE = 0.1
"""Weight of the choice among the vehicles of a scene."""


def loss_of(net: OpponentNet) -> Loss:
    """Focal loss of the pseudo-labels, and of the labelled partner where a scene names one.

    The partner is one of the scene's vehicles, so its head learns the choice among them as well.
    Each member of the network has its own loss.
    """

    def loss(batch: dict[str, Tensor], _: torch.Generator) -> Tensor:
        logits: Tensor = net(batch).float()
        there = batch["vehicle"].expand(logits.shape[:-1])
        interacts = batch["interacts"].expand_as(there)
        first = (losses.focal(logits[..., 0], interacts) * there).sum() / there.sum()
        named = batch["partner_known"] > 0
        if not named.any():
            return _SCALE * first
        partner, among = batch["partner"][named].expand_as(there[:, named]), there[:, named]
        score = logits[:, named, :, 1]
        second = (losses.focal(score, partner) * among).sum() / among.sum()
        choice = -(score.masked_fill(among < 1, -1e4).log_softmax(-1) * partner).sum(-1).mean()
        total: Tensor = _SCALE * (first + second) + _CHOICE * choice
        return total

    return loss


@torch.inference_mode()
def held_out_logits(net: OpponentNet, cache: Cache) -> tuple[Tensor, Tensor, Tensor]:
    """Of held-out scenes: logits and labels (N, 2) of vehicles, and whether a partner is named."""
    net.eval().cpu()
    parts = []
    rows = cache.rows(held_out=True)
    for begin in range(0, len(rows), 64):
        batch = tensors(cache.batch(rows[begin : begin + 64]))
        there = batch["vehicle"] > 0
        known = batch["partner_known"].unsqueeze(1).expand_as(there)
        labels = torch.stack([batch["interacts"], batch["partner"]], -1)
        parts.append((net(batch).mean(0)[there], labels[there], known[there] > 0))
    logits, labels, known = (torch.cat(column) for column in zip(*parts, strict=True))
    return logits, labels, known


def fit_temperatures(net: OpponentNet, cache: Cache) -> tuple[float, float]:
    """Temperatures of both heads with the least held-out cross-entropy."""
    if len(cache.rows(held_out=True)) == 0:
        return 1.0, 1.0
    logits, labels, known = held_out_logits(net, cache)
    first = _fitted(logits[:, 0], labels[:, 0])
    return first, _fitted(logits[known, 1], labels[known, 1])


def _fitted(logits: Tensor, labels: Tensor) -> float:
    if len(logits) == 0:
        return 1.0
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    costs = [float(entropy(logits / each, labels)) for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(costs))])
