"""phi_C(X, Y_OV): where the AV may go if the opponent drives as given (paper, section IV-C2)."""

from dataclasses import dataclass, replace
from typing import Any

from deepmf_sumo.deepmf.networks import decoding
from deepmf_sumo.deepmf.networks.base import TrajectoryNetwork
from deepmf_sumo.deepmf.networks.decoding import GoalSet, Singles
from deepmf_sumo.deepmf.networks.features import features
from deepmf_sumo.deepmf.networks.kinematics import Pose, pose_of
from deepmf_sumo.deepmf.networks.marginal import Marginal
from deepmf_sumo.scene import AgentId, Floats, Forecast, Futures, View

_SHORTLIST = 64
"""Number of likeliest goals of each reaction that may become modes: this halves the time."""


@dataclass(frozen=True, slots=True, eq=False)
class ConditionalPrediction:
    """One agent at one moment: everything that does not depend on the given futures.

    Attributes:
        encoding: of the scene, as the network gives it.
        gain: added to the logits (see `decoding.gain`).
        alone: goals without condition and without the gain, if the gain was computed from them.
        temperature: of the probabilities.
    """

    pose: Pose
    net: TrajectoryNetwork
    encoding: Any
    gain: Singles | float
    alone: GoalSet | None
    temperature: float

    def given(
        self, futures: Futures | None, modes: int, *, chosen_at: int | None = None
    ) -> list[Forecast]:
        """One forecast for each given future (K, 80, 2) of the other agent.

        For None the one forecast without condition. Modes are chosen to cover where the agent may
        be at 8 s, or at the step ``chosen_at`` (0 to 79).
        """
        return decoding.forecasts(
            self._goals(futures),
            self.pose,
            modes,
            self.temperature,
            shortlist=_SHORTLIST,
            chosen_at=chosen_at,
        )

    def end_density(self, futures: Futures | None, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) under the first given future, see `decoding.end_density`."""
        return decoding.end_density(self._goals(futures), self.pose, ends_m, kernel_m)

    def _goals(self, futures: Futures | None) -> GoalSet:
        if futures is None:
            goals = self.alone or self.net.goals_of(self.encoding)
        else:
            goals = self.net.goals_of(self.encoding, *decoding.to_pose(self.pose, futures))
        return replace(goals, logits=goals.logits + self.gain)


class Conditional:
    """DenseTNT under given futures; the scene is encoded once for all of them.

    Args:
        net: made with ``conditional=True``, in evaluation mode.
        temperature: of the probabilities.
        marginal: prior for human drivers (product of experts, see `decoding.gain`). Not used for
            planners, which it was not trained on.
        share: weight of the prior.
    """

    def __init__(
        self,
        net: TrajectoryNetwork,
        temperature: float,
        *,
        marginal: Marginal | None = None,
        share: float = 0.75,
    ) -> None:
        self.net = net
        self.temperature = temperature
        self.marginal = marginal
        self.share = share

    def predict(
        self, view: View, agent_id: AgentId, *, planner: bool = False
    ) -> ConditionalPrediction:
        """The prediction for an agent. Raises KeyError if it is not in view.

        ``planner``: an automated planner drives the agent.
        """
        pose = pose_of(view, agent_id)
        arrays, _ = features(view, agent_id, self.net.preset, planner=planner)
        encoding = self.net.scene_of(arrays)
        gain: Singles | float = 0.0
        alone = None
        if self.marginal is not None and not planner:
            images = self.marginal.net.preset.raster  # of its own size
            prior = self.marginal.predict(view, agent_id, None if images else arrays)
            alone = self.net.goals_of(encoding)
            gain = self.share * decoding.gain(alone, prior.members)
        return ConditionalPrediction(pose, self.net, encoding, gain, alone, self.temperature)
