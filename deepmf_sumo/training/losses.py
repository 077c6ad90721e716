"""What training minimises."""

import math
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.predictors.anchors import KNOT_STEPS
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals

_ALPHA: Final = 0.75
"""With one positive in ten, positives are weighed up. The paper gives neither value."""
_GAMMA: Final = 2.0


def focal(logits: Tensor, labels: Tensor, alpha: float = _ALPHA, gamma: float = _GAMMA) -> Tensor:
    """Focal loss (Lin et al. 2017), elementwise; the paper's equation (1)."""
    probability = torch.sigmoid(logits)
    right = torch.where(labels > 0.5, probability, 1 - probability)
    weight = torch.where(labels > 0.5, alpha, 1 - alpha)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    return weight * (1 - right) ** gamma * entropy


def focal_link(alpha: float = _ALPHA, gamma: float = _GAMMA) -> tuple[float, float]:
    """Temperature and offset that make logits trained with `focal` frequencies.

    Its least value is not where the sigmoid q is the frequency p, but where alpha p s(q) =
    (1 - alpha) (1 - p) s(1 - q), s being the slope of (1 - q)^gamma log q (Charoenphakdee et al.
    2021). The log odds of p are nearly straight in the logit: this is their tangent at 0, which at
    logits of +-4 is .3 of 12 off.
    """
    log_2 = math.log(2.0)
    steepness = (gamma * (gamma - 1) * log_2 + 2 * gamma + 1) / (gamma * log_2 + 1)
    return 1 / steepness, math.log((1 - alpha) / alpha)


def mixture(net: DenseTNT, goals: Goals, batch: dict[str, Tensor]) -> Tensor:
    """(B) negative log density of what happened under all goals and their kernels.

    It trains scores and completion together: DenseTNT's nearest-goal likelihood is its limit for
    narrow kernels.
    """
    knots = list(KNOT_STEPS)
    true = batch["future"][:, None, knots]
    valid = batch["future_valid"][:, None, knots]
    return -net.log_density(goals, true, valid).flatten(1).logsumexp(1)
