"""A Gymnasium environment: its actions drive the AV, which is attacked as a spec defines.

::

    env = AttackEnv("scenarios/left_turn_across_path.yaml")
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(action)

or, by its id, ``gymnasium.make("deepmf_sumo.gym:deepmf_sumo/Attack-v0", spec=...)``.

Needs the extra `gym`. SUMO runs one simulation per process: for several environments at a time use
``gymnasium.vector.AsyncVectorEnv``, which starts a process for each.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import spec as specs
from deepmf_sumo.errors import PluginError, UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.judge import ladder
from deepmf_sumo.judge.metrics import Episode, NotMeasurable
from deepmf_sumo.planners._stepped import Ended, SteppedEpisode
from deepmf_sumo.scene import DT_S, Attack, Case, Command, Floats, Rollout, View
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.geometry.ground import off_level
from deepmf_sumo.scene.scene import HISTORY_STEPS
from deepmf_sumo.spec import Spec, profiles, tasks
from deepmf_sumo.study.sweep import episode
from deepmf_sumo.sumo.simulation.in_sight import InSight

try:
    _gymnasium: Any = importlib.import_module("gymnasium")
except ImportError:
    raise PluginError(
        "The environment needs Gymnasium, which is not installed; install deepmf-sumo[gym]."
    ) from None
_Env: Any = _gymnasium.Env

Array = NDArray[np.float32]

PATH_POINTS: Final = 20
PATH_SPACING_M: Final = 5.0
ID: Final = "deepmf_sumo/Attack-v0"
"""Under which Gymnasium knows the environment once this module is imported."""
BRAKE_MPS2: Final = -8.0
ACCEL_MPS2: Final = 4.0
_EQUAL_S: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Reward:
    """What a step is worth: ``progress * metres - comfort * (m/s2)^2 * s``, less at a contact.

    Attributes:
        progress: for each metre driven.
        comfort: for each second at an acceleration of 1 m/s2, growing with its square.
        contact: taken away at the end of an episode in which the AV touched another vehicle.
        findings_only: of the opponent's hits only findings count (`judge.ladder`), so that
            unavoidable and contrived hits teach nothing.

    Raises UsageError for a number that is not finite.
    """

    progress: float = 0.01
    comfort: float = 0.005
    contact: float = 1.0
    findings_only: bool = False

    def __post_init__(self) -> None:
        for name in ("progress", "comfort", "contact"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and np.isfinite(value)):
                raise UsageError(f"reward has {name} {value!r:.80}; it must be a finite number.")

    def of_step(self, before: View, after: View) -> float:
        """Of the AV's motion from one view to the next."""
        (old, old_speed), (new, new_speed) = _motion(before), _motion(after)
        seconds = after.dt_s
        accel = (new_speed - old_speed) / seconds
        return float(self.progress * np.hypot(*(new - old)) - self.comfort * accel**2 * seconds)

    def of_end(self, rollout: Rollout, case: Case) -> float:
        """Of a contact of the AV; 0 without one."""
        if not any(contact.kind.startswith("av_") for contact in rollout.contacts):
            return 0.0
        return 0.0 if self.findings_only and not _counts(rollout, case) else -self.contact


def _counts(rollout: Rollout, case: Case) -> bool:
    """Also where that cannot be judged, e.g. a contact with another vehicle than the opponent."""
    try:
        verdict = ladder.verdict(Episode(rollout, case))
    except NotMeasurable:
        return True
    return verdict is None or verdict.finding


def _motion(view: View) -> tuple[Floats, float]:
    """The AV's position (2) and speed."""
    tracks = view.history
    row = tracks.row(view.av_id)
    return tracks.position_m[row, -1], float(np.hypot(*tracks.velocity_mps[row, -1]))


