"""Records an episode: the state of every agent, the attacks on the AV, and the contacts."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from deepmf_sumo.scene import (
    DT_S,
    HISTORY_STEPS,
    AgentId,
    AgentKind,
    Bytes,
    Case,
    Driver,
    Event,
    Floats,
    Ints,
    RoadMap,
    Rollout,
    SignalState,
    Tracks,
    View,
)
from deepmf_sumo.scene.plan import TurnEnd
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.contacts import ContactFinder
from deepmf_sumo.sumo.simulation.frame import Body, Frame
from deepmf_sumo.sumo.simulation.world import BeginningWorld


class Recorder:
    """The states of all agents that have appeared, in the order of their first appearance.

    Args:
        steps: length T of the time axis.
        body: kind and size of an agent that appears.

    Attributes:
        step: the last one recorded; -1 if there is none.
    """

    def __init__(self, steps: int, body: Callable[[AgentId], Body]) -> None:
        self.step = -1
        self._body = body
        self._steps = steps
        self._row: dict[AgentId, int] = {}
        self._ids: list[AgentId] = []
        self._last: tuple[list[AgentId], Ints] = [], np.zeros(0, int)
        self._shown: tuple[list[int], tuple[AgentId, ...], tuple[AgentKind, ...]] = [], (), ()
        self._kinds: list[AgentKind] = []
        self._size_m = np.zeros((64, 3))
        # x, y, z, heading, vx, vy
        self._state = np.zeros((64, steps, 6))
        self._driver = np.zeros((64, steps), np.uint8)
        self._valid = np.zeros((64, steps), bool)

    def add(self, frame: Frame) -> None:
        """Append one step."""
        state = np.column_stack(
            [frame.position_m, frame.z_m, frame.heading_rad, frame.velocity_mps]
        )
        self.extend(frame.ids, state[:, None], frame.driver[:, None])

    def extend(self, ids: list[AgentId], state: Floats, driver: Bytes) -> None:
        """Append K steps of N agents, which are in the order of their appearance.

        Args:
            ids: (N).
            state: (N, K, 6) x, y, z, heading, vx, vy; zeros where an agent is absent.
            driver: (N, K) Driver numbers; NOBODY where an agent is absent.
        """
        rows = self._rows_of(ids)
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
        """The present and the last second of all agents that are present now."""
        start = max(0, self.step + 1 - HISTORY_STEPS)
        rows = np.flatnonzero(self._valid[: len(self._row), self.step])
        return View(
            step=self.step,
            dt_s=DT_S,
            av_id=av_id,
            history=self._tracks(rows, start, self.step + 1),
            road=road,
            signals=signals,
            steps_left=steps_left,
            av_path_m=av_path_m,
            av_recorded_steps=self._recorded_steps(av_id, start + 1),
        )

    def _recorded_steps(self, agent: AgentId, start: int) -> int:
        """Number of steps from ``start`` on in which an agent moved as recorded."""
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
        return self._size_m[self._rows_of(ids), :2]

    def _tracks(self, rows: Ints, a: int, b: int) -> Tracks:
        state = self._state[rows, a:b]
        listed = rows.tolist()
        if listed != self._shown[0]:  # mostly those of the last step
            ids = tuple([self._ids[row] for row in listed])
            self._shown = listed, ids, tuple([self._kinds[row] for row in listed])
        return Tracks(
            ids=self._shown[1],
            kinds=self._shown[2],
            size_m=self._size_m[rows],
            position_m=state[..., :2],
            z_m=state[..., 2],
            heading_rad=state[..., 3],
            velocity_mps=state[..., 4:],
            valid=self._valid[rows, a:b],
        )

    def _rows_of(self, ids: list[AgentId]) -> Ints:
        """(N) rows of agents, which get one where they appear; mostly those of the last step."""
        if ids != self._last[0]:
            self._last = list(ids), np.array([self._row_of(agent) for agent in ids], int)
        return self._last[1]

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


@contextmanager
def timed(seconds: dict[str, float], part: str) -> Iterator[None]:
    """Add the time that the context takes to that of a part."""
    begin = time.perf_counter()
    try:
        yield
    finally:
        seconds[part] += time.perf_counter() - begin


class EpisodeRecord:
    """One AV under attack: its recorder, the schedule of attacks, and the judge of contacts.

    What steps the world (the loop of an episode, another program) calls `replan` before a step and
    `add` after it; `log_only`, which makes many steps together, drives its parts itself.

    Args:
        av_id: the AV.
        road: the map in views.
        recorder: has the history up to the current step.
        frame: the last frame of the history.
        duration_steps: from the current step to the end.
        signals: the current states of the lights.
        schedule: makes the schedule of attacks from the view at the current step.

    Attributes:
        now, end: the current step of the case, and the last one to simulate.
        frame: the last one.
    """

    def __init__(
        self,
        av_id: AgentId,
        road: RoadMap,
        recorder: Recorder,
        frame: Frame,
        duration_steps: int,
        signals: Callable[[], dict[str, SignalState]],
        schedule: Callable[[View], AttackSchedule],
    ) -> None:
        self._av, self._road, self._signals = av_id, road, signals
        self.recorder, self.frame = recorder, frame
        self.now, self.end = recorder.step, recorder.step + duration_steps
        self.schedule = schedule(self.view())
        self.contact_finder = ContactFinder(av_id, self.schedule.attackers)
        self.contact_finder.look(self.now, frame, recorder.sizes_m(frame.ids))

    @classmethod
    def begun(
        cls, case: Case, world: BeginningWorld, policy: Policy | None, rng: np.random.Generator
    ) -> "EpisodeRecord":
        """The record of a world's history, with the first attack."""
        history = world.history()
        recorder = Recorder(len(history) + case.duration_steps, world.body)
        for frame in history:
            recorder.add(frame)
        return cls(
            case.av_id,
            case.road,
            recorder,
            history[-1],
            case.duration_steps,
            world.signals,
            lambda view: AttackSchedule(policy, view, rng, case.turns, world.next_owner),
        )

    @property
    def step(self) -> int:
        """The last step that has happened."""
        return self.recorder.step

    def view(self, av_path_m: Floats | None = None) -> View:
        """What a policy sees now, or a planner, which also sees the path ahead of the AV."""
        left = self.end - self.step
        return self.recorder.view(self._av, self._road, self._signals(), left, av_path_m)

    def replan(self) -> None:
        """Let the policy choose attackers or plan, if that is due."""
        if self.schedule.due(self.step):
            self.schedule.replan(self.view())
        if self.schedule.attackers != self.contact_finder.attackers:
            size_m = self.recorder.sizes_m(self.frame.ids)
            self.contact_finder.turn_to(self.schedule.attackers, self.step, self.frame, size_m)
        if self.schedule.supporters != self.contact_finder.supporters:
            size_m = self.recorder.sizes_m(self.frame.ids)
            self.contact_finder.watch(self.schedule.supporters, self.step, self.frame, size_m)

    def add(self, frame: Frame) -> bool:
        """Record and judge a step; returns whether AV and an attacker have ended the episode."""
        self.recorder.add(frame)
        self.frame = frame
        size_m, step = self.recorder.sizes_m(frame.ids), self.step
        self.contact_finder.look(step, frame, size_m)
        return self.schedule.after_step(step, frame, size_m, self.contact_finder.hits(step))

    def rollout(
        self,
        ended: TurnEnd,
        events: Sequence[Event] = (),
        *,
        seconds: dict[str, float] | None = None,
        leaders: Sequence[tuple[AgentId, ...] | None] = (),
        signals: Sequence[dict[str, SignalState]] = (),
    ) -> Rollout:
        """The episode up to the last step, which ended it; ``events`` are those of the world."""
        self.schedule.finish(self.step, ended)
        tracks, driver = self.recorder.tracks()
        planned = [event for event in self.schedule.events if event.step <= self.step]
        return Rollout(
            tracks=tracks,
            driver=driver,
            now=self.now,
            dt_s=DT_S,
            av_id=self._av,
            attackers=self.schedule.of_episode,
            contacts=tuple(self.contact_finder.contacts),
            events=tuple(
                sorted(
                    [*events, *planned, *self.contact_finder.events], key=lambda event: event.step
                )
            ),
            plans=tuple(self.schedule.plans),
            ended=ended,
            seconds=seconds or {},
            leaders=tuple(leaders),
            signals=tuple(signals),
            turns=self.schedule.closed,
        )
