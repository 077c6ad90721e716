"""Keeps what happened, and shows the present and the last second of it."""

from collections.abc import Callable

import numpy as np

from deepmf_sumo.datatypes import (
    HISTORY_STEPS,
    AgentId,
    AgentKind,
    Bytes,
    Driver,
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
        self._ids: list[AgentId] = []
        self._kinds: list[AgentKind] = []
        self._size_m = np.zeros((64, 3))
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

    def extend(self, ids: list[AgentId], state: Floats, driver: Bytes) -> None:
        """Append K steps of N agents, who are in the order of their appearance.

        Args:
            ids: (N).
            state: (N, K, 6) x, y, z, heading, vx, vy; zeros where an agent is not there.
            driver: (N, K) Driver numbers; NOBODY where an agent is not there.
        """
        rows = np.array([self._row_of(agent) for agent in ids], int)
        steps = slice(self.step + 1, self.step + 1 + driver.shape[1])
        self.step += driver.shape[1]
        self._state[rows, steps] = state
        self._driver[rows, steps] = driver
        self._valid[rows, steps] = driver != Driver.NOBODY

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
            av_recorded_steps=self._recorded_steps(av_id, start + 1),
        )

    def _recorded_steps(self, agent: AgentId, start: int) -> int:
        """Steps from ``start`` on in which an agent moved as recorded."""
        row = self._row.get(agent)
        if row is None:
            return 0
        return int((self._driver[row, start : self.step + 1] == Driver.LOG).sum())

    def tracks(self) -> tuple[Tracks, Bytes]:
        """Everything recorded so far, and the drivers (A, T)."""
        rows = np.arange(len(self._row))
        return self._tracks(rows, 0, self.step + 1), self._driver[rows, : self.step + 1]

    def sizes_m(self, ids: list[AgentId]) -> Floats:
        """(N, 2) length and width of agents."""
        size: Floats = self._size_m[[self._row[agent] for agent in ids], :2]
        return size

    def _tracks(self, rows: Ints, a: int, b: int) -> Tracks:
        state = self._state[rows, a:b]
        listed = rows.tolist()
        return Tracks(
            ids=tuple(self._ids[row] for row in listed),
            kinds=tuple(self._kinds[row] for row in listed),
            size_m=self._size_m[rows],
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
            self._ids.append(agent)
            self._kinds.append(body.kind)
            if row == len(self._state):
                self._size_m, self._state, self._driver, self._valid = (
                    np.concatenate([array, np.zeros_like(array)])
                    for array in (self._size_m, self._state, self._driver, self._valid)
                )
            self._size_m[row] = body.size_m
        return row
