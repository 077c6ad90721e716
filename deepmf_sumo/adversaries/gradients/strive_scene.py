"""A scouted situation as STRIVE's network and costs need it: tensors in the AV's frame now."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.adversaries.search.scouting import Motion, Scouted, motion_of
from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, AgentId, Floats, Plan, View
from deepmf_sumo.geometry import angles, frames
from deepmf_sumo.predictors.road_index import road_index
from deepmf_sumo.predictors.strive import costs
from deepmf_sumo.predictors.strive.graph import graph_of, members
from deepmf_sumo.predictors.strive.motion_prior import Context, MotionPrior, Motions

_DISCS = 5
_ROAD_M = 250.0
"""Lanes farther from the AV than this are out of everybody's reach."""
_LANE_M = 1.6
"""From a lane's centre line: farther away a vehicle begins to leave it."""


class Path(NamedTuple):
    """What one agent does in the next 8 s: (80, 2), (80), and (80) whether it is there."""

    position: Tensor
    heading: Tensor
    there: Tensor


class Obstacles(NamedTuple):
    """Discs of other agents: centres (O, 80, 5, 2), radii (O), there (O, 80)."""

    discs: Tensor
    radius: Tensor
    there: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The graph, what the network says of it, and what everybody does un-attacked.

    Attributes:
        ids: (N) vehicles of the graph, the AV first.
        graph, context: of the network, B = 1.
        paths: (N) what they do un-attacked.
        others: what everybody around does, by id, those beside the graph included.
        sizes: (2) length and width of everybody, by id.
        road: (Q, 2) points on lanes, every metre.
        allowed: (N, 1) metres from the centre line that each may be: more than a lane's half where
            it begins farther away.
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
        """Everybody but some, on their own paths or those given; None if there is nobody."""
        paths = {name: path for name, path in (self.others | also).items() if name not in but}
        if not paths:
            return None
        return Obstacles(
            torch.stack([self.discs(name, path) for name, path in paths.items()]),
            torch.stack([self.radius(name) for name in paths]),
            torch.stack([path.there for path in paths.values()]),
        )

    def plan(self, motions: Motions, agent_id: AgentId, steps: int) -> Plan:
        """A decoded motion as a plan of the scene's frame; constant motion beyond its 8 s."""
        row, view = self.row(agent_id), self.view
        origin, turn = _frame(view)
        local = motions.position[0, row].double().numpy()
        heading = motions.heading[0, row].double().numpy()
        speed = motions.speed[0, row].double().numpy()
        beyond = np.arange(1, max(steps - FUTURE_STEPS, 0) + 1)[:, None] * DT_S * speed[-1]
        local = np.concatenate([local, local[-1] + beyond * angles.unit(heading[-1])])[:steps]
        last = (0, len(local) - min(steps, FUTURE_STEPS))
        return Plan(
            agent_id=agent_id,
            first_step=view.step + 1,
            position_m=frames.to_scene(local, origin, turn),
            heading_rad=angles.wrap(np.pad(heading[:steps], last, mode="edge") + turn),
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
    """Where the AV is now: the frame of the graph."""
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
        line for line, drivable in zip(index.points_m, index.drivable, strict=True) if drivable
    ]
    points = np.concatenate(lanes) if lanes else np.zeros((0, 2))
    near = np.hypot(*(points - origin).T) < _ROAD_M
    return _tensor(frames.to_local(points[near], origin, turn))


def _tensor(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
