"""The stages of `strive`: Adam moves a scene's latents to match, to attack, and to save the AV.

Costs are in metres: a weight converts its term into distance to the AV.
"""

import time
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepmf_sumo.baselines._scene_graph import GraphSituation, Obstacles, Path, frame
from deepmf_sumo.baselines.priors import costs
from deepmf_sumo.baselines.priors.strive import Context, DecodedMotions, Gaussian, MotionPrior
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, AgentId, Plan
from deepmf_sumo.scene.geometry import boxes, frames

_EVERY: Final = 5
"""Costs other than the distance to the AV use every fifth step."""
_AV: Final = 0
"""Row of the AV in a graph."""
_RATE: Final = {"match": 0.1, "adversarial": 0.1, "solution": 0.1}
_FREE_STEP: Final = 20
"""Earlier gaps can hardly be changed; the smallest gap of cars that drive apart is the first."""
_HEADING_M: Final = 2.0
_TOUCH_M: Final = -0.3
"""Overlap of discs when boxes touch: discs extend beyond the sides."""


class Costs(NamedTuple):
    """Weights of the terms.

    Attributes:
        others: of the overlap with others, 0 to 1 deep.
        road: of a metre off the road.
        prior: of half the squared distance to the prior's mean, in standard deviations.
        init: of the squared change of a latent.
    """

    others: float
    road: float
    prior: float
    init: float


class AdversarialState(NamedTuple):
    """A state of the adversarial stage.

    Attributes:
        motions: of all vehicles, in the graph's frame.
        closest: vehicle that comes closest to the AV's last rollout. gap_m: its gap, below 0 in
            contact. iterations: total number so far.
    """

    motions: DecodedMotions
    closest: AgentId
    gap_m: float
    iterations: int


