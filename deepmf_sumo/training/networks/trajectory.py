"""Training of the marginal and the conditional network: losses, augmentation, temperature.

Augmented samples are consistent: a mirrored sample is mirrored everywhere. Only other vehicles and
the map are hidden, never the target, its paths, or a given future. The history of the vehicle with
the given future may be hidden, since its route can be known without its history.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deepmf_sumo.deepmf.networks import anchors, condition, decode, vgg
from deepmf_sumo.deepmf.networks.condition import Condition
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, GoalSet, Singles, log_softmax
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT, Goals, trimmed
from deepmf_sumo.deepmf.networks.encode import (
    POSITION,
    AgentInfo,
    AgentState,
    LaneInfo,
    OwnMotion,
    PathAgent,
)
from deepmf_sumo.deepmf.networks.lanes import PathInfo
from deepmf_sumo.scene import Floats
from deepmf_sumo.training.fit.loop import Loss, in_batches
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.samples.dataset import Dataset

_RARE = -6.9
"""log .001: prior of profiles that are not fitted to data."""
_GIVEN = 0.6
"""Share of samples whose partner's future is given; with the others the network also learns to
predict without a condition."""
CONDITION_LAYERS = ("given_line", "target_to_given", "film", "goal_met", "goal_follow")
"""Layers with random initial weights if the conditional network starts from the marginal one."""
_TEMPERATURES = np.round(np.arange(0.7, 3.01, 0.1), 1)
_SAMPLES: Final = 600
DRAWN: Final = 32
"""Dense goals of each path in a step of training."""
MIRRORED: Final = 0.3
AGENT_DROPPED: Final = 0.1
LANE_DROPPED: Final = 0.05
POSITION_NOISE_M: Final = 0.03
HEADING_NOISE_RAD: Final = 0.01
_LEFT_COLUMNS: Final = {
    "agents": (AgentState.Y, AgentState.SIN, AgentState.VY),
    "lanes": (1,),
    "paths": (1,),
    "path_info": (PathInfo.OFFSET, PathInfo.TURN),
    "path_agents": (PathAgent.LEFT, PathAgent.SPEED_LEFT, PathAgent.SIN),
    "motion": (OwnMotion.YAW_RATE,),
    "future": (1,),
    "partner": (1, 2),
}
"""Columns whose sign changes when left and right are exchanged."""


def fit_profiles(net: DenseTNT, dataset: Dataset, seed: int) -> None:
    """Fit the network's speed profiles to the training samples; dense goals have none."""
    if net.dense:
        return
    rows = dataset.rows(held_out=False)
    known = rows[np.asarray(dataset.arrays["future_valid"][rows]).all(1)]
    table = clusters.speed_profiles(
        np.asarray(dataset.arrays["driven"][known], float),
        np.asarray(dataset.arrays["motion"][known, OwnMotion.SPEED], float),
        net.preset.profiles,
        np.random.default_rng([seed, 1]),
    )
    fitted = torch.from_numpy(table.relative_m).float()
    speeds = torch.tensor(anchors.START_SPEEDS_MPS)
    braking = anchors.braking(speeds)[:, : net.profiles.shape[1] - fitted.shape[1]]
    net.profiles.copy_(torch.cat([fitted, braking], 1))
    prior = torch.from_numpy(table.log_prior).float()
    rare = prior.new_full(braking.shape[:2], _RARE)
    net.prior.copy_(torch.cat([prior, rare], 1))


def loss_of(net: DenseTNT) -> Loss:
    """Negative log likelihood of the goals; a conditional network gets most partners' futures."""

    def loss(batch: dict[str, Tensor], generator: torch.Generator) -> Tensor:
        if net.training:
            batch = augmented(batch, net.preset, generator)
        given = partner_condition(batch, net.preset, generator) if net.conditional else None
        if net.dense:
            return dense_loss(net, batch, given, generator).mean()
        return mixture_loss(net, net(batch, given), batch).mean()

    return loss


