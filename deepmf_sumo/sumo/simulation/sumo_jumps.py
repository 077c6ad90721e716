"""Where SUMO itself moves a road user farther than it drives: events ``teleported``, ``jumped``.

Motions that a planner or a policy commands are none of them: those must not jump.
"""

from collections.abc import Collection
from typing import Final

import numpy as np

from deepmf_sumo.scene import DT_S, AgentId, Event, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.frame import Frame
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_FASTER: Final = 1.15
"""A box turns about its rear axle, so its centre may be faster than SUMO's front."""
_AHEAD_M: Final = 1.0
_LANE_M: Final = 4.5
"""SUMO changes lanes within a step."""


class SumoJumps:
    """Notes jumps; called once a step.

    Args:
        api: a running SUMO.
        av_id: says itself where SUMO teleports it.
        events: to which notes are added.
    """

    def __init__(self, api: SumoApi, av_id: AgentId, events: list[Event]) -> None:
        self._simulation, self._av, self._events = api.simulation, av_id, events
        self._before: Frame | None = None

    def note(self, step: int, frame: Frame, placed: Collection[AgentId]) -> None:
        """Judge a step that led to a frame; SUMO did not move the agents that were ``placed``."""
        moved = self._teleports(step)
        before, self._before = self._before, frame
        if before is not None:
            self._jumps(step, before, frame, {*moved, *placed})

    def _teleports(self, step: int) -> set[AgentId]:
        """Say which vehicles SUMO took off the road, or put onto it elsewhere: they were stuck."""
        simulation = self._simulation
        moved = {*simulation.getStartingTeleportIDList(), *simulation.getEndingTeleportIDList()}
        for agent in sorted(moved - {self._av}):
            detail = "SUMO took it for stuck"
            self._events.append(Event(step=step, agent_id=agent, kind="teleported", detail=detail))
        return moved

    def _jumps(self, step: int, before: Frame, now: Frame, besides: Collection[AgentId]) -> None:
        """Say what SUMO moves farther in a step than it drives and changes lanes.

        Over junctions without lanes inside, into stops beside the road, to waiting places.
        """
        if before.ids == now.ids:
            old = new = np.arange(len(now.ids))
        else:
            row_of = {agent: row for row, agent in enumerate(before.ids)}
            pairs = [(row_of[one], row) for row, one in enumerate(now.ids) if one in row_of]
            old, new = np.array(pairs, int).reshape(-1, 2).T
        moved = now.position_m[new] - before.position_m[old]
        speeds = np.hypot(*before.velocity_mps[old].T), np.hypot(*now.velocity_mps[new].T)
        way_m = _FASTER * np.maximum(*speeds) * DT_S
        ahead_m = np.abs((moved * frames.unit(before.heading_rad[old])).sum(-1))
        far = (ahead_m > way_m + _AHEAD_M) | (np.hypot(*moved.T) > way_m + _LANE_M)
        for pair in np.flatnonzero(far).tolist():
            agent = now.ids[new[pair]]
            if agent not in besides and agent_ids.whole_of(agent) == agent:
                detail = f"SUMO moved it by {np.hypot(*moved[pair]):.1f} m in a step"
                self._events.append(Event(step=step, agent_id=agent, kind="jumped", detail=detail))
