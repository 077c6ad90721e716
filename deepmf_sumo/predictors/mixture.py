"""Networks that were trained alike but for the seed, as one: a mixture in equal parts.

What one of them misses another often has: Lakshminarayanan et al. 2017, "Simple and scalable
predictive uncertainty estimation using deep ensembles", section 2.4.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from deepmf_sumo.predictors.densetnt import DenseTNT, Goals


def pooled(members: Sequence[Goals]) -> Goals:
    """All goals of all members as those of one network; those of one member as they are.

    The logits become log probabilities within each member, so that every member has the same mass.
    Members follow one another along the paths; they need the same number of profiles.
    """
    if len(members) == 1:
        return members[0]
    return Goals(
        logits=torch.cat(_of_equal_mass(members), 2),
        along_m=torch.cat([goals.along_m for goals in members], 1),
        knots=torch.cat([goals.knots for goals in members], 2),
        paths=torch.cat([goals.paths for goals in members], 1),
    )


def log_density(
    nets: Sequence[DenseTNT],
    members: Sequence[Goals],
    temperature: float,
    position_m: Tensor,
    valid: Tensor,
) -> Tensor:
    """(B, K) log density of true positions at the knots, as `DenseTNT.log_density` has them.

    The pooled goals have the temperature, and each member's goals the kernels of that member.
    """
    warm = [
        replace(goals, logits=logits / temperature)
        for goals, logits in zip(members, _of_equal_mass(members), strict=True)
    ]
    mass = torch.stack([goals.logits.flatten(2).logsumexp(-1) for goals in warm])  # (M, B, K)
    parts = [
        net.log_density(goals, position_m, valid).flatten(2).logsumexp(-1)
        for net, goals in zip(nets, warm, strict=True)
    ]
    return (torch.stack(parts) + mass.log_softmax(0)).logsumexp(0)


def _of_equal_mass(members: Sequence[Goals]) -> list[Tensor]:
    """Logits of each member, so that all have the same mass; those of one as they are."""
    if len(members) == 1:
        return [members[0].logits]
    return [goals.logits.flatten(2).log_softmax(-1).view_as(goals.logits) for goals in members]
