"""The marginal predictor: futures of a vehicle from the past alone, as a mixture of modes.

Several members, networks that differ in the seed of their training, form a mixture in equal parts:
Lakshminarayanan et al. 2017, "Simple and scalable predictive uncertainty estimation using deep
ensembles", section 2.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.predictors import decoding
from deepmf_sumo.predictors.anchors import KNOT_STEPS
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals
from deepmf_sumo.predictors.features import Features, features
from deepmf_sumo.predictors.kinematics import Pose, pose_of


def pooled(members: Sequence[Goals]) -> Goals:
    """The goals of all members as goals of one network; those of a single member unchanged.

    The logits become log probabilities within each member, so that every member has the same mass.
    Members are joined along the axis of paths; they need the same number of profiles.
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
    """(B, K) log density of true positions at the knots, see `DenseTNT.log_density`.

    The temperature applies to the pooled goals; each member's goals have that member's kernels.
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
    """Logits of each member, normalised to the same mass; those of a single one unchanged."""
    if len(members) == 1:
        return [members[0].logits]
    return [goals.logits.flatten(2).log_softmax(-1).view_as(goals.logits) for goals in members]


_SHORTLIST: Final = 256
"""Number of likeliest goals that may become modes: nearly always all goals of one network."""


@dataclass(frozen=True, slots=True, eq=False)
class MarginalPrediction:
    """All goals of one agent at one moment.

    Attributes:
        nets: the members. members: goals of each of them. whole: the goals of all, pooled.
        temperature: of the probabilities.
    """

    pose: Pose
    nets: tuple[DenseTNT, ...]
    members: list[Goals]
    whole: Goals
    temperature: float

    @torch.inference_mode()
    def modes(self, count: int, *, chosen_at: int | None = None) -> Forecast:
        """``count`` futures of 80 steps each, most likely first.

        They are chosen to cover where the agent may be at 8 s, or at the step ``chosen_at`` (0 to
        79).
        """
        (found,) = decoding.forecasts(
            self.whole,
            self.pose,
            count,
            self.temperature,
            shortlist=_SHORTLIST,
            chosen_at=chosen_at,
        )
        return found

    @torch.inference_mode()
    def end_density(self, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) see `decoding.end_density`."""
        return decoding.end_density(self.whole, self.pose, ends_m, kernel_m)

    @torch.inference_mode()
    def log_density(self, position_m: Floats) -> Floats:
        """(K) log density of given trajectories (K, 80, 2) of the scene's frame.

        The mixture of all goals at the temperature, with the trained kernels (Laplace, wider the
        later) at 1, 2, 4, 6, 8 s. It is comparable within one prediction.
        """
        given = Futures(
            agent_id=self.pose.agent_id,
            position_m=position_m,
            heading_rad=position_m[..., 0] * 0.0,
        )
        local = decoding.to_pose(self.pose, given)[0][:, :, list(KNOT_STEPS)]  # (1, K, 5, 2)
        valid = torch.ones(1, local.shape[1], len(KNOT_STEPS))
        density = log_density(self.nets, self.members, self.temperature, local, valid)[0]
        return density.double().numpy()


class Marginal:
    """DenseTNT without condition: one network, or several as a mixture in equal parts.

    The features are computed once for all members; modes are chosen among the goals of all.

    Args:
        nets: the members, of the same sizes, in evaluation mode.
        temperature: of the probabilities of the mixture.
    """

    def __init__(self, nets: Sequence[DenseTNT], temperature: float) -> None:
        self.nets = tuple(net.eval() for net in nets)
        self.temperature = temperature

    @property
    def net(self) -> DenseTNT:
        """The first member: for gradients, which are not taken through the choice of modes."""
        return self.nets[0]

    @torch.inference_mode()
    def predict(
        self, view: View, agent_id: AgentId, arrays: Features | None = None
    ) -> MarginalPrediction:
        """The prediction for an agent. Raises KeyError if it is not in view.

        ``arrays`` are its features, if they have been computed for another network.
        """
        pose = pose_of(view, agent_id)
        if arrays is None:
            arrays, _ = features(view, agent_id, self.net.preset)
        batch = decoding.as_batch(arrays)
        members = [net(batch) for net in self.nets]
        return MarginalPrediction(pose, self.nets, members, pooled(members), self.temperature)
