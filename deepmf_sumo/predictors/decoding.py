"""Goals to trajectories: choice of modes, completion, combination of the scores of two networks.

Modes are chosen by k-medoids from hundreds of weighted dense goals, for K independent sets of N
goals at once.

`gain` combines the goal scores of two networks as a product of experts (Hinton 2002, "Training
products of experts by minimizing contrastive divergence", section 1). Both predict one vehicle in
one view, so that their goals lie on the same paths; speed profiles and residuals may differ, so
that goals are compared by how far along a path they end.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.datatypes import Floats, Forecast, Futures
from deepmf_sumo.errors import RunError
from deepmf_sumo.geometry import frames
from deepmf_sumo.predictors import anchors
from deepmf_sumo.predictors.densetnt import Goals
from deepmf_sumo.predictors.features import Features
from deepmf_sumo.predictors.kinematics import Pose

CAP_M: Final = 25.0
"""A larger distance to all modes costs no more than this one."""
_SWAPS = 4
"""Rounds in which each mode moves to the median of the goals that are nearest to it."""


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
        shortlist: number of likeliest goals that may become modes; None: all.

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
    """(K, M) modes that lower the expected distance to the nearest mode.

    They are chosen greedily, and then moved together.
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
    """(K, M) for each mode the goal with the least distance to all goals nearest to the mode.

    If two modes chose one goal, it counts for the first; the second mode does not move.
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


def as_batch(features: Features) -> dict[str, Tensor]:
    """A batch of one scene."""
    return {name: torch.from_numpy(values)[None] for name, values in features.items()}


def forecasts(
    goals: Goals,
    pose: Pose,
    modes: int,
    temperature: float,
    *,
    shortlist: int | None = None,
    chosen_at: int | None = None,
) -> list[Forecast]:
    """One forecast for each of the K given futures (one where there is none).

    Modes and their mass are taken at the temperature, because the best few ends depend on how
    likely the tails are. Modes are chosen by their positions at 8 s, or at the step ``chosen_at``
    (0 to 79).
    """
    probability = (goals.logits[0].flatten(1) / temperature).softmax(-1)  # (K, N)
    ends = goals.ends()[0] if chosen_at is None else _all_at(goals, chosen_at)  # (K, N, 2)
    chosen, mass = select(probability, ends, modes, shortlist=shortlist)
    futures = to_scene(pose, *complete(goals, chosen))
    shares = (mass / mass.sum(1, keepdim=True)).double().numpy()
    return [
        Forecast(
            futures=Futures(agent_id=pose.agent_id, position_m=position, heading_rad=heading),
            probability=share,
            temperature=temperature,
        )
        for position, heading, share in zip(*futures, shares, strict=True)
    ]


def end_density(goals: Goals, pose: Pose, ends_m: Floats, kernel_m: float) -> Floats:
    """(Q) log density of end points (Q, 2) of the scene's frame under the goals of future 0.

    A Gaussian of width ``kernel_m`` stands on each goal: for comparing networks.
    """
    local = _tensor(pose.to_local(ends_m))
    ends = goals.ends()[0, 0]  # (N, 2)
    score = goals.logits[0, 0].flatten().log_softmax(-1)
    square = torch.cdist(local, ends, compute_mode="donot_use_mm_for_euclid_dist") ** 2
    log_kernel = -square / (2 * kernel_m**2) - float(np.log(2 * np.pi * kernel_m**2))
    return (score + log_kernel).logsumexp(-1).double().numpy()


def complete(goals: Goals, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Positions (K, M, 80, 2) and headings (K, M, 80) of goals (K, M), in the pose's frame."""
    profiles = goals.along_m.shape[2]
    path, profile = chosen // profiles, chosen % profiles
    future = torch.arange(len(chosen))[:, None]
    residual = goals.knots[0][future, path, profile].transpose(2, 3) @ anchors.knot_matrix()
    along = goals.along_m[0][path, profile] + residual[..., 0, :]
    along = along.clamp_min(0.0).cummax(-1).values  # (K, M, 80)
    position, tangent = anchors.placed_on(
        goals.paths[0], path.unsqueeze(-1), along, residual[..., 1, :]
    )
    return position, anchors.headings(position, tangent)


def _all_at(goals: Goals, step: int) -> Tensor:
    """(K, N, 2) positions of all goals at a step."""
    _, futures, paths, profiles = goals.logits.shape
    every = torch.arange(paths * profiles).expand(futures, -1)
    return complete(goals, every)[0][:, :, step]


def to_scene(pose: Pose, position: Tensor, heading: Tensor) -> tuple[Floats, Floats]:
    """Positions (..., 2) and headings (...) of the pose's frame in the scene's."""
    return (
        frames.to_scene(position.double().numpy(), pose.position_m, pose.heading_rad),
        frames.wrap(heading.double().numpy() + pose.heading_rad),
    )


def to_pose(pose: Pose, futures: Futures) -> tuple[Tensor, Tensor]:
    """Positions (1, K, F, 2) and headings (1, K, F) of futures in the pose's frame."""
    local = pose.to_local(futures.position_m)
    return _tensor(local)[None], _tensor(pose.turn_rad(futures.heading_rad))[None]


def _tensor(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))


_REACH_M: Final = 3.0
"""Scale of the Laplace kernel over distance along a path."""


def gain(alone: Goals, others: Sequence[Goals]) -> Tensor:
    """(1, 1, P, R) log of each goal's probability under others over that under a network, nats.

    Args:
        alone: goals of the first network without condition (1, 1, P, R).
        others: of each member of the second network (1, 1, P, R'), a mixture in equal parts.
    """
    end_m = _end(alone)
    known = torch.stack([_mass_near(each, end_m) for each in others]).logsumexp(0)
    found = known - math.log(len(others)) - _mass_near(alone, end_m)
    return found.masked_fill(alone.logits[0, 0].isneginf(), 0.0)[None, None]


def _end(goals: Goals) -> Tensor:
    """(P, R) distances along the paths at 8 s, metres."""
    return goals.along_m[0, :, :, -1] + goals.knots[0, 0, :, :, -1, 0]


def _mass_near(goals: Goals, end_m: Tensor) -> Tensor:
    """(P, Q) log mass of goals near ends (P, Q) on the same paths, up to a constant."""
    off = (end_m.unsqueeze(2) - _end(goals).unsqueeze(1)).abs() / _REACH_M  # (P, Q, R)
    score = goals.logits[0, 0].flatten().log_softmax(-1).view(goals.logits.shape[2:])
    return (score.unsqueeze(1) - off).logsumexp(-1)
