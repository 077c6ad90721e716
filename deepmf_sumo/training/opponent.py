"""Training of the opponent network."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.predictors.opponent import OpponentNet
from deepmf_sumo.predictors.opponent_features import KNOWN_SHARE, PARKED, STANDS_IN
from deepmf_sumo.training import losses
from deepmf_sumo.training.cache import Cache
from deepmf_sumo.training.schedule import Loss, tensors

_TEMPERATURES = np.round(np.arange(0.3, 3.01, 0.05), 2)
_FINE_TEMPERATURES = np.geomspace(0.2, 3.0, 110).round(3)
_OFFSETS = np.round(np.arange(-3.0, 3.01, 0.05), 2)
_GAIN = 2.0
"""Nats that temperature and offset must gain to be fitted: one each (Akaike 1974)."""
_WHOLE = 0.99
"""Share of the next 8 s that is known, but for rounding: all."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What makes sigmoids of logits frequencies: ``sigmoid(logit / temperature + offset)``.

    Attributes:
        temperature, offset: of the first head.
        partner_temperature: of the second head, which only ranks.
    """

    temperature: float = 1.0
    offset: float = 0.0
    partner_temperature: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut:
    """N vehicles of held-out scenes.

    Attributes:
        logits, labels: (N, 2). known: (N) whether the scene names a partner.
        asked: (N) whether an attack would ask for it: not parked, seen by the AV itself, and the
            label knows the next 8 s. A shorter rest of the recording has fewer positives.
    """

    logits: Tensor
    labels: Tensor
    known: Tensor
    asked: Tensor


@torch.inference_mode()
def held_out(net: OpponentNet, cache: Cache) -> HeldOut:
    """Of all held-out samples."""
    net.eval().cpu()
    parts = []
    rows = cache.rows(held_out=True)
    for begin in range(0, len(rows), 64):
        batch = tensors(cache.batch(rows[begin : begin + 64]))
        there = batch["vehicle"] > 0
        known = batch["partner_known"].unsqueeze(1).expand_as(there) > 0
        labels = torch.stack([batch["interacts"], batch["partner"]], -1)
        pair = batch["pair"]
        asked = (pair[..., PARKED] == 0) & (pair[..., STANDS_IN] == 0)
        asked &= pair[..., KNOWN_SHARE] > _WHOLE
        of_all = net(batch).mean(0), labels, known, asked
        parts.append(tuple(each[there] for each in of_all))
    logits, labels, known, asked = (torch.cat(column) for column in zip(*parts, strict=True))
    return HeldOut(logits=logits, labels=labels, known=known, asked=asked)


def calibrate(net: OpponentNet, cache: Cache) -> Calibration:
    """What the focal loss implies; where held-out scenes say so, a fit to them (Platt 1999)."""
    if len(cache.rows(held_out=True)) == 0:
        temperature, offset = losses.focal_link()
        return Calibration(temperature=temperature, offset=offset)
    found = held_out(net, cache)
    asked = found.asked
    positives = float(found.labels[asked, 0].sum())
    if positives in (0.0, float(asked.sum())):  # says nothing: better all that there is
        asked = torch.ones_like(asked)
    temperature, offset = _platt(found.logits[asked, 0], found.labels[asked, 0])
    return Calibration(
        temperature=temperature,
        offset=offset,
        partner_temperature=_fitted(found.logits[found.known, 1], found.labels[found.known, 1]),
    )


def _platt(logits: Tensor, labels: Tensor) -> tuple[float, float]:
    """Temperature and offset; those of `focal_link` unless others explain the labels better."""
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    best = losses.focal_link()
    least = float(entropy(logits / best[0] + best[1], labels, reduction="sum")) - _GAIN
    offsets = torch.from_numpy(_OFFSETS).float().unsqueeze(1)
    labels = labels.expand(len(offsets), -1)
    for temperature in _FINE_TEMPERATURES:
        costs = entropy(logits / temperature + offsets, labels, reduction="none").sum(1)
        row = int(costs.argmin())
        if float(costs[row]) < least:
            best, least = (float(temperature), float(_OFFSETS[row])), float(costs[row])
    return best


def _fitted(logits: Tensor, labels: Tensor) -> float:
    if len(logits) == 0:
        return 1.0
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    costs = [float(entropy(logits / each, labels)) for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(costs))])
