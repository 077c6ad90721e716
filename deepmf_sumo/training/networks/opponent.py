"""Training of the opponent network."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.deepmf.networks.opponent_net import OpponentNet
from deepmf_sumo.training.fit.loop import Loss, in_batches
from deepmf_sumo.training.samples.dataset import Dataset

_ALPHA: Final = 0.75
"""One label in ten is positive, so positives have more weight. The paper gives neither value."""
_GAMMA: Final = 2.0
_TEMPERATURES = np.round(np.arange(0.3, 3.01, 0.05), 2)
_SCALE = 10.0
"""Factor of the focal losses, which are small."""
_CHOICE = 0.1
"""Weight of the choice among the vehicles of a scene."""


def focal(logits: Tensor, labels: Tensor, alpha: float = _ALPHA, gamma: float = _GAMMA) -> Tensor:
    """Focal loss (Lin et al. 2017), elementwise; the paper's equation (1)."""
    probability = torch.sigmoid(logits)
    right = torch.where(labels > 0.5, probability, 1 - probability)
    weight = torch.where(labels > 0.5, alpha, 1 - alpha)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    return weight * (1 - right) ** gamma * entropy


def focal_link(alpha: float = _ALPHA, gamma: float = _GAMMA) -> tuple[float, float]:
    """Temperature and offset that turn logits trained with `focal` into frequencies.

    The minimum of the loss is not where the sigmoid q equals the frequency p, but where
    alpha p s(q) = (1 - alpha) (1 - p) s(1 - q), with s the slope of (1 - q)^gamma log q
    (Charoenphakdee et al. 2021). The log odds of p are nearly linear in the logit: this is their
    tangent at 0, whose error at logits of +-4 is .3 of 12.
    """
    log_2 = math.log(2.0)
    steepness = (gamma * (gamma - 1) * log_2 + 2 * gamma + 1) / (gamma * log_2 + 1)
    return 1 / steepness, math.log((1 - alpha) / alpha)


def loss_of(net: OpponentNet) -> Loss:
    """Focal loss of the pseudo-labels, and of the labelled partner if a scene names one.

    The partner is one of the scene's vehicles, so its head also learns the choice among them. Each
    member of the network has its own loss.
    """

    def loss(batch: dict[str, Tensor], _: torch.Generator) -> Tensor:
        logits: Tensor = net(batch).float()
        there = batch["vehicle"].expand(logits.shape[:-1])
        interacts = batch["interacts"].expand_as(there)
        first = (focal(logits[..., 0], interacts) * there).sum() / there.sum()
        named = batch["partner_known"] > 0
        if not named.any():
            return _SCALE * first
        partner, among = batch["partner"][named].expand_as(there[:, named]), there[:, named]
        score = logits[:, named, :, 1]
        second = (focal(score, partner) * among).sum() / among.sum()
        choice = -(score.masked_fill(among < 1, -1e4).log_softmax(-1) * partner).sum(-1).mean()
        total: Tensor = _SCALE * (first + second) + _CHOICE * choice
        return total

    return loss


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """Calibration of logits: ``sigmoid(logit / temperature + offset)``.

    Attributes:
        temperature, offset: of the first head, from its loss.
        partner_temperature: of the second head, which only ranks; fitted.
    """

    temperature: float
    offset: float
    partner_temperature: float


def calibrate(net: OpponentNet, dataset: Dataset) -> Calibration:
    """Calibrate the first head by `focal_link`, the second by held-out cross-entropy.

    Nothing is fitted for the first head: on other scenes the loss's own link is closer to
    frequencies than a fit to the held-out scenes (studies/notebook/predictors.md).
    """
    temperature, offset = focal_link()
    logits, labels = _partners(net, dataset)
    return Calibration(
        temperature=temperature, offset=offset, partner_temperature=_fitted(logits, labels)
    )


@torch.inference_mode()
def _partners(net: OpponentNet, dataset: Dataset) -> tuple[Tensor, Tensor]:
    """(N) logits and labels of the vehicles in held-out scenes that name a partner."""
    net.eval().cpu()
    rows = dataset.rows(held_out=True)
    logits, labels = [torch.zeros(0)], [torch.zeros(0)]
    for batch in in_batches(dataset, rows, 64):
        there = (batch["vehicle"] > 0) & (batch["partner_known"].unsqueeze(1) > 0)
        logits.append(net(batch).mean(0)[..., 1][there])
        labels.append(batch["partner"][there])
    return torch.cat(logits), torch.cat(labels)


def _fitted(logits: Tensor, labels: Tensor) -> float:
    if len(logits) == 0:
        return 1.0
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    costs = [float(entropy(logits / each, labels)) for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(costs))])