class LatentSearch:
    """Latents of one situation (1, N, 16), kept from stage to stage.

    Args:
        net: the motion prior; its weights get no gradients.
        situation: what is attacked.
        attackers: vehicles of the graph that may attack; the others keep their matched latents.
        weights: of the adversarial stage.
        deadline: of `time.perf_counter`; no iteration starts after it.
    """

    def __init__(
        self,
        net: MotionPrior,
        situation: GraphSituation,
        attackers: Sequence[AgentId],
        weights: Costs,
        deadline: float,
    ) -> None:
        self._net, self._situation, self._weights = net, situation, weights
        with torch.no_grad():
            self._context = net.encode(situation.graph)
        self._deadline = deadline
        self._rows = [situation.row(agent_id) for agent_id in attackers]
        self._latent = _posterior(net, situation, self._context)
        self._init = self._latent
        self._moments: torch.optim.Adam | None = None
        self._attack = torch.empty(0)
        self.iterations = 0

    def match(self, iterations: int) -> float:
        """First stage: match the unattacked motion of all vehicles. Returns the mean error in m."""
        error = self._fit(range(len(self._situation.ids)), self._situation.paths, iterations)
        self._init = self._latent
        return error

    def match_av(self, rollout: Path, iterations: int) -> float:
        """Match the AV's motion in a rollout; the others keep their latents."""
        return self._fit([_AV], [rollout], iterations)

    def attack(self, rollout: Path, iterations: int) -> AdversarialState:
        """Second stage: until an attacker meets the AV's rollout, at most ``iterations``."""
        if self._moments is None:
            self._attack = self._latent[:, self._rows].clone().requires_grad_()
            self._moments = torch.optim.Adam([self._attack], lr=_RATE["adversarial"])
        obstacles = self._situation.obstacles(
            [self._situation.ids[row] for row in (_AV, *self._rows)], {}
        )
        for turn in range(iterations + 1):
            motions = self._decode(self._with(self._rows, self._attack))
            gaps = self._gaps(motions, rollout)
            best = int(gaps.detach().amin(-1).argmin())
            gap = gaps[best].min().item()
            late = time.perf_counter() > self._deadline
            if gap < _TOUCH_M or late or turn == iterations:
                break
            loss = self._adversarial(gaps) + self._plausible(
                motions, self._rows, obstacles, self._attack, self._weights
            )
            self._step(self._moments, loss, self._attack)
        self._latent = self._with(self._rows, self._attack.detach())
        return AdversarialState(
            _detached(motions), self._situation.ids[self._rows[best]], gap, self.iterations
        )

    def save(self, attacks: dict[AgentId, Path], iterations: int, weights: Costs) -> bool | None:
        """Third stage: whether a motion of the AV without contact is found; None out of time."""
        situation = self._situation
        obstacles = situation.obstacles([situation.ids[_AV]], attacks)
        if obstacles is None:
            return True
        own = self._init[:, [_AV]].clone().requires_grad_()
        moments = torch.optim.Adam([own], lr=_RATE["solution"])
        for turn in range(iterations + 1):
            motions = self._decode(self._with([_AV], own))
            if not self._touches(motions, attacks):
                return True
            if turn == iterations:
                return False
            if time.perf_counter() > self._deadline:
                return None
            loss = self._plausible(motions, [_AV], obstacles, own, weights)
            self._step(moments, loss, own)
        return False

    def _fit(self, rows: Sequence[int], paths: Sequence[Path], iterations: int) -> float:
        """Move latents until the vehicles follow the paths. Returns the mean error, metres."""
        rows = list(rows)
        latent = self._latent[:, rows].clone().requires_grad_()
        moments = torch.optim.Adam([latent], lr=_RATE["match"])
        position = torch.stack([path.position for path in paths])
        heading = torch.stack([path.heading for path in paths])
        there = torch.stack([path.there for path in paths]).float()
        least, best = float("inf"), latent.detach().clone()
        for turn in range(iterations + 1):
            motions = self._decode(self._with(rows, latent))
            away = _distance(motions.position[0, rows], position)
            turned = 1 - (motions.heading[0, rows] - heading).cos()
            error = (away * there).sum() / there.sum().clamp_min(1.0)
            if error.item() < least:
                least, best = error.item(), latent.detach().clone()
            if turn == iterations or time.perf_counter() > self._deadline:
                break
            far = functional.smooth_l1_loss(away, torch.zeros_like(away), reduction="none")
            fit = ((far + _HEADING_M * turned) * there).sum() / there.sum().clamp_min(1.0)
            prior = self._surprise(rows, latent).mean()
            self._step(moments, fit + 0.01 * prior, latent)
        self._latent = self._with(rows, best)
        return least

    def _step(self, moments: torch.optim.Adam, loss: Tensor, latent: Tensor) -> None:
        (latent.grad,) = torch.autograd.grad(loss, [latent])
        moments.step()
        self.iterations += 1

    def _with(self, rows: Sequence[int], latent: Tensor) -> Tensor:
        """All latents, those of some vehicles replaced."""
        return self._latent.index_copy(1, torch.tensor(list(rows)), latent)

    def _decode(self, latent: Tensor) -> DecodedMotions:
        graph = self._situation.graph
        return self._net.decode(graph, self._context, latent).placed(graph)

    def _gaps(self, motions: DecodedMotions, rollout: Path) -> Tensor:
        """(attackers, 80) gaps between discs of the AV and of each attacker; huge without the AV.

        The AV is at its pose in the last rollout, and reacts from there as the prior lets it react.
        """
        situation, av = self._situation, self._situation.ids[_AV]
        yields = motions.position[0, _AV] - motions.position[0, _AV].detach()
        moved = Path(rollout.position + yields, rollout.heading, rollout.there)
        target, radius = situation.discs(av, moved), situation.radius(av)
        gaps = []
        for row in self._rows:
            own = Path(motions.position[0, row], motions.heading[0, row], rollout.there)
            name = situation.ids[row]
            apart = costs.apart(situation.discs(name, own), target)
            gaps.append(apart - radius - situation.radius(name))
        return torch.stack(gaps).masked_fill(~rollout.there, 1e4)

    @staticmethod
    def _adversarial(gaps: Tensor) -> Tensor:
        """Soft minimum of the gaps over attackers and time from 2 s on."""
        near = gaps[:, _FREE_STEP:].flatten()
        loss: Tensor = ((-near.detach()).softmax(-1) * near).sum()
        return loss

    def _plausible(
        self,
        motions: DecodedMotions,
        rows: Sequence[int],
        obstacles: Obstacles | None,
        latent: Tensor,
        weights: Costs,
    ) -> Tensor:
        """The other costs of the motions of some vehicles."""
        situation, every = self._situation, slice(_EVERY - 1, None, _EVERY)
        total = weights.prior * self._surprise(rows, latent).sum()
        total = total + weights.init * (latent - self._init[:, rows]).square().sum()
        for row in rows:
            name = situation.ids[row]
            position = motions.position[0, row, every]
            if len(situation.road):
                away = costs.off_road(position, situation.road, situation.allowed[row])
                total = total + weights.road * away.mean()
            if obstacles is not None:
                path = Path(position, motions.heading[0, row, every], torch.ones(1))
                own, radius = situation.discs(name, path), situation.radius(name)
                depth = costs.overlap(
                    own, obstacles.discs[:, every], radius, obstacles.radius[:, None]
                )
                total = total + weights.others * (depth * obstacles.there[:, every]).sum(0).mean()
        return total

    def _surprise(self, rows: Sequence[int], latent: Tensor) -> Tensor:
        """(1, rows) half squares of standard deviations from the prior's mean."""
        prior: Gaussian = self._context.prior
        scale = (-prior.log_sigma[:, list(rows)]).exp()
        return 0.5 * ((latent - prior.mean[:, list(rows)]) * scale).square().sum(-1)

    def _touches(self, motions: DecodedMotions, attacks: dict[AgentId, Path]) -> bool:
        """Whether the AV's box meets that of an agent that did not touch it at first."""
        situation, av = self._situation, self._situation.ids[_AV]
        place = motions.position[0, _AV].detach().double().numpy()
        heading = motions.heading[0, _AV].detach().double().numpy()
        size = situation.sizes[av].double().numpy()
        for name, path in (situation.others | attacks).items():
            if name == av:
                continue
            hit = boxes.overlap(
                place,
                heading,
                size,
                path.position.double().numpy(),
                path.heading.double().numpy(),
                situation.sizes[name].double().numpy(),
            )
            hit &= path.there.numpy()
            if hit.any() and not hit[0]:
                return True
        return False


