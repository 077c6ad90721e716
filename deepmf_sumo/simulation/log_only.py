"""An episode in which the opponent alone does something new: no SUMO is needed for it.

Where the traffic replays the log and the AV does the same whatever happens (`FixedPlanner`), SUMO
would only carry known poses around. They are put together here, many steps at a time, and judged by
the same `Judge`: rollouts are those of the loop over SUMO, but for the events in which the stage
tells where SUMO has the AV.
"""

import time
from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from deepmf_sumo.datatypes import (
    DT_S,
    AgentId,
    Bytes,
    Driver,
    Floats,
    Ints,
    RecordedCase,
    Rollout,
    Scene,
    Signals,
    SignalState,
    View,
    frozen,
)
from deepmf_sumo.geometry import boxes, frames
from deepmf_sumo.geometry.ground import clear, ground_of
from deepmf_sumo.planners.base import FixedPlanner
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation.attack_schedule import Opponent
from deepmf_sumo.simulation.contacts import Judge
from deepmf_sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.simulation.log_plan import check_route
from deepmf_sumo.simulation.recorder import Recorder


def episode(
    case: RecordedCase, planner: FixedPlanner, policy: Policy | None, rng: np.random.Generator
) -> Rollout:
    """The episode. Raises SimulationError as the loop over SUMO does."""
    check_route(case)
    seconds: dict[str, float] = defaultdict(float)
    world = _World(case, case.scene, planner.fixed_poses(case.duration_steps))
    end = world.now + case.duration_steps
    signals = _signals(case.scene.signals, end)
    begin = time.perf_counter()
    opponent = Opponent(policy, world.view(signals[world.now], end), rng)
    seconds["policy"] += time.perf_counter() - begin
    world.meet(opponent.id)
    while world.step < end and not world.hit:
        begin = time.perf_counter()
        stop = world.step + 1
        if opponent.due(world.step):
            opponent.replan(world.view(signals[world.step], end))
        seconds["policy"] += time.perf_counter() - begin
        begin = time.perf_counter()
        while stop < end and not opponent.due(stop):
            stop += 1
        world.advance([opponent.pose(step) for step in range(world.step + 1, stop + 1)])
        seconds["simulation"] += time.perf_counter() - begin
    return _rollout(world, opponent, signals, {"planner": 0.0, **seconds})


def _rollout(
    world: "_World",
    opponent: Opponent,
    signals: tuple[dict[str, SignalState], ...],
    seconds: dict[str, float],
) -> Rollout:
    """What has happened; the last block of steps was asked for beyond the contact."""
    tracks, driver = world.recorder.tracks()
    events = [event for event in opponent.events if event.step <= world.step]
    return Rollout(
        tracks=tracks,
        driver=driver,
        now=world.now,
        dt_s=DT_S,
        av_id=world.av_id,
        opponent_id=opponent.id,
        contacts=tuple(world.judge.contacts),
        events=tuple(sorted([*events, *world.judge.events], key=lambda event: event.step)),
        plans=tuple(opponent.plans),
        ended="contact" if world.hit else "time",
        seconds=seconds,
        leaders=(None,) * (world.step - world.now),
        signals=signals[world.now : world.step],
    )


