"""From hundreds of weighted dense goals to a few modes: k-medoids.

K independent sets at once, N goals each.
"""

from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.errors import RunError

CAP_M: Final = 25.0
"""Being farther away than this from all modes costs no more."""
_SWAPS = 4
"""Rounds in which the modes move to the medians of what is nearest to them."""


def select(
    probability: Tensor,
    ends_m: Tensor,
    modes: int,
    *,
    shortlist: int | None = None,
) -> tuple[Tensor, Tensor]:
    """Chosen goals and their mass (K, M), most likely first.

    Args:
        probability: (K, N).
        ends_m: (K, N, 2) end points.
        modes: M, at most N.
        shortlist: only that many likeliest goals may become modes.

    Raises RunError where there are fewer goals than modes.

    A mode's mass is the probability of all goals that are nearer to it than to other modes.
    """
    size = min(max(modes, shortlist or probability.shape[1]), probability.shape[1])
    if size < modes:
        raise RunError(
            f"{modes} modes of a forecast were asked for, but with these weights a vehicle here has"
            f" {size} goals; ask for fewer (candidates, reactions, modes)."
        )
    weight, rows = probability.topk(size, dim=1)
    ends = ends_m.gather(1, rows.unsqueeze(-1).expand(-1, -1, 2))
    distance = torch.cdist(ends, ends, compute_mode="donot_use_mm_for_euclid_dist")
    picked = _medoids(weight, distance.clamp_max(CAP_M), modes)
    chosen = rows.gather(1, picked)
    share = mass(probability, ends_m, ends.gather(1, picked.unsqueeze(-1).expand(-1, -1, 2)))
    share, order = share.sort(dim=1, descending=True, stable=True)
    return chosen.gather(1, order), share


def _medoids(weight: Tensor, distance: Tensor, modes: int) -> Tensor:
    """(K, M): each mode lowers the expected distance to the nearest mode as much as one can.

    Chosen greedily, and then moved together.
    """
    least = torch.full_like(weight, CAP_M)
    free = torch.ones_like(weight)
    saved = torch.empty_like(distance)
    picked = []
    for _ in range(modes):
        torch.sub(least.unsqueeze(1), distance, out=saved)
        gain = saved.clamp_min_(0.0).mul_(weight.unsqueeze(1)).sum(-1)
        best = ((gain + 1e-9) * free).argmax(1, keepdim=True)
        free.scatter_(1, best, 0.0)
        row = distance.gather(1, best.unsqueeze(-1).expand(-1, -1, distance.shape[2])).squeeze(1)
        least = torch.minimum(least, row)
        picked.append(best)
    chosen = torch.cat(picked, 1)
    for _ in range(_SWAPS):
        before, chosen = chosen, _medians(weight, distance, chosen)
        if torch.equal(before, chosen):
            break
    return chosen


def _medians(weight: Tensor, distance: Tensor, chosen: Tensor) -> Tensor:
    """(K, M): for each chosen goal the one with the least distance to all that are nearest to it.

    A goal that two have chosen is the nearest of the first: the second stays where it is.
    """
    modes, goals = chosen.shape[1], weight.shape[1]
    nearest = distance.gather(2, chosen.unsqueeze(1).expand(-1, goals, -1)).argmin(2)
    mine = nearest.unsqueeze(1) == torch.arange(modes, device=weight.device)[:, None]
    cost = torch.bmm(mine * weight.unsqueeze(1), distance)
    cost = cost.masked_fill(~mine, float("inf"))
    best = cost.argmin(-1)
    return torch.where(mine.any(-1), best, chosen)


def mass(probability: Tensor, ends_m: Tensor, modes_m: Tensor) -> Tensor:
    """(K, M) probability of the goals nearest to each mode."""
    distance = torch.cdist(ends_m, modes_m, compute_mode="donot_use_mm_for_euclid_dist")
    share = torch.zeros(modes_m.shape[:2], dtype=probability.dtype, device=probability.device)
    return share.scatter_add_(1, distance.argmin(-1), probability)
