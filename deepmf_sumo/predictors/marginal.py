"""The marginal predictor: futures of a vehicle from the past alone, as a mixture of modes.

Networks that were trained alike but for the seed, as one: a mixture in equal parts.

What one of them misses another often has: Lakshminarayanan et al. 2017, "Simple and scalable
predictive uncertainty estimation using deep ensembles", section 2.4.
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
        pose, goals = decoding.pose_of(view, agent_id), self._goals(view, agent_id).whole
        return [
            decoding.forecasts(
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
        """(Q) see `decoding.end_density`."""
        pose = decoding.pose_of(view, agent_id)
        return decoding.end_density(self._goals(view, agent_id).whole, pose, ends_m, kernel_m)

    @torch.inference_mode()
    def log_density(self, view: View, agent_id: AgentId, position_m: Floats) -> Floats:
        """(K) log density of given trajectories (K, 80, 2) of the scene's frame.

        The mixture of all goals at the temperature, with the trained kernels (Laplace, wider the
        later) at 1, 2, 4, 6, 8 s. It is comparable between trajectories of one agent and view.
        """
        pose = decoding.pose_of(view, agent_id)
        given = Futures(
            agent_id=agent_id, position_m=position_m, heading_rad=position_m[..., 0] * 0.0
        )
        local = decoding.to_pose(pose, given)[0][:, :, list(KNOT_STEPS)]  # (1, K, 5, 2)
        density: Floats = (
            log_density(
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
            batch = decoding.as_batch(arrays)
            members = [net(batch) for net in self.nets]
            known[agent_id] = _Known(members, pooled(members))
        return known[agent_id]
