"""The predictors of trajectories: view -> prediction, which is then queried.

A prediction contains everything that the networks compute of a view. Callers that ask several
questions about one moment keep it and pass it on; predictors themselves keep nothing.

`Marginal` and `Conditional` make the forward pass: `encode` (what is read of a view), `condition`
(the given vehicle), `densetnt` or its ONNX graphs (the networks), `decode` (from goals to
trajectories).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import numpy as np

from deepmf_sumo.deepmf.networks import decode
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, GoalSet, Singles, log_softmax
from deepmf_sumo.deepmf.networks.encode import Features, features
from deepmf_sumo.scene import AgentId, Floats, Forecast, Futures, Heat, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import AgentFrame, pose_of

MOST_MODES: Final = 96
"""In one forecast: a vehicle far from all lanes has five paths with 24 goals each by default."""
_MARGINAL_SHORTLIST: Final = 256
"""Number of likeliest goals that may become modes: nearly always all goals of one network."""
_CONDITIONAL_SHORTLIST: Final = 64
"""The same for each reaction: this halves the time."""
_HEATED: Final = 0.95


class TrajectoryNetwork(Protocol):
    """A network that scores and completes goals: DenseTNT in torch, or its ONNX graphs."""

    @property
    def preset(self) -> Preset:
        """Its sizes."""
        ...

    @property
    def kernel_m(self) -> Singles:
        """(5, 2) widths along and across of the Laplace kernels at the knots, metres."""
        ...

    def scene_of(self, arrays: Features) -> Any:
        """What no given future changes, for `goals_of`."""
        ...

    def goals_of(
        self,
        encoding: Any,
        position_m: Singles | None = None,
        heading_rad: Singles | None = None,
    ) -> GoalSet:
        """The goals, given positions (K, 80, 2) and headings (K, 80) in the vehicle's frame."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MarginalPrediction:
    """Where an agent may go from one moment on: all goals of its networks.

    Attributes:
        kernels_m: (5, 2) of each member. members: goals of each. whole: the goals of all, pooled.
        temperature: of the probabilities.
    """

    pose: AgentFrame
    kernels_m: tuple[Singles, ...]
    members: list[GoalSet]
    whole: GoalSet
    temperature: float

    def modes(self, count: int, *, chosen_at: int | None = None) -> Forecast:
        """``count`` futures of 80 steps each, most likely first.

        They are chosen to cover where the agent may be at 8 s, or at the step ``chosen_at`` (0 to
        79).
        """
        (found,) = decode.forecasts(
            self.whole,
            self.pose,
            count,
            self.temperature,
            shortlist=_MARGINAL_SHORTLIST,
            chosen_at=chosen_at,
        )
        return found

    def end_density(self, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) see `decode.end_density`."""
        return decode.end_density(self.whole, self.pose, ends_m, kernel_m)

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
        found = decode.log_density(self.kernels_m, self.members, self.temperature, local, every)
        return found.astype(np.float64)


class Marginal:
    """phi_M(X): futures of an agent (paper, section IV-C1).

    DenseTNT without condition: one network, or several as a mixture in equal parts.

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
        return MarginalPrediction(
            pose, kernels_m, members, decode.pooled(members), self.temperature
        )


@dataclass(frozen=True, slots=True, eq=False)
class ConditionalPrediction:
    """Where an agent may go, as a function of another agent's future.

    It contains everything that does not depend on the given futures.

    Attributes:
        encoding: of the scene, as the network gives it.
        gain: added to the logits (see `decode.gain`).
        alone: goals without condition and without the gain, if the gain was computed from them.
        temperature: of the probabilities.
    """

    pose: AgentFrame
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
        return decode.forecasts(
            self._goals(futures),
            self.pose,
            modes,
            self.temperature,
            shortlist=_CONDITIONAL_SHORTLIST,
            chosen_at=chosen_at,
        )

    def end_density(self, futures: Futures | None, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) under the first given future, see `decode.end_density`."""
        return decode.end_density(self._goals(futures), self.pose, ends_m, kernel_m)

    def _goals(self, futures: Futures | None) -> GoalSet:
        if futures is None:
            goals = self.alone or self.net.goals_of(self.encoding)
        else:
            goals = self.net.goals_of(self.encoding, *decode.to_pose(self.pose, futures))
        return replace(goals, logits=goals.logits + self.gain)


class Conditional:
    """phi_C(X, Y_OV): futures of an agent given another's future (paper, section IV-C2).

    DenseTNT under given futures; the scene is encoded once for all of them.

    Args:
        net: made with ``conditional=True``, in evaluation mode.
        temperature: of the probabilities.
        marginal: prior for human drivers (product of experts, see `decode.gain`). Not used for
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
            gain = self.share * decode.gain(alone, prior.members)
        return ConditionalPrediction(pose, self.net, encoding, gain, alone, self.temperature)