class _World:
    """The log, with the AV on its poses and the opponent on those that it is given.

    Args:
        case: with a recording.
        scene: the recording.
        av_poses: (K, 4) x, y, heading, speed of the AV after now.
    """

    def __init__(self, case: RecordedCase, scene: Scene, av_poses: Floats) -> None:
        self._case = case
        self.av_id = case.av_id
        self._tracks = scene.tracks
        self._size_m = scene.tracks.size_m[:, :2]
        self._av = scene.tracks.row(case.av_id)
        self._opponent: int | None = None
        self.now = scene.now
        log = _logged(scene, scene.now + 1 + case.duration_steps)
        self._state, self._driver = log.state.copy(), log.driver.copy()
        self._ground = ground_of(case.road)
        after = np.arange(len(av_poses)) + self.now + 1
        self._drive(self._av, after, av_poses, av_poses[:, 2], Driver.PLANNER)
        self.recorder = Recorder(self._driver.shape[1], self._body)
        self._record(self.now)
        self.judge = Judge(case.av_id, None)

    @property
    def step(self) -> int:
        """Last step that has happened."""
        return self.recorder.step

    @property
    def hit(self) -> bool:
        """Whether AV and opponent are in contact."""
        return any(contact.kind == "av_opponent" for contact in self.judge.contacts)

    def view(self, signals: dict[str, SignalState], end: int) -> View:
        """What a policy sees now."""
        case = self._case
        return self.recorder.view(case.av_id, case.road, signals, end - self.step)

    def meet(self, opponent: AgentId | None) -> None:
        """Judge the current step, now that it is known who the opponent is."""
        self._opponent = None if opponent is None else self._tracks.row(opponent)
        self.judge = Judge(self._case.av_id, opponent)
        self._look(self.now)

    def advance(self, poses: list[Pose | None]) -> None:
        """So many steps with the opponent on poses (None: the log's), or up to the contact."""
        steps = np.arange(len(poses)) + self.step + 1
        driven = [(step, pose) for step, pose in zip(steps, poses, strict=True) if pose is not None]
        if driven and self._opponent is not None:
            table = [[at.x_m, at.y_m, at.heading_rad, at.speed_mps] for _, at in driven]
            course = [
                at.heading_rad if at.course_rad is None else at.course_rad for _, at in driven
            ]
            at_steps = np.array([step for step, _ in driven])
            self._drive(self._opponent, at_steps, np.array(table), np.array(course), Driver.POLICY)
        for step in self._first_overlaps(steps):
            self._look(step - 1)
            self._look(step)
            if self.hit:
                self._record(step)
                return
        self._record(int(steps[-1]))

    def _drive(
        self, row: int, steps: Ints, poses: Floats, course_rad: Floats, driver: Driver
    ) -> None:
        """Put an agent on poses (K, 4) at steps (K), moving along courses (K)."""
        state = self._state[row]
        before = int(steps[0]) - 1
        way = np.concatenate([state[before : before + 1, :2], poses[:, :2]])
        state[steps, 2] = self._ground.follow(way[None], state[before : before + 1, 2])[0, 1:]
        state[steps, :2] = poses[:, :2]
        state[steps, 3] = poses[:, 2]
        state[steps, 4:] = poses[:, 3:] * frames.unit(course_rad)
        self._driver[row, steps] = driver

    def _first_overlaps(self, steps: Ints) -> list[int]:
        """Steps at which the AV or the opponent overlaps somebody for the first time of them."""
        found: set[int] = set()
        span = slice(int(steps[0]), int(steps[-1]) + 1)
        there = self._driver[:, span] != Driver.NOBODY
        state = self._state[:, span]
        reach = np.hypot(*self._size_m.T) / 2
        for me in {self._av, self._opponent} - {None}:
            away = np.hypot(*np.moveaxis(state[:, :, :2] - state[me, :, :2], -1, 0))
            near = there & there[me] & (away <= (reach + reach[me])[:, None])
            near[me] = False
            row, at = np.nonzero(near)
            hit = boxes.overlap(
                state[me, at, :2],
                state[me, at, 3],
                self._size_m[me],
                state[row, at, :2],
                state[row, at, 3],
                self._size_m[row],
            )
            hit &= ~clear(state[me, at, 2], state[row, at, 2])
            _, first = np.unique(row[hit], return_index=True)
            found |= {span.start + int(step) for step in at[hit][first]}
        return sorted(found)

    def _look(self, step: int) -> None:
        rows = self._in_frame(step)
        self.judge.look(step, self._frame(step, rows), self._size_m[rows])

    def _in_frame(self, step: int) -> Ints:
        """Rows in the order of the stage's frames: the driven ones last."""
        driver = self._driver[:, step]
        late = (driver == Driver.PLANNER) + 2 * (driver == Driver.POLICY)
        rows = np.flatnonzero(driver != Driver.NOBODY)
        ordered: Ints = rows[np.argsort(late[rows], kind="stable")]
        return ordered

    def _frame(self, step: int, rows: Ints) -> Frame:
        state = self._state[rows, step]
        return Frame(
            ids=[self._tracks.ids[row] for row in rows],
            position_m=state[:, :2],
            z_m=state[:, 2],
            heading_rad=state[:, 3],
            velocity_mps=state[:, 4:],
            driver=self._driver[rows, step],
        )

    def _record(self, last: int) -> None:
        """Record the steps up to ``last``, agents in the order of their appearance."""
        span = slice(self.recorder.step + 1, last + 1)
        there = self._driver[:, span] != Driver.NOBODY
        rows = np.flatnonzero(there.any(axis=1))
        rows = rows[np.argsort(there[rows].argmax(axis=1), kind="stable")]
        ids = [self._tracks.ids[row] for row in rows]
        self.recorder.extend(ids, self._state[rows, span], self._driver[rows, span])

    def _body(self, agent: AgentId) -> Body:
        row = self._tracks.row(agent)
        length, width, height = (float(value) for value in self._tracks.size_m[row])
        return Body(kind=self._tracks.kinds[row], size_m=(length, width, height))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Log:
    """(A, T, 6) x, y, z, heading, vx, vy, zero where nobody is; (A, T) drivers."""

    state: Floats
    driver: Bytes


@lru_cache(maxsize=4)
def _logged(scene: Scene, steps: int) -> _Log:
    """The recording's first steps; nobody is there after its end."""
    tracks = scene.tracks
    parts = (
        tracks.position_m,
        tracks.z_m[..., None],
        tracks.heading_rad[..., None],
        tracks.velocity_mps,
    )
    state = np.where(tracks.valid[..., None], np.concatenate(parts, axis=-1), 0.0)[:, :steps]
    driver = np.where(tracks.valid, int(Driver.LOG), int(Driver.NOBODY))[:, :steps]
    missing = steps - driver.shape[1]
    return _Log(
        state=frozen(np.pad(state, [(0, 0), (0, missing), (0, 0)])),
        driver=frozen(np.pad(driver, [(0, 0), (0, missing)]), np.uint8),
    )


@lru_cache(maxsize=4)
def _signals(signals: Signals, end: int) -> tuple[dict[str, SignalState], ...]:
    """The recorded lights at all steps up to the end, as the stage shows them."""
    last = signals.state.shape[1] - 1
    return tuple(signals.at(min(step, last)) for step in range(end + 1))