def partner_condition(
    batch: dict[str, Tensor],
    preset: Preset,
    generator: torch.Generator | None,
) -> Condition:
    """The partner's future as the condition; with a generator some are left out at random."""
    position, heading = batch["partner"][..., :2], batch["partner"][..., 2]
    given = batch["partner_known"]
    if generator is not None:
        keep = torch.rand(len(given), generator=generator) < _GIVEN
        given = given * keep.to(given.device)
    return condition.Condition.of(position[:, None], heading[:, None], given[:, None], preset)


def _given(net: DenseTNT, batch: dict[str, Tensor]) -> Condition | None:
    return partner_condition(batch, net.preset, None) if net.conditional else None


def known_held_out(dataset: Dataset) -> NDArray[np.int64]:
    """Up to 600 held-out samples that are known for 8 s, in random but fixed order."""
    rows = dataset.rows(held_out=True)
    rows = rows[np.asarray(dataset.arrays["future_valid"][rows, -1]) > 0]
    return np.random.default_rng(0).permutation(rows)[:_SAMPLES]


@torch.inference_mode()
def fit_temperature(
    nets: Sequence[DenseTNT], dataset: Dataset, modes: int, device: str = "cpu"
) -> float:
    """The temperature at which the modes nearest to true endpoints have the highest likelihood.

    On held-out scenes, for one network or the mixture of several.
    """
    for net in nets:
        net.eval().to(device)
    rows = known_held_out(dataset)
    if len(rows) == 0:
        return 1.0
    nll = np.zeros(len(_TEMPERATURES))
    for batch in in_batches(dataset, rows, 64, device):
        members = [net(batch, _given(net, batch)).sets() for net in nets]
        for each, true in zip(
            zip(*members, strict=True), batch["future"][:, -1].cpu(), strict=True
        ):
            nll += _negative_log_likelihoods(decode.pooled(each), true.numpy(), modes)
    return float(_TEMPERATURES[nll.argmin()])


def _negative_log_likelihoods(goals: GoalSet, end_m: Singles, modes: int) -> Floats:
    """(T) of the mode nearest to a true end (2), at all temperatures."""
    logits, ends = goals.logits[0].reshape(1, -1), goals.ends()
    likely = np.exp(log_softmax(logits)).reshape(goals.logits.shape)
    chosen, _ = decode.select(likely, ends, modes, block=goals.block)
    at = ends[:, chosen[0]]  # (1, M, 2)
    nearest = np.hypot(*(at[0] - end_m).T).argmin()
    warm = [np.exp(log_softmax(logits / np.float32(one))) for one in _TEMPERATURES]
    mass = np.array([decode.mass(one, ends, at)[0, nearest] for one in warm])
    return -np.log(np.maximum(mass.astype(np.float64), 1e-4))


def mixture_loss(net: DenseTNT, goals: Goals, batch: dict[str, Tensor]) -> Tensor:
    """(B) negative log density of the true motion under all goals and their kernels.

    It trains scores and completion together: DenseTNT's likelihood of the nearest goal is its limit
    for narrow kernels.
    """
    knots = list(KNOT_STEPS)
    true = batch["future"][:, None, knots]
    valid = batch["future_valid"][:, None, knots]
    return -net.log_density(goals, true, valid).flatten(1).logsumexp(1)