class ObservationBuilder:
    """Arrays of a view.

    ``av``: (3) speed, length, width. ``agents``: (N, 8) the nearest first: 1, x, y, heading, vx,
    vy, length, width; the rest are rows of zeros. Vehicles on a bridge above or a road below
    are left out. ``path``: (20, 3) every 5 m ahead along the AV's
    route: 1, x, y; rows of zeros beyond its end. Metres, m/s, radians; x ahead, y left.

    Args:
        agents: N.
    """

    def __init__(self, agents: int) -> None:
        self.shapes = {"av": (3,), "agents": (agents, 8), "path": (PATH_POINTS, 3)}

    def observe(self, view: View) -> dict[str, Array]:
        """float32 arrays of `shapes`."""
        tracks = view.history
        me = tracks.row(view.av_id)
        origin, heading = tracks.position_m[me, -1], float(tracks.heading_rad[me, -1])
        length, width = tracks.size_m[me, :2]
        found = {
            "av": np.array([tracks.speed_mps[me, -1], length, width]),
            "agents": self._agents(view, me, origin, heading),
            "path": _path(view, origin, heading),
        }
        return {
            name: _filled(np.asarray(found[name]), shape) for name, shape in self.shapes.items()
        }

    def last_view(self, rollout: Rollout, case: Case) -> View:
        """The view at the AV's last step, without a path: no planner gets this view."""
        tracks = rollout.tracks
        step = int(np.flatnonzero(tracks.valid[tracks.row(rollout.av_id)])[-1])
        view = View(
            step=step,
            dt_s=rollout.dt_s,
            av_id=rollout.av_id,
            history=tracks.window(max(0, step + 1 - HISTORY_STEPS), step + 1),
            road=case.road,
            signals=rollout.signals[-1],
            steps_left=rollout.now + case.duration_steps - step,
        )
        shown = (InSight().limited(view) if case.in_sight else view).history
        there = np.flatnonzero(shown.valid[:, -1]).tolist()
        return replace(view, history=shown.select(there))

    def _agents(self, view: View, me: int, origin: Floats, heading: float) -> Floats:
        tracks = view.history
        local = frames.to_local(tracks.position_m[:, -1], origin, heading)
        velocity = frames.to_local(tracks.velocity_mps[:, -1], np.zeros(2), heading)
        turned = frames.wrap(tracks.heading_rad[:, -1] - heading)
        table = np.column_stack(
            [np.ones(len(local)), local, turned, velocity, tracks.size_m[:, :2]]
        )
        away = np.hypot(*local.T)
        now_m, z_m = tracks.position_m[:, -1], tracks.z_m[:, -1]
        over = off_level(view.road, origin, float(z_m[me]), now_m, z_m)
        away[over] = away[me] = np.inf
        nearest: Floats = table[np.argsort(away, kind="stable")[: np.isfinite(away).sum()]]
        return nearest


def _path(view: View, origin: Floats, heading: float) -> Floats:
    """(K, 3) points along the AV's route; none if it is not on a lane."""
    if view.av_path_m is None:
        return np.zeros((0, 3))
    length = polylines.arc_lengths(view.av_path_m)[-1]
    if length < PATH_SPACING_M:
        return np.zeros((0, 3))
    count = min(PATH_POINTS, int(length / PATH_SPACING_M))
    along = PATH_SPACING_M * np.arange(1.0, count + 1.0)
    points, _ = polylines.points_at(view.av_path_m, along)
    return np.column_stack([np.ones(len(along)), frames.to_local(points, origin, heading)])


def _filled(table: Floats, shape: tuple[int, ...]) -> Array:
    """The table as float32 of a shape, cut or filled with zeros."""
    array = np.zeros(shape, np.float32)
    kept = table[: shape[0]]
    array[: len(kept)] = kept
    return array


_running: "AttackEnv | None" = None
"""The environment of this process that is in an episode: SUMO runs one simulation per process."""


