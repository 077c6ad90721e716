"""An episode in which only the attackers do something new: it needs no SUMO.

Where the traffic replays the log and the AV does the same whatever happens (`FixedPlanner`), SUMO
would only move vehicles along known poses. The episode is put together here, all steps up to the
next plan in one go, with the beginning, recorder, schedule and contacts of every episode: its
rollout is that of the loop over SUMO, without the events that tell where SUMO has the AV. In that
loop it would take several times as long (studies/notebook/cost.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from deepmf_sumo.planners.base import FixedPlanner
from deepmf_sumo.scene import (
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
    frozen,
)
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose, states
from deepmf_sumo.sumo.simulation.log_plan import check_route, recorded_body
from deepmf_sumo.sumo.simulation.ownership import LogOwner, NextOwner
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord, timed


def run(
    case: RecordedCase, planner: FixedPlanner, policy: Policy | None, rng: np.random.Generator
) -> Rollout:
    """The episode. Raises SimulationError as the loop over SUMO does."""
    check_route(case)
    world = _LogOnly(case, planner.fixed_poses(case.duration_steps))
    seconds = dict.fromkeys(("planner", "policy", "simulation"), 0.0)
    with timed(seconds, "policy"):
        record = EpisodeRecord.begun(case, world, policy, rng)
    hit = False
    while record.step < record.end and not hit:
        with timed(seconds, "policy"):
            record.frame = world.frame(record.step)
            record.replan()
        with timed(seconds, "simulation"):
            hit = _advance(world, record)
    return record.rollout(
        "contact" if hit else "time",
        seconds=seconds,
        leaders=(None,) * (record.step - record.now),
        signals=world.lights[record.now : record.step],
    )


def _advance(world: "_LogOnly", record: EpisodeRecord) -> bool:
    """All steps up to the next plan or to the contact that ends the episode; whether one does."""
    first, schedule, finder = record.step + 1, record.schedule, record.contact_finder
    stop = next((step for step in range(first, record.end) if schedule.due(step)), record.end)
    poses = {step: schedule.advance(step) for step in range(first, stop + 1)}
    driven = schedule.attackers + schedule.supporters
    for agent in driven:
        own = {step: placed[agent] for step, placed in poses.items()}
        world.drive(agent, {step: pose for step, pose in own.items() if pose is not None})
    begins, looked = world.new_overlaps(driven, first, stop + 1), -1
    several = len(schedule.attackers) > 1
    for step in range(first, stop + 1):
        # a pair that overlaps without a contact is judged at each step, for it may come apart
        if step not in begins and not finder.excuses and not several:
            continue
        for look in (step,) if looked == step - 1 else (step - 1, step):
            frame = world.frame(look)
            size_m = world.sizes_m(frame.ids)
            finder.look(look, frame, size_m)
        looked = step
        if schedule.after_step(step, frame, size_m, finder.hits(step)):
            stop = step
            break
    record.recorder.extend(*world.states(first, stop + 1))
    world.step = stop
    return bool(finder.hits(stop))


class _LogOnly:
    """The log, with the AV on its poses, and attackers and supporters on those that they are given.

    Args:
        case: with a recording.
        av_poses: (K, 4) x, y, heading, speed of the AV after now.

    Attributes:
        step: the last one that is over.
        lights: the recorded ones at each step up to the end.
    """

    def __init__(self, case: RecordedCase, av_poses: Floats) -> None:
        scene = case.scene
        self.step = scene.now
        end = scene.now + case.duration_steps
        self.lights = _signals(scene.signals, end)
        self.next_owner: NextOwner = LogOwner(scene.tracks)
        self._tracks = scene.tracks
        self._size_m = scene.tracks.size_m[:, :2]
        self._av = scene.tracks.row(case.av_id)
        log = _logged(scene, end + 1)
        self._state, self._driver = log.state.copy(), log.driver.copy()
        self._ground = ground_of(case.road)
        after = np.arange(len(av_poses)) + self.step + 1
        poses = [
            Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=speed)
            for x, y, heading, speed in av_poses.tolist()
        ]
        self._drive(self._av, after, states(poses), Driver.PLANNER)

    def history(self) -> list[Frame]:
        """The frames up to now."""
        return [self.frame(step) for step in range(self.step + 1)]

    def signals(self) -> dict[str, SignalState]:
        """The recorded lights after the last step."""
        return self.lights[self.step]

    def drive(self, agent: AgentId, poses: dict[int, Pose]) -> None:
        """Put an attacker or a supporter on poses, by step."""
        if poses:
            given = states(list(poses.values()))
            self._drive(self._tracks.row(agent), np.array(list(poses)), given, Driver.POLICY)

    def frame(self, step: int) -> Frame:
        """The agents present at a step, in the order of SUMO's worlds: the driven ones last."""
        driver = self._driver[:, step]
        late = (driver == Driver.PLANNER) + 2 * (driver == Driver.POLICY)
        rows = np.flatnonzero(driver != Driver.NOBODY)
        rows = rows[np.argsort(late[rows], kind="stable")]
        state = self._state[rows, step]
        return Frame(
            ids=[self._tracks.ids[row] for row in rows],
            position_m=state[:, :2],
            z_m=state[:, 2],
            heading_rad=state[:, 3],
            velocity_mps=state[:, 4:],
            driver=driver[rows],
        )

    def states(self, first: int, stop: int) -> tuple[list[AgentId], Floats, Bytes]:
        """Ids, states and drivers of the steps before ``stop``, for `Recorder.extend`."""
        span = slice(first, stop)
        there = self._driver[:, span] != Driver.NOBODY
        rows = np.flatnonzero(there.any(axis=1))
        rows = rows[np.argsort(there[rows].argmax(axis=1), kind="stable")]
        ids = [self._tracks.ids[row] for row in rows]
        return ids, self._state[rows, span], self._driver[rows, span]

    def sizes_m(self, ids: list[AgentId]) -> Floats:
        """(N, 2) length and width of agents, also of those that appear after the recorded step."""
        return self._size_m[[self._tracks.row(agent) for agent in ids]]

    def body(self, agent: AgentId) -> Body:
        """Kind and size as recorded."""
        return recorded_body(self._tracks, self._tracks.row(agent))

    def new_overlaps(self, driven: Sequence[AgentId], first: int, stop: int) -> set[int]:
        """Steps before ``stop`` at which the AV or one of ``driven`` begins to overlap another."""
        found: set[int] = set()
        span = slice(first - 1, stop)
        there = self._driver[:, span] != Driver.NOBODY
        state = self._state[:, span]
        reach = np.hypot(*self._size_m.T) / 2
        for me in (self._av, *map(self._tracks.row, driven)):
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
            overlap = np.zeros(there.shape, bool)
            overlap[row[hit], at[hit]] = True
            begins = overlap[:, 1:] & ~overlap[:, :-1]
            found |= {first + int(step) for step in np.flatnonzero(begins.any(axis=0))}
        return found

    def _drive(self, row: int, steps: Ints, given: Floats, driver: Driver) -> None:
        """Put an agent into states (K, 6) at steps (K); heights follow the ground."""
        state = self._state[row]
        before = int(steps[0]) - 1
        way = np.concatenate([state[before : before + 1, :2], given[:, :2]])
        z_m = self._ground.follow(way[None], state[before : before + 1, 2])[0, 1:]
        state[steps] = given
        state[steps, 2] = z_m
        self._driver[row, steps] = driver


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Log:
    """(A, T, 6) x, y, z, heading, vx, vy, zero where an agent is absent; (A, T) drivers."""

    state: Floats
    driver: Bytes


@lru_cache(maxsize=4)
def _logged(scene: Scene, steps: int) -> _Log:
    """The first steps of the recording; all agents are absent after its end."""
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
    """The recorded lights at all steps up to the end, as `ReplayedSignals` has them."""
    return tuple(signals.at(step) for step in range(end + 1))
