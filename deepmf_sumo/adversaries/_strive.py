"""The stages of `strive`: Adam moves a scene's latents to match, to attack, and to save the AV.

Costs are in metres: a weight converts its term into distance to the AV.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deepmf_sumo.adversaries._episodes import Motion, Scouted, motion_of
from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, AgentId, Floats, Plan, View
from deepmf_sumo.geometry import boxes, frames
from deepmf_sumo.predictors.lanes import road_index
from deepmf_sumo.predictors.strive import costs
from deepmf_sumo.predictors.strive.graph import graph_of, members
from deepmf_sumo.predictors.strive.motion_prior import Context, Gaussian, MotionPrior, Motions

_DISCS = 5
_ROAD_M = 250.0
"""No vehicle reaches lanes farther from the AV than this."""
_LANE_M = 1.6
"""Distance from a lane's centre line at which a vehicle starts to leave the lane."""


class Path(NamedTuple):
    """Motion of one agent in the next 8 s: (80, 2), (80), and (80) whether it is present."""

    position: Tensor
    heading: Tensor
    there: Tensor


class Obstacles(NamedTuple):
    """Discs of other agents: centres (O, 80, 5, 2), radii (O), present (O, 80)."""

    discs: Tensor
    radius: Tensor
    there: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The graph, its encoding by the network, and the unattacked motion of all agents.

    Attributes:
        ids: (N) vehicles of the graph, the AV first.
        graph, context: of the network, B = 1.
        paths: (N) their unattacked motion.
        others: unattacked motion of all agents by id, including those outside the graph.
        sizes: (2) length and width of all agents, by id.
        road: (Q, 2) points on lanes, every metre.
        allowed: (N, 1) metres from the centre line without a cost: more than half a lane for
            vehicles that start farther away.
    """

    view: View
    ids: tuple[AgentId, ...]
    graph: dict[str, Tensor]
    context: Context
    paths: tuple[Path, ...]
    others: dict[AgentId, Path]
    sizes: dict[AgentId, Tensor]
    road: Tensor
    allowed: Tensor

    def row(self, agent_id: AgentId) -> int:
        """Of a vehicle in the graph."""
        return self.ids.index(agent_id)

    def to_path(self, motion: Motion) -> Path:
        """A motion of the scene's frame as the tensors of its first 8 s."""
        return _path(self.view, motion)

    def discs(self, agent_id: AgentId, path: Path) -> Tensor:
        """(80, 5, 2) of an agent on a path."""
        return costs.disc_centres(path.position, path.heading, self.sizes[agent_id], _DISCS)

    def radius(self, agent_id: AgentId) -> Tensor:
        """() of an agent's discs."""
        return costs.disc_radius(self.sizes[agent_id])

    def obstacles(self, but: Sequence[AgentId], also: dict[AgentId, Path]) -> Obstacles | None:
        """All agents except ``but``, on their own paths or those given; None if there are none."""
        paths = {name: path for name, path in (self.others | also).items() if name not in but}
        if not paths:
            return None
        return Obstacles(
            torch.stack([self.discs(name, path) for name, path in paths.items()]),
            torch.stack([self.radius(name) for name in paths]),
            torch.stack([path.there for path in paths.values()]),
        )

    def plan(self, motions: Motions, agent_id: AgentId, steps: int) -> Plan:
        """A decoded motion as a plan in the scene's frame; constant motion beyond its 8 s."""
        row, view = self.row(agent_id), self.view
        origin, turn = _frame(view)
        local = motions.position[0, row].double().numpy()
        heading = motions.heading[0, row].double().numpy()
        speed = motions.speed[0, row].double().numpy()
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


