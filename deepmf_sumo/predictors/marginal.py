"""phi_M(X): where a vehicle may go, from the scene alone (paper, section IV-C1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, View
from deepmf_sumo.predictors import completion, mixture
from deepmf_sumo.predictors.anchors import KNOT_STEPS
from deepmf_sumo.predictors.densetnt import DenseTNT, Goals
from deepmf_sumo.predictors.features import Features, features

_SHORTLIST: Final = 256
"""Goals that may become modes: of one network seldom fewer than all, of two half of the time."""


@dataclass(frozen=True, slots=True)
class _Known:
    """Goals of an agent: of each member, and pooled."""

    members: list[Goals]
    whole: Goals


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
        self._last: tuple[View, dict[AgentId, _Known]] | None = None

    @property
    def net(self) -> DenseTNT:
        """The first member: for gradients, which are not taken through the choice of modes."""
        return self.nets[0]

    @torch.inference_mode()
    def predict(self, view: View, agent_ids: Sequence[AgentId], modes: int) -> list[Forecast]:
        """One forecast per agent, ``modes`` futures of 80 steps each, likeliest first.

        Raises KeyError for an agent that is not in view.
        """
        return [self.predict_each(view, agent_id, (modes,))[0] for agent_id in agent_ids]

    @torch.inference_mode()
    def predict_each(
        self,
        view: View,
        agent_id: AgentId,
        modes: Sequence[int],
        *,
        chosen_at: int | None = None,
    ) -> list[Forecast]:
        """Forecasts of one agent with different numbers of modes, from one pass.

        Modes are chosen to cover where it may be at 8 s, or at the step ``chosen_at`` (0 to 79).
        """
        pose, goals = completion.pose_of(view, agent_id), self._goals(view, agent_id).whole
        return [
            completion.forecasts(
                goals,
                pose,
                count,
                self.temperature,
                shortlist=_SHORTLIST,
                chosen_at=chosen_at,
            )[0]
            for count in modes
        ]

    @torch.inference_mode()
    def goals(self, view: View, agent_id: AgentId, arrays: Features | None = None) -> list[Goals]:
        """All goals of an agent, of each member. Raises KeyError if it is not in view.

        ``arrays`` are its features, where another network has had them made already.
        """
        return self._goals(view, agent_id, arrays).members

    @torch.inference_mode()
    def end_density(self, view: View, agent_id: AgentId, ends_m: Floats, kernel_m: float) -> Floats:
        """(Q) see `completion.end_density`."""
        pose = completion.pose_of(view, agent_id)
        return completion.end_density(self._goals(view, agent_id).whole, pose, ends_m, kernel_m)

    @torch.inference_mode()
    def log_density(self, view: View, agent_id: AgentId, position_m: Floats) -> Floats:
        """(K) log density of given trajectories (K, 80, 2) of the scene's frame.

        The mixture of all goals at the temperature, with the trained kernels (Laplace, wider the
        later) at 1, 2, 4, 6, 8 s. It is comparable between trajectories of one agent and view.
        """
        pose = completion.pose_of(view, agent_id)
        given = Futures(
            agent_id=agent_id, position_m=position_m, heading_rad=position_m[..., 0] * 0.0
        )
        local = completion.to_pose(pose, given)[0][:, :, list(KNOT_STEPS)]  # (1, K, 5, 2)
        density: Floats = (
            mixture.log_density(
                self.nets,
                self._goals(view, agent_id).members,
                self.temperature,
                local,
                torch.ones(1, local.shape[1], len(KNOT_STEPS)),
            )[0]
            .double()
            .numpy()
        )
        return density

    def _goals(self, view: View, agent_id: AgentId, arrays: Features | None = None) -> _Known:
        """Goals of an agent; those of the last view are kept, since a plan asks more than once."""
        if self._last is None or self._last[0] is not view:
            self._last = (view, {})
        known = self._last[1]
        if agent_id not in known:
            if arrays is None:
                arrays, _ = features(view, agent_id, self.net.preset)
            batch = completion.as_batch(arrays)
            members = [net(batch) for net in self.nets]
            known[agent_id] = _Known(members, mixture.pooled(members))
        return known[agent_id]
