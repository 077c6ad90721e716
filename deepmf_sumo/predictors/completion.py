"""From scored goals to forecasts: choose modes, complete them, go back to the scene's frame."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.geometry import angles, frames
from deepmf_sumo.predictors import anchors, selection
from deepmf_sumo.predictors.densetnt import Goals
from deepmf_sumo.predictors.features import Features


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where an agent is now: the frame of its features."""

    agent_id: AgentId
    position_m: Floats
    heading_rad: float
    speed_mps: float


def pose_of(view: View, agent_id: AgentId) -> Pose:
    """The agent's pose at the view's step. Raises KeyError if it is not in view."""
    row = view.history.row(agent_id)
    return Pose(
        agent_id=agent_id,
        position_m=view.history.position_m[row, -1],
        heading_rad=float(view.history.heading_rad[row, -1]),
        speed_mps=float(view.history.speed_mps[row, -1]),
    )


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

    Modes are chosen, and their mass is taken, at the temperature: which few ends come nearest to
    what may happen depends on how likely the tails are. They are chosen by where they are at 8 s,
    or at the step ``chosen_at`` (0 to 79).
    """
    probability = (goals.logits[0].flatten(1) / temperature).softmax(-1)  # (K, N)
    ends = goals.ends()[0] if chosen_at is None else _all_at(goals, chosen_at)  # (K, N, 2)
    chosen, mass = selection.select(probability, ends, modes, shortlist=shortlist)
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
    local = _tensor(frames.to_local(ends_m, pose.position_m, pose.heading_rad))
    ends = goals.ends()[0, 0]  # (N, 2)
    score = goals.logits[0, 0].flatten().log_softmax(-1)
    square = torch.cdist(local, ends, compute_mode="donot_use_mm_for_euclid_dist") ** 2
    log_kernel = -square / (2 * kernel_m**2) - float(np.log(2 * np.pi * kernel_m**2))
    density: Floats = (score + log_kernel).logsumexp(-1).double().numpy()
    return density


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
    """(K, N, 2) where all goals are at a step."""
    _, futures, paths, profiles = goals.logits.shape
    every = torch.arange(paths * profiles).expand(futures, -1)
    return complete(goals, every)[0][:, :, step]


def to_scene(pose: Pose, position: Tensor, heading: Tensor) -> tuple[Floats, Floats]:
    """Positions (..., 2) and headings (...) of the pose's frame in the scene's."""
    return (
        frames.to_scene(position.double().numpy(), pose.position_m, pose.heading_rad),
        angles.wrap(heading.double().numpy() + pose.heading_rad),
    )


def to_pose(pose: Pose, futures: Futures) -> tuple[Tensor, Tensor]:
    """Positions (1, K, F, 2) and headings (1, K, F) of futures in the pose's frame."""
    local = frames.to_local(futures.position_m, pose.position_m, pose.heading_rad)
    heading = angles.wrap(futures.heading_rad - pose.heading_rad)
    return _tensor(local)[None], _tensor(heading)[None]


def _tensor(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