def dense_loss(
    net: DenseTNT,
    batch: dict[str, Tensor],
    given: Condition | None,
    generator: torch.Generator,
) -> Tensor:
    """(B) negative log density of the true motion under dense goals, as DenseTNT trains them.

    Where the motion is known for 8 s: of its goal among all, of its path among all (in training),
    and of the completion of the true goal (teacher forcing). Else that of the mixture, as in
    `mixture_loss`. Goals are drawn, `DRAWN` of each path, and count for those that were not.
    """
    batch = trimmed(batch)
    paths, exists = batch["paths"], batch["path_info"][..., PathInfo.THERE] > 0
    known = batch["future_valid"][:, -1] > 0
    every = anchors.every(paths, exists, batch["motion"][:, OwnMotion.SPEED])
    true, path = anchors.nearest(paths, every, batch["future"][:, -1])
    mine = torch.arange(paths.shape[1], device=paths.device) == path.unsqueeze(1)  # (B, P)
    true = replace(true, there=true.there & (mine & known.unsqueeze(1)).unsqueeze(2))
    goals = net(batch, given, anchors.joined(true, anchors.drawn(every, DRAWN, generator)))
    knots = list(KNOT_STEPS)
    valid = batch["future_valid"][:, None, knots]
    density = net.log_density(goals, batch["future"][:, None, knots], valid)[:, 0]  # (B, P, R)
    row = torch.arange(len(path), device=path.device)
    found = torch.where(known, density[row, path, 0], density.flatten(1).logsumexp(1))
    if net.training and goals.lanes is not None:
        found = found + goals.lanes.log_softmax(-1)[row, path] * known
    return -found


def augmented(
    batch: dict[str, Tensor], preset: Preset, generator: torch.Generator
) -> dict[str, Tensor]:
    """A batch of `samples.trajectory.trajectory_samples` with random changes."""
    batch = _noisy(_dropped(dict(batch), generator), generator)
    rows = _drawn(len(batch["motion"]), MIRRORED, generator, batch["motion"].device)
    return mirrored(batch, rows, preset)


def mirrored(batch: dict[str, Tensor], rows: Tensor, preset: Preset) -> dict[str, Tensor]:
    """The batch with left and right exchanged in the given rows (B)."""
    batch = dict(batch)
    for name, columns in _LEFT_COLUMNS.items():
        values = batch[name]
        sign = torch.ones_like(values)
        sign[..., list(columns)] = (1.0 - 2.0 * rows.to(values.dtype)).view(
            -1, *[1] * (values.ndim - 1)
        )
        batch[name] = values * sign
    if preset.raster and rows.any():
        bits = batch["raster"].clone()
        bits[rows] = vgg.repack(vgg.unpack(bits[rows], preset).flip(3))
        batch["raster"] = bits
    return batch


def _dropped(batch: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Without random agents and pieces of lanes, which stay in the image."""
    for states, info, share, column, first in (
        ("agents", "agent_info", AGENT_DROPPED, AgentInfo.THERE, 1),
        ("lanes", "lane_info", LANE_DROPPED, LaneInfo.THERE, 0),
        ("path_agents", "path_agents", AGENT_DROPPED, PathAgent.THERE, 0),
    ):
        there = batch[info][..., column]
        keep = ~_drawn(there.shape, share, generator, there.device)
        keep[:, :first] = True
        batch[info] = batch[info] * keep.unsqueeze(-1)
        if states != info:
            mask = keep.view(*keep.shape, *[1] * (batch[states].ndim - keep.ndim))
            batch[states] = batch[states] * mask
    return batch


def _noisy(batch: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Histories of other agents with a small error, the same one at all steps of an agent."""
    agents = batch["agents"].clone()
    shape = (*agents.shape[:2], 1)
    shift = torch.randn(*shape, 2, generator=generator).to(agents.device) * POSITION_NOISE_M
    turn = torch.randn(*shape, generator=generator).to(agents.device) * HEADING_NOISE_RAD
    there = agents[..., AgentState.SEEN]
    shift[:, 0], turn[:, 0] = 0.0, 0.0
    agents[..., POSITION] += shift * there.unsqueeze(-1)
    cos, sin = agents[..., AgentState.COS].clone(), agents[..., AgentState.SIN].clone()
    agents[..., AgentState.COS] = cos * turn.cos() - sin * turn.sin()
    agents[..., AgentState.SIN] = sin * turn.cos() + cos * turn.sin()
    batch["agents"] = agents
    return batch


def _drawn(
    shape: int | torch.Size, share: float, generator: torch.Generator, device: torch.device
) -> Tensor:
    """Random flags that are true with the given probability."""
    size = (shape,) if isinstance(shape, int) else tuple(shape)
    return (torch.rand(size, generator=generator) < share).to(device)
