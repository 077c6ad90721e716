"""The vehicles around an AV as attackers with a motion prior see them: `strive`, `diffscene`.

All that the unattacked episode tells is here: where everyone drives, the lanes, and the graph that
the networks read. Everything is in the graph's frame, that of the AV now.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepmf_sumo.attacks._episodes import AgentMotion, Scouted, motion_of
from deepmf_sumo.baselines.priors import costs
from deepmf_sumo.baselines.priors.graph import graph_of, members
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.scene import FUTURE_STEPS, AgentId, Floats, View
from deepmf_sumo.scene.geometry import frames

DISCS = 5
ROAD_M = 250.0
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
class GraphSituation:
    """The graph, and the unattacked motion of all agents.

    Attributes:
        ids: (N) vehicles of the graph, the AV first.
        graph: see `priors.graph`, B = 1.
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
    paths: tuple[Path, ...]
    others: dict[AgentId, Path]
    sizes: dict[AgentId, Tensor]
    road: Tensor
    allowed: Tensor

    def row(self, agent_id: AgentId) -> int:
        """Of a vehicle in the graph."""
        return self.ids.index(agent_id)

    def to_path(self, motion: AgentMotion) -> Path:
        """A motion of the scene's frame as the tensors of its first 8 s."""
        return _path(self.view, motion)

    def discs(self, agent_id: AgentId, path: Path) -> Tensor:
        """(80, 5, 2) of an agent on a path."""
        return costs.disc_centres(path.position, path.heading, self.sizes[agent_id], DISCS)

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


def situation_of(scouted: Scouted, wanted: Sequence[AgentId]) -> GraphSituation:
    """The situation around the AV, with the wanted vehicles in the graph."""
    view, tracks = scouted.view, scouted.view.history
    ids = members(view, wanted)
    graph = {
        name: torch.from_numpy(values[None, : len(ids)])
        for name, values in graph_of(view, ids).items()
    }
    others = {
        name: _path(view, motion_of(scouted.rollout, name, FUTURE_STEPS))
        for name in tracks.ids
        if name in scouted.rollout.tracks.ids
    }
    road = _road(view)
    away = costs.off_road(graph["pose"][0, :, None, :2], road, 0.0) if len(road) else None
    allowed = torch.zeros(len(ids), 1) if away is None else away.clamp_min(_LANE_M)
    return GraphSituation(
        view=view,
        ids=ids,
        graph=graph,
        paths=tuple(others[name] for name in ids),
        others=others,
        sizes={
            name: torch.from_numpy(np.array(tracks.size_m[row, :2])).float()
            for row, name in enumerate(tracks.ids)
        },
        road=road,
        allowed=allowed,
    )


def frame(view: View) -> tuple[Floats, float]:
    """Present pose of the AV: the frame of the graph."""
    av = view.history.row(view.av_id)
    return view.history.position_m[av, -1], float(view.history.heading_rad[av, -1])


def _path(view: View, motion: AgentMotion) -> Path:
    origin, turn = frame(view)
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
    origin, turn = frame(view)
    lanes = [
        line for line, drivable in zip(index.map.line_m, index.drivable, strict=True) if drivable
    ]
    points = np.concatenate(lanes) if lanes else np.zeros((0, 2))
    near = np.hypot(*(points - origin).T) < ROAD_M
    return _tensor(frames.to_local(points[near], origin, turn))


def _tensor(values: Floats) -> Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