def situation_of(scouted: Scouted, net: MotionPrior, wanted: Sequence[AgentId]) -> Situation:
    """The situation around the AV, with the wanted vehicles in the graph."""
    view, tracks = scouted.view, scouted.view.history
    ids = members(view, wanted)
    graph = {
        name: torch.from_numpy(values[None, : len(ids)])
        for name, values in graph_of(view, ids).items()
    }
    with torch.no_grad():
        context = net.encode(graph)
    others = {
        name: _path(view, motion_of(scouted.rollout, name, FUTURE_STEPS))
        for name in tracks.ids
        if name in scouted.rollout.tracks.ids
    }
    road = _road(view)
    away = costs.off_road(graph["pose"][0, :, None, :2], road, 0.0) if len(road) else None
    allowed = torch.zeros(len(ids), 1) if away is None else away.clamp_min(_LANE_M)
    return Situation(
        view=view,
        ids=ids,
        graph=graph,
        context=context,
        paths=tuple(others[name] for name in ids),
        others=others,
        sizes={
            name: torch.from_numpy(np.array(tracks.size_m[row, :2])).float()
            for row, name in enumerate(tracks.ids)
        },
        road=road,
        allowed=allowed,
    )


def _frame(view: View) -> tuple[Floats, float]:
    """Present pose of the AV: the frame of the graph."""
    av = view.history.row(view.av_id)
    return view.history.position_m[av, -1], float(view.history.heading_rad[av, -1])


def _path(view: View, motion: Motion) -> Path:
    origin, turn = _frame(view)
    there = np.asarray(motion.valid[:FUTURE_STEPS])
    missing = FUTURE_STEPS - len(there)
    local = frames.to_local(motion.position_m[:FUTURE_STEPS], origin, turn)
    return Path(
        _tensor(np.pad(local, [(0, missing), (0, 0)])),
        _tensor(np.pad(motion.heading_rad[:FUTURE_STEPS] - turn, (0, missing))),
        torch.from_numpy(np.pad(there, (0, missing))),
    )


def _road(view: View) -> Tensor:
    """(Q, 2) points on lanes for cars around the AV."""
    index = road_index(view.road)
    origin, turn = _frame(view)
    lanes = [
        line for line, drivable in zip(index.map.line_m, index.drivable, strict=True) if drivable
    ]
    points = np.concatenate(lanes) if lanes else np.zeros((0, 2))
    near = np.hypot(*(points - origin).T) < _ROAD_M
    return _tensor(frames.to_local(points[near], origin, turn))


def _tensor(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))


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


class Attacked(NamedTuple):
    """A state of the adversarial stage.

    Attributes:
        motions: of all vehicles, in the graph's frame.
        closest: vehicle that comes closest to the AV's last rollout. gap_m: its gap, below 0 in
            contact. iterations: total number so far.
    """

    motions: Motions
    closest: AgentId
    gap_m: float
    iterations: int


class Search:
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
        situation: Situation,
        attackers: Sequence[AgentId],
        weights: Costs,
        deadline: float,
    ) -> None:
        self._net, self._situation, self._weights = net, situation, weights
        self._deadline = deadline
        self._rows = [situation.row(agent_id) for agent_id in attackers]
        self._latent = _posterior(net, situation)
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

    def attack(self, rollout: Path, iterations: int) -> Attacked:
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
        return Attacked(
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

    def _decode(self, latent: Tensor) -> Motions:
        graph = self._situation.graph
        return self._net.decode(graph, self._situation.context, latent).placed(graph)

    def _gaps(self, motions: Motions, rollout: Path) -> Tensor:
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
        motions: Motions,
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
        prior: Gaussian = self._situation.context.prior
        scale = (-prior.log_sigma[:, list(rows)]).exp()
        return 0.5 * ((latent - prior.mean[:, list(rows)]) * scale).square().sum(-1)

    def _touches(self, motions: Motions, attacks: dict[AgentId, Path]) -> bool:
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


def _distance(first: Tensor, second: Tensor) -> Tensor:
    """(...) distances of points (..., 2), differentiable everywhere."""
    return ((first - second).square().sum(-1) + 1e-6).sqrt()


def _posterior(net: MotionPrior, situation: Situation) -> Tensor:
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
        return net.posterior(situation.graph, situation.context, future).mean


def _detached(motions: Motions) -> Motions:
    return Motions(*(part.detach() for part in motions))
