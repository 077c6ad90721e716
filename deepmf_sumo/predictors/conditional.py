"""phi_C(X, Y_OV): where the AV may go if the opponent drives as given (paper, section IV-C2)."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.predictors import conditioning, decoding
from deepmf_sumo.predictors.decoding import Pose
from deepmf_sumo.predictors.densetnt import DenseTNT, Encoding, Goals
from deepmf_sumo.predictors.features import features
from deepmf_sumo.predictors.marginal import Marginal

_SHORTLIST = 64
"""Goals of each reaction that may become modes: half of the time of choosing among all."""


@dataclass(frozen=True, slots=True)
class _Known:
    """What does not depend on the given futures.

    Attributes:
        encoding: of the scene. gain: what is added to the logits.
        alone: goals under no future, without the gain, where that was computed from them.
    """

    encoding: Encoding
    gain: Tensor | float = 0.0
    alone: Goals | None = None


class Conditional:
    """DenseTNT under given futures; the scene is encoded once for all of them.

    Args:
        net: made with ``conditional=True``, in evaluation mode.
        temperature: of the probabilities.
        marginal: what it knows of people counts too, see `second_opinion`. It has not seen
            planners drive, so of them it is not asked.
        share: weight of what ``marginal`` knows.
    """

    def __init__(
        self,
        net: DenseTNT,
        temperature: float,
        *,
        marginal: Marginal | None = None,
        share: float = 0.75,
    ) -> None:
        self.net = net.eval()
        self.temperature = temperature
        self.marginal = marginal
        self.share = share
        self._last: tuple[View, tuple[AgentId, bool], _Known] | None = None

    @torch.inference_mode()
    def react(
        self,
        view: View,
        agent_id: AgentId,
        given: Futures | None,
        modes: int,
        *,
        planner: bool = False,
        chosen_at: int | None = None,
    ) -> list[Forecast]:
        """One forecast of ``agent_id`` per given future (K, 80, 2) of the other agent.

        With ``given=None`` the one forecast without condition. ``planner``: an automated planner
        drives the agent. Modes are chosen to cover where it may be at 8 s, or at the step
        ``chosen_at`` (0 to 79). Raises KeyError for an agent that is not in view.
        """
        pose = decoding.pose_of(view, agent_id)
        return decoding.forecasts(
            self._goals(view, pose, given, planner),
            pose,
            modes,
            self.temperature,
            shortlist=_SHORTLIST,
            chosen_at=chosen_at,
        )

    @torch.inference_mode()
    def end_density(
        self,
        view: View,
        agent_id: AgentId,
        given: Futures | None,
        ends_m: Floats,
        kernel_m: float,
        *,
        planner: bool = False,
    ) -> Floats:
        """(Q) under the first given future, see `decoding.end_density`."""
        pose = decoding.pose_of(view, agent_id)
        return decoding.end_density(self._goals(view, pose, given, planner), pose, ends_m, kernel_m)

    def _goals(self, view: View, pose: Pose, given: Futures | None, planner: bool) -> Goals:
        future = None
        if given is not None:
            position, heading = decoding.to_pose(pose, given)
            there = torch.ones(1, position.shape[1])
            future = conditioning.encode(position, heading, there, self.net.preset)
        known = self._known(view, pose.agent_id, planner)
        goals = known.alone if future is None else None
        goals = goals or self.net.decode(known.encoding, future)
        return replace(goals, logits=goals.logits + known.gain)

    def _known(self, view: View, agent_id: AgentId, planner: bool) -> _Known:
        """Of the last view it is kept, since a plan asks more than once."""
        asked = (agent_id, planner)
        if self._last is None or self._last[0] is not view or self._last[1] != asked:
            arrays, _ = features(view, agent_id, self.net.preset, planner=planner)
            encoding = self.net.encode(decoding.as_batch(arrays))
            known = _Known(encoding)
            if self.marginal is not None and not planner:
                images = self.marginal.net.preset.raster  # of sizes of its own
                others = self.marginal.goals(view, agent_id, None if images else arrays)
                alone = self.net.decode(encoding)
                known = _Known(encoding, self.share * decoding.gain(alone, others), alone)
            self._last = (view, asked, known)
        return self._last[2]
