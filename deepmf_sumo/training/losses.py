"""What training minimises."""

import torch
from torch import Tensor

from deepmf_sumo.predictors.anchors import KNOT_STEPS
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals


def focal(logits: Tensor, labels: Tensor, alpha: float = 0.75, gamma: float = 2.0) -> Tensor:
    """Focal loss (Lin et al. 2017), elementwise; the paper's equation (1).

    The paper gives no values. With one positive in ten, alpha weighs positives up.
    """
    probability = torch.sigmoid(logits)
    right = torch.where(labels > 0.5, probability, 1 - probability)
    weight = torch.where(labels > 0.5, alpha, 1 - alpha)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits(logits, labels, reduction="none")
    return weight * (1 - right) ** gamma * entropy


def mixture(net: DenseTNT, goals: Goals, batch: dict[str, Tensor]) -> Tensor:
    """(B) negative log density of what happened under all goals and their kernels.

    It trains scores and completion together: DenseTNT's nearest-goal likelihood is its limit for
    narrow kernels.
    """
    knots = list(KNOT_STEPS)
    true = batch["future"][:, None, knots]
    valid = batch["future_valid"][:, None, knots]
    return -net.log_density(goals, true, valid).flatten(1).logsumexp(1)
