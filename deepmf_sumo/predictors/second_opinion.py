"""What a second network knows of a first one's goals: their scores as a product of experts.

Both look at one vehicle in one view, so that their goals lie on the same paths; speed profiles and
residuals may differ, hence goals are compared by how far along a path they end. After Hinton 2002,
"Training products of experts by minimizing contrastive divergence", section 1.
"""

import math
from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.predictors.densetnt import Goals

_REACH_M: Final = 3.0
"""Goals that end so far apart on a path are much alike (Laplace)."""


def gain(alone: Goals, others: Sequence[Goals]) -> Tensor:
    """(1, 1, P, R) by how much likelier others hold each goal than a network given nothing, nats.

    Args:
        alone: goals of the first network, given nothing (1, 1, P, R).
        others: of each member of the second one (1, 1, P, R'), a mixture in equal parts.
    """
    end_m = _end(alone)
    known = torch.stack([_mass_near(each, end_m) for each in others]).logsumexp(0)
    found = known - math.log(len(others)) - _mass_near(alone, end_m)
    return found.masked_fill(alone.logits[0, 0].isneginf(), 0.0)[None, None]


def _end(goals: Goals) -> Tensor:
    """(P, R) distances along the paths at 8 s, metres."""
    return goals.along_m[0, :, :, -1] + goals.knots[0, 0, :, :, -1, 0]


def _mass_near(goals: Goals, end_m: Tensor) -> Tensor:
    """(P, Q) log mass of goals near ends (P, Q) on the same paths, but for a constant."""
    off = (end_m.unsqueeze(2) - _end(goals).unsqueeze(1)).abs() / _REACH_M  # (P, Q, R)
    score = goals.logits[0, 0].flatten().log_softmax(-1).view(goals.logits.shape[2:])
    return (score.unsqueeze(1) - off).logsumexp(-1)
