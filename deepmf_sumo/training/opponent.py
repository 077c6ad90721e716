"""Training of the opponent network."""

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors.opponent import OpponentNet
from deepmf_sumo.training import losses
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.loop import Loss, tensors

_TEMPERATURES = np.round(np.arange(0.3, 3.01, 0.05), 2)


def loss_of(net: OpponentNet) -> Loss:
    """Focal loss of the pseudo-labels, and of the labelled partner where a scene names one."""

    def loss(batch: dict[str, Tensor], _: torch.Generator) -> Tensor:
        logits = net(batch)
        mask = batch["candidate"]
        first = (losses.focal(logits[..., 0], batch["interacts"]) * mask).sum() / mask.sum()
        named = mask * batch["partner_known"].unsqueeze(1)
        second = losses.focal(logits[..., 1], batch["partner"]) * named
        return 10.0 * (first + second.sum() / named.sum().clamp_min(1.0))

    return loss


@torch.inference_mode()
def held_out_logits(net: OpponentNet, cache: Cache) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of held-out scenes: logits and labels (N, 2) of candidates, and which of them count."""
    net.eval().cpu()
    parts = []
    rows = cache.rows(held_out=True)
    for begin in range(0, len(rows), 64):
        batch = tensors(cache.batch(rows[begin : begin + 64]))
        mask = batch["candidate"] > 0
        known = batch["partner_known"].unsqueeze(1).expand_as(mask)
        labels = torch.stack([batch["interacts"], batch["partner"]], -1)
        parts.append((net(batch)[mask], labels[mask], known[mask], mask[mask]))
    logits, labels, known, there = (torch.cat(column) for column in zip(*parts, strict=True))
    return logits, labels, known, there


def fit_temperatures(net: OpponentNet, cache: Cache) -> tuple[float, float]:
    """Temperatures of both heads with the least held-out cross-entropy."""
    if len(cache.rows(held_out=True)) == 0:
        return 1.0, 1.0
    logits, labels, known, there = held_out_logits(net, cache)
    best = []
    for head, count in ((0, there), (1, known > 0)):
        score, label = logits[count, head], labels[count, head]
        if len(score) == 0:
            best.append(1.0)
            continue
        nll = [
            float(torch.nn.functional.binary_cross_entropy_with_logits(score / t, label))
            for t in _TEMPERATURES
        ]
        best.append(float(_TEMPERATURES[int(np.argmin(nll))]))
    return best[0], best[1]
