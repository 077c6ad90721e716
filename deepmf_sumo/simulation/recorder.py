"""Keeps what happened, and shows the present and the last second of it."""

from collections.abc import Callable

import numpy as np

from deepmf_sumo.datatypes import (
    HISTORY_STEPS,
    AgentId,
    AgentKind,
    Bytes,
    Floats,
    Ints,
    RoadMap,
    SignalState,
    Tracks,
    View,
)
from deepmf_sumo.simulation.frame import Body, Frame


class Recorder:
    """Rows of all agents seen, in the order of their first appearance.

    Args:
        steps: length T of the time axis.
        body: what an agent that appears is.
    """

    def __init__(self, steps: int, body: Callable[[AgentId], Body]) -> None:
        self.step = -1
        self._body = body
        self._steps = steps
        self._row: dict[AgentId, int] = {}
        self._kinds: list[AgentKind] = []
        self._sizes: list[tuple[float, float, float]] = []
        # x, y, z, heading, vx, vy
        self._state = np.zeros((64, steps, 6))
        self._driver = np.zeros((64, steps), np.uint8)
        self._valid = np.zeros((64, steps), bool)

    def add(self, frame: Frame) -> None:
        """Append one step."""
        self.step += 1
        rows = np.array([self._row_of(agent) for agent in frame.ids], int)
        now = self._state[:, self.step]
        now[rows, :2] = frame.position_m
        now[rows, 2] = frame.z_m
        now[rows, 3] = frame.heading_rad
        now[rows, 4:] = frame.velocity_mps
        self._driver[rows, self.step] = frame.driver
        self._valid[rows, self.step] = True

    def view(
        self,
        av_id: AgentId,
        road: RoadMap,
        signals: dict[str, SignalState],
        steps_left: int,
        av_path_m: Floats | None = None,
    ) -> View:
        """The present and the last second of all agents that are there now."""
        start = max(0, self.step + 1 - HISTORY_STEPS)
        rows = np.flatnonzero(self._valid[: len(self._row), self.step])
        return View(
            step=self.step,
            dt_s=0.1,
            av_id=av_id,
            history=self._tracks(rows, start, self.step + 1),
            road=road,
            signals=signals,
            steps_left=steps_left,
            av_path_m=av_path_m,
        )

    def tracks(self) -> tuple[Tracks, Bytes]:
        """Everything recorded so far, and the drivers (A, T)."""
        rows = np.arange(len(self._row))
        return self._tracks(rows, 0, self.step + 1), self._driver[rows, : self.step + 1]

    def sizes_m(self, ids: list[AgentId]) -> Floats:
        """(N, 2) length and width of agents."""
        return np.array([self._sizes[self._row[agent]][:2] for agent in ids]).reshape(-1, 2)

    def _tracks(self, rows: Ints, a: int, b: int) -> Tracks:
        ids = list(self._row)
        state = self._state[rows, a:b]
        return Tracks(
            ids=tuple(ids[row] for row in rows),
            kinds=tuple(self._kinds[row] for row in rows),
            size_m=np.array([self._sizes[row] for row in rows]).reshape(-1, 3),
            position_m=state[..., :2],
            z_m=state[..., 2],
            heading_rad=state[..., 3],
            velocity_mps=state[..., 4:],
            valid=self._valid[rows, a:b],
        )

    def _row_of(self, agent: AgentId) -> int:
        row = self._row.get(agent)
        if row is None:
            row = self._row[agent] = len(self._row)
            body = self._body(agent)
            self._kinds.append(body.kind)
            self._sizes.append(body.size_m)
            if row == len(self._state):
                self._state = np.concatenate([self._state, np.zeros_like(self._state)])
                self._driver = np.concatenate([self._driver, np.zeros_like(self._driver)])
                self._valid = np.concatenate([self._valid, np.zeros_like(self._valid)])
        return row