class AttackEnv(_Env):  # type: ignore[misc]
    """Episodes of a spec, one after another over its scenes.

    The action is an acceleration along the route, (1) in m/s2 within [-8, 4], or any
    `scene.Command` of a planner. The spec's planner does not drive; SUMO's model has its
    parameters when a command leaves the AV to SUMO.

    The observation is in the AV's frame, see `ObservationBuilder`. ``info`` has ``run_id`` and
    ``step``, at the end also ``outcome``, ``ended`` and ``opponent`` as in ``result.json``.

    Terminated: contact, or the AV arrived; truncated: the time limit was reached.

    Args:
        spec: a spec, or its file. Each attack has one episode, whatever the spec's ``tries``.
        agents: number of the nearest agents that are observed.
        reward: see `Reward`; a mapping has its keys.
        step_s: seconds of a step, a multiple of 0.1: an acceleration, or a command, is repeated in
            each 0.1 s of it. Attacks and SUMO keep their steps of 0.1 s.
        render_mode: ``rgb_array``: `render` gives a picture of what is around the AV.

    Attributes:
        view: what a planner sees now. case: what is simulated.
        attack: the last finished episode, including what drove the AV at each step.

    An environment that starts an episode ends the episode of another in the same process.

    Raises SpecError for an invalid spec, UsageError for a spec whose adversary simulates an
    attack several times.
    """

    metadata: Mapping[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        spec: Spec | Path | str,
        *,
        agents: int = 16,
        reward: Reward | Mapping[str, Any] = Reward(),
        step_s: float = DT_S,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise UsageError(f"render_mode is {render_mode!r}; it can be 'rgb_array' or None.")
        self.render_mode = render_mode
        self._repeats = _repeats(step_s)
        self.metadata = {**self.metadata, "render_fps": 10 / self._repeats}
        self._reward = reward if isinstance(reward, Reward) else _reward(reward)
        self._spec = _in_one_try(spec if isinstance(spec, Spec) else specs.load(Path(spec)))
        self._tasks = tasks.plan([self._spec], cache_folder())
        self._observer = ObservationBuilder(agents)
        self._next = 0
        self._seeded = False
        self._stepped: SteppedEpisode | None = None
        self._taken = False
        self._run_id = ""
        self.case: Case | None = None
        self.view: View | None = None
        self.attack: Attack | None = None
        spaces = _gymnasium.spaces
        self.action_space = spaces.Box(BRAKE_MPS2, ACCEL_MPS2, (1,), np.float32)
        self.observation_space = spaces.Dict(
            {
                name: spaces.Box(-np.inf, np.inf, shape, np.float32)
                for name, shape in self._observer.shapes.items()
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start the next scene, or ``options={"scene": id}``.

        ``seed`` is the run's; by default the spec's for the first episode, then a random one.
        """
        self.close()
        if seed is None and not self._seeded:
            seed = self._spec.seed
        super().reset(seed=seed)
        self._seeded = True
        number = int(self.np_random.integers(2**31)) if seed is None else seed
        task = self._task((options or {}).get("scene"))
        task = replace(task, spec=task.spec.model_copy(update={"seed": number}))
        self._run_id = task.run_id
        _refuse_made(task.spec)
        self.case = episode.make_case(task, cache_folder())
        self.view = self._begin(task, self.case)
        return self._observer.observe(self.view), self._info(self.view)

    def step(
        self, action: Floats | Command
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Drive the AV for ``step_s``, or until the episode ends."""
        if self._stepped is None or self.view is None or self.case is None:
            raise UsageError(_TAKEN if self._taken else "No episode is running: call reset first.")
        reward = 0.0
        for _ in range(self._repeats):
            before, came = self.view, self._driven(self._stepped, self.view, action)
            if not isinstance(came, View):
                self._release()
                self.attack = came.result
                return self._last_step(before, came.result.rollout, self.case, reward)
            self.view = came
            reward += self._reward.of_step(before, came)
        return self._observer.observe(self.view), reward, False, False, self._info(self.view)

    def _driven(
        self, stepped: SteppedEpisode, view: View, action: Floats | Command
    ) -> View | Ended:
        """What comes after 0.1 s."""
        command = action if isinstance(action, Command) else _accelerated(view, action)
        try:
            return stepped.next(command)
        except BaseException:  # an error of the simulation, or an interrupt
            self.close()
            raise

    def render(self) -> NDArray[np.uint8] | None:
        """(480, 480, 3) picture of the road and the vehicles around the AV; x to the right.

        None before the first episode, or without a ``render_mode``.
        """
        if self.render_mode is None or self.view is None:
            return None
        from deepmf_sumo.report.picture import frame  # brings matplotlib along

        return frame(self.view)

    def close(self) -> None:
        """End the episode and SUMO, if one is running."""
        if self._stepped is not None:
            self._stepped.leave()
            self._release()

    def _begin(self, task: tasks.Task, case: Case) -> View:
        global _running
        model = episode.planner_of(task).model
        if (other := _running) is not None:
            other.close()
            other._taken = True  # noqa: SLF001 - of the same class
        _running, self._taken = self, False
        self._stepped = SteppedEpisode(
            lambda me: episode.attack_case(task, case, planner=me), model
        )
        try:
            came = self._stepped.next()
        except BaseException:
            self.close()
            raise
        if isinstance(came, Ended):
            self.close()
            raise UsageError(f"Run '{task.run_id}' ended before its first step.")
        return came

    def _release(self) -> None:
        global _running  # noqa: PLW0603 - one SUMO a process
        self._stepped = _running = None

    def _task(self, scene: str | None) -> tasks.Task:
        if scene is None:
            task = self._tasks[self._next % len(self._tasks)]
            self._next += 1
            return task
        for task in self._tasks:
            if task.scene == scene:
                return task
        known = ", ".join(task.scene for task in self._tasks[:8])
        raise UsageError(f"The spec has no scene '{scene}'; e.g. {known}.")

    def _last_step(
        self, before: View, rollout: Rollout, case: Case, reward: float
    ) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        self.view = self._observer.last_view(rollout, case)
        late = rollout.ended == "time"
        info = {**self._info(self.view), "outcome": rollout.outcome, "ended": rollout.ended}
        info["opponent"] = rollout.opponent_id
        reward += self._reward.of_step(before, self.view) + self._reward.of_end(rollout, case)
        return self._observer.observe(self.view), reward, not late, late, info

    def _info(self, view: View) -> dict[str, Any]:
        return {"run_id": self._run_id, "step": view.step}


def _repeats(step_s: float) -> int:
    """Number of steps of 0.1 s in a step of the environment. Raises UsageError unless whole."""
    try:
        count = round(step_s / DT_S)
    except (TypeError, ValueError, OverflowError):  # no number, nan, inf
        count = 0
    if count < 1 or abs(count * DT_S - step_s) > _EQUAL_S:
        raise UsageError(f"step_s is {step_s!r}; it must be a multiple of 0.1 s.")
    return count


def _reward(values: Mapping[str, Any]) -> Reward:
    try:
        return Reward(**values)
    except TypeError:
        known = ", ".join(Reward.__dataclass_fields__)
        raise UsageError(f"reward has keys {', '.join(values)}; it can have {known}.") from None


_TAKEN: Final = (
    "No episode is running: another environment of this process has begun one, and SUMO runs one"
    " simulation per process; use gymnasium.vector.AsyncVectorEnv for several at a time."
)


def _in_one_try(spec: Spec) -> Spec:
    """The spec with one episode for an attack, since the AV's driver learns between episodes."""
    choice = spec.adversary
    if not profiles.applies_to(choice.name):
        return spec
    settings = profiles.in_one_try(choice.settings)
    once = type(choice).model_validate({"name": choice.name, **settings})
    return spec.model_copy(update={"adversary": once})


def _accelerated(view: View, action: Floats) -> Command:
    """The command for the speed after a step at an acceleration."""
    row = view.history.row(view.av_id)
    speed = float(view.history.speed_mps[row, -1])
    try:
        given = np.asarray(action, float).reshape(-1)
    except (TypeError, ValueError):  # text, None, rows of unequal lengths
        given = np.empty(0)
    if len(given) != 1 or not np.isfinite(given).all():
        raise UsageError(
            f"The action is {action!r:.80}; it must be one finite acceleration in m/s2. A"
            " network that diverged gives nan."
        )
    wish = float(given[0])
    accel = min(max(wish, BRAKE_MPS2), ACCEL_MPS2)
    return Command(kind="speed", speed_mps=max(0.0, speed + accel * view.dt_s))


if ID not in _gymnasium.registry:
    _gymnasium.register(ID, entry_point="deepmf_sumo.gym:AttackEnv")


def _refuse_made(spec: Spec) -> None:
    """People are drawn in an episode of their own, for which this process has no SUMO to spare."""
    source = spec.source
    if isinstance(source, specs.FromNetwork) and source.people.made:
        raise UsageError(
            f"spec '{spec.name}': key 'source.people': made people are for `deepmf-sumo run` and"
            " `attack`; leave it out here."
        )
