"""The marginal predictor: futures of a vehicle from the past alone, as a mixture of modes.

Several members, networks that differ in the seed of their training, form a mixture in equal parts:
Lakshminarayanan et al. 2017, "Simple and scalable predictive uncertainty estimation using deep
ensembles", section 2.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks import decoding
from deepmf_sumo.deepmf.networks.base import TrajectoryNetwork
from deepmf_sumo.deepmf.networks.decoding import (
    KNOT_STEPS,
    GoalSet,
    Singles,
    log_softmax,
    logsumexp,
)
from deepmf_sumo.deepmf.networks.features import Features, features
from deepmf_sumo.deepmf.networks.kinematics import Pose, pose_of
from deepmf_sumo.scene import AgentId, Floats, Forecast, Heat, View
from deepmf_sumo.scene.geometry import frames


def pooled(members: Sequence[GoalSet]) -> GoalSet:
    """The goals of all members as goals of one network; those of a single member unchanged.

    The logits become log probabilities within each member, so that every member has the same mass.
    Members are joined along the axis of paths; they need the same number of profiles.
    """
    if len(members) == 1:
        return members[0]
    return GoalSet(
        logits=np.concatenate([_of_equal_mass(one.logits) for one in members], 1),
        along_m=np.concatenate([one.along_m for one in members]),
        knots=np.concatenate([one.knots for one in members], 1),
        paths=np.concatenate([one.paths for one in members]),
        block=members[0].block,
    )


def log_density(
    kernels_m: Sequence[Singles],
    members: Sequence[GoalSet],
    temperature: float,
    position_m: Singles,
    valid: Singles,
) -> Singles:
    """(K) log density of true positions (K, 5, 2) at the knots, see `kernels`.

    The temperature applies to the pooled goals; each member's goals have that member's kernels
    (5, 2). ``valid`` (5) knots count.
    """
    warm = [_of_equal_mass(one.logits[0]) / np.float32(temperature) for one in members]
    mass = log_softmax(np.array([logsumexp(logits.ravel()) for logits in warm]))
    parts = [
        logsumexp(log_softmax(logits.ravel()) + kernels(one, width, position_m, valid))
        for one, logits, width in zip(members, warm, kernels_m, strict=True)
    ]
    return logsumexp(np.stack(parts, -1) + mass)


def kernels(goals: GoalSet, width_m: Singles, position_m: Singles, valid: Singles) -> Singles:
    """(K, N) log of the Laplace kernels of all goals at the knots, in log 1/m^2 each.

    As in `densetnt.DenseTNT.log_density`: widths (5, 2) along and across, positions (K, 5, 2).
    """
    # Each axis by itself: numpy is slow at sums over an axis of length two.
    centre, tangent = goals.at_knots()
    (goal_x, goal_y), (cos, sin) = (np.moveaxis(each[0], -1, 0) for each in (centre, tangent))
    x, y = position_m[:, None, :, 0], position_m[:, None, :, 1]  # (K, 1, 5)
    ahead = cos * x
    ahead += sin * y
    ahead -= cos * goal_x + sin * goal_y
    left = cos * y
    left -= sin * x
    left -= cos * goal_y - sin * goal_x
    scale = valid / width_m.T  # (2, 5)
    fit = np.abs(ahead, out=ahead) @ -scale[0] + np.abs(left, out=left) @ -scale[1]
    area = np.log(4 * width_m[:, 0] * width_m[:, 1])
    return fit - (area * valid).sum(dtype=np.float32)


def _of_equal_mass(logits: Singles) -> Singles:
    """Logits (..., P, R) of a member as log probabilities over all its goals."""
    return log_softmax(logits.reshape(*logits.shape[:-2], -1)).reshape(logits.shape)


_SHORTLIST: Final = 256
"""Number of likeliest goals that may become modes: nearly always all goals of one network."""
_HEATED: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class MarginalPrediction:
    """All goals of one agent at one moment.

    Attributes:
        kernels_m: (5, 2) of each member. members: goals of each. whole: the goals of all, pooled.
        temperature: of the probabilities.
    """

    pose: Pose
    kernels_m: tuple[Singles, ...]
    members: list[GoalSet]
    whole: GoalSet
    temperature: float

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

    def end_density(self, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) see `decoding.end_density`."""
        return decoding.end_density(self.whole, self.pose, ends_m, kernel_m)

    def heat(self) -> Heat | None:
        """The likeliest goals that have `_HEATED` of the mass; None unless they are dense."""
        if self.whole.block == 1:
            return None
        share = np.exp(log_softmax(self.whole.logits[0].ravel() / np.float32(self.temperature)))
        best = np.argsort(-share, kind="stable")
        best = best[: int(np.searchsorted(np.cumsum(share[best]), _HEATED)) + 1]
        ends = self.whole.ends()[0, best].astype(np.float64)
        return Heat(
            position_m=frames.to_scene(ends, self.pose.position_m, self.pose.heading_rad),
            probability=share[best].astype(np.float64),
        )

    def log_density(self, position_m: Floats) -> Floats:
        """(K) log density of given trajectories (K, 80, 2) of the scene's frame.

        The mixture of all goals at the temperature, with the trained kernels (Laplace, wider the
        later) at 1, 2, 4, 6, 8 s. It is comparable within one prediction.
        """
        local = self.pose.to_local(position_m[:, list(KNOT_STEPS)]).astype(np.float32)
        every = np.ones(len(KNOT_STEPS), np.float32)
        found = log_density(self.kernels_m, self.members, self.temperature, local, every)
        return found.astype(np.float64)


class Marginal:
    """DenseTNT without condition: one network, or several as a mixture in equal parts.

    The features are computed once for all members; modes are chosen among the goals of all.

    Args:
        nets: the members, of the same sizes, in evaluation mode.
        temperature: of the probabilities of the mixture.
    """

    def __init__(self, nets: Sequence[TrajectoryNetwork], temperature: float) -> None:
        self.nets = tuple(nets)
        self.temperature = temperature

    @property
    def net(self) -> TrajectoryNetwork:
        """The first member."""
        return self.nets[0]

    def predict(
        self, view: View, agent_id: AgentId, arrays: Features | None = None
    ) -> MarginalPrediction:
        """The prediction for an agent. Raises KeyError if it is not in view.

        ``arrays`` are its features, if they have been computed for another network.
        """
        pose = pose_of(view, agent_id)
        if arrays is None:
            arrays, _ = features(view, agent_id, self.net.preset)
        members = [net.goals_of(net.scene_of(arrays)) for net in self.nets]
        kernels_m = tuple(net.kernel_m for net in self.nets)
        return MarginalPrediction(pose, kernels_m, members, pooled(members), self.temperature)