def plan_of(
    situation: GraphSituation, motions: DecodedMotions, agent_id: AgentId, steps: int
) -> Plan:
    """A decoded motion as a plan in the scene's frame; constant motion beyond its 8 s."""
    row, view = situation.row(agent_id), situation.view
    origin, turn = frame(view)
    local, heading, speed = (part[0, row].double().numpy() for part in motions)
    beyond = np.arange(1, max(steps - FUTURE_STEPS, 0) + 1)[:, None] * DT_S * speed[-1]
    local = np.concatenate([local, local[-1] + beyond * frames.unit(heading[-1])])[:steps]
    last = (0, len(local) - min(steps, FUTURE_STEPS))
    return Plan(
        agent_id=agent_id,
        first_step=view.step + 1,
        position_m=frames.to_scene(local, origin, turn),
        heading_rad=frames.wrap(np.pad(heading[:steps], last, mode="edge") + turn),
        speed_mps=np.pad(speed[:steps], last, mode="edge"),
    )


def _distance(first: Tensor, second: Tensor) -> Tensor:
    """(...) distances of points (..., 2), differentiable everywhere."""
    return ((first - second).square().sum(-1) + 1e-6).sqrt()


def _posterior(net: MotionPrior, situation: GraphSituation, context: Context) -> Tensor:
    """(1, N, 16) start of the first stage: the posterior's means."""
    pose = situation.graph["pose"][0]
    rows = []
    for path, (x, y, turn) in zip(situation.paths, pose, strict=True):
        offset = path.position - torch.stack([x, y])
        cos, sin = turn.cos(), turn.sin()
        local = [
            offset[:, 0] * cos + offset[:, 1] * sin,
            offset[:, 1] * cos - offset[:, 0] * sin,
            torch.remainder(path.heading - turn + torch.pi, 2 * torch.pi) - torch.pi,
            torch.ones_like(path.heading),
        ]
        rows.append(torch.stack(local, -1) * path.there.float().unsqueeze(-1))
    future = torch.stack(rows)[None, :, _EVERY - 1 :: _EVERY]
    with torch.no_grad():
        return net.posterior(situation.graph, context, future).mean


def _detached(motions: DecodedMotions) -> DecodedMotions:
    return DecodedMotions(*(part.detach() for part in motions))
