"""Which agents are around a vehicle, touch it, or are in its way."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepmf_sumo.planners.perception import entries
from deepmf_sumo.scene import DT_S, AgentId, Floats, RoadMap, agent_ids
from deepmf_sumo.scene.agent_ids import whole_of
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import clear, off_level
from deepmf_sumo.sumo.simulation.contacts import overlapping
from deepmf_sumo.sumo.simulation.frame import Frame, Pose

_MARGIN_M: Final = np.array([1.0, 0.4])
"""Added to length and width of a vehicle whose way must be free."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Occupancy:
    """All N agents around a vehicle, the AV among them; ``size_m`` (N, 2) lengths and widths."""

    frame: Frame
    size_m: Floats
    av_id: AgentId

    def touched(self, agent: AgentId) -> bool:
        """Whether the box of an agent other than the AV overlaps that of ``agent``."""
        ids = self.frame.ids
        return any(whole_of(ids[row]) != self.av_id for row in self._touching(agent))

    def clear(self, agent: AgentId, poses: Sequence[Pose]) -> bool:
        """Whether the way of an agent is free: K poses, 0.1 s apart; all others keep their speed.

        Agents that touch it already are not in its way: it could not get away from them.
        """
        frame = self.frame
        if agent not in frame.ids:
            return True
        me = frame.ids.index(agent)
        others = np.array([whole_of(one) != agent for one in frame.ids])
        others[self._touching(agent)] = False
        others &= ~clear(frame.z_m[me], frame.z_m)
        mine = np.array([(one.x_m, one.y_m, one.heading_rad) for one in poses])
        after_s = DT_S * np.arange(1, len(poses) + 1)[:, None, None]
        theirs = frame.position_m[others] + after_s * frame.velocity_mps[others]
        hit = boxes.overlap(
            mine[:, None, :2],
            mine[:, None, 2],
            self.size_m[me] + _MARGIN_M,
            theirs,
            frame.heading_rad[others],
            self.size_m[others],
        )
        return not bool(np.any(hit))

    def in_its_way(
        self, agent: AgentId, path_m: Floats, among: Collection[AgentId], road: RoadMap
    ) -> dict[AgentId, float]:
        """Gaps, in metres, to those of ``among`` that reach into the way of an agent on its level.

        ``path_m``: (P, 2) middle of its way, from its front on.
        """
        frame = self.frame
        if agent not in frame.ids:
            return {}
        me = frame.ids.index(agent)
        others = [row for row, one in enumerate(frame.ids) if one in among]
        gap, _ = entries(
            path_m,
            self.size_m[me, 1] / 2,
            frame.position_m[others],
            frame.heading_rad[others],
            self.size_m[others],
        )
        here, z_m = frame.position_m[me], float(frame.z_m[me])
        gap[off_level(road, here, z_m, frame.position_m[others], frame.z_m[others])] = np.inf
        near = np.flatnonzero(gap < np.inf)
        return {frame.ids[others[row]]: float(gap[row]) for row in near}

    def without_persons(self, agent: AgentId) -> "Occupancy":
        """The same without all persons of SUMO but ``agent``."""
        kept = [
            row
            for row, one in enumerate(self.frame.ids)
            if one == agent or agent_ids.person_of(one) is None
        ]
        frame = self.frame.of_agents({self.frame.ids[row] for row in kept})
        return replace(self, frame=frame, size_m=self.size_m[kept])

    def _touching(self, agent: AgentId) -> list[int]:
        frame = self.frame
        if agent not in frame.ids:
            return []
        me = frame.ids.index(agent)
        rows = overlapping(me, frame.position_m, frame.heading_rad, self.size_m, frame.z_m)
        return [row for row in rows if whole_of(frame.ids[row]) != agent]
