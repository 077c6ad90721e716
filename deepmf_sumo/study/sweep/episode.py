"""One task in a worker: case, attack, metrics, files."""

import functools
import os
import pickle
import shutil
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import numpy as np
import yaml

from deepmf_sumo import files, plugins
from deepmf_sumo.attacks.base import Loading, Several
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.errors import (
    DeepmfError,
    PlannerError,
    ReaderError,
    RunError,
    SpecError,
    UsageError,
    nearest,
)
from deepmf_sumo.exporters import fcd
from deepmf_sumo.exporters import scene as scene_file
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.metrics.av_rules import MONITORS
from deepmf_sumo.planners._checked import blamed
from deepmf_sumo.planners.base import Planner
from deepmf_sumo.results import artifacts, result, signals, stored, turns
from deepmf_sumo.results.result import Result, av_contacts
from deepmf_sumo.results.tracks import FILE as TRACKS
from deepmf_sumo.results.tracks import write_tracks
from deepmf_sumo.scene import (
    DT_S,
    Attack,
    Budget,
    Case,
    Event,
    RecordedCase,
    Rollout,
    Scene,
    SumoNet,
    TrafficCase,
    TurnRules,
    readers,
)
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.scene.readers import RecordRef
from deepmf_sumo.spec import Expect, FromNetwork, FromRecording
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.moments import made_people
from deepmf_sumo.study.sweep import fork, watch
from deepmf_sumo.study.sweep.inputs import Input
from deepmf_sumo.study.sweep.streams import logged, shorten
from deepmf_sumo.sumo import network, simulation
from deepmf_sumo.sumo.simulation import sumo_api


def broken(expect: Expect, result: Result) -> list[str]:
    """A sentence for each expectation that does not hold; a run without a result is not judged."""
    return list(_broken(expect, result)) if result["status"] == "ok" else []


def _broken(expect: Expect, result: Result) -> Iterator[str]:
    outcome, contacts = result["outcome"], av_contacts(result)
    hit = bool(contacts)
    if expect.av_collision is not None and hit != expect.av_collision:
        yield f"av_collision is {_yaml(hit)}, expected {_yaml(expect.av_collision)}"
    if expect.outcome is not None and outcome != expect.outcome:
        yield f"outcome is {outcome}, expected {expect.outcome}"
    most = expect.max_contact_speed_mps
    fastest = max((one["relative_mps"] for one in contacts), default=0.0)
    if most is not None and fastest > most:
        yield f"contact speed is {fastest:.2f} m/s, expected at most {most:g}"
    for name, bound in expect.metrics.items():
        found = result["metrics"].get(name)
        value = found["value"] if found else None
        if value is None:
            yield f"{name} has no value ({found['reason'] if found else 'no such metric'})"
        elif bound.min is not None and value < bound.min:
            yield f"{name} is {value:.4g}, expected at least {bound.min:g}"
        elif bound.max is not None and value > bound.max:
            yield f"{name} is {value:.4g}, expected at most {bound.max:g}"


def _yaml(value: bool) -> str:
    return "true" if value else "false"


_CHANGED: Final = (
    "{} has changed since the sweep began, so this run would not belong to the others; --resume"
    " makes them all with what it is now."
)
Draw = Callable[[Rollout, Case, Path], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskRunner:
    """Does tasks; each leaves a folder ``runs/<run id>``, whole or not at all.

    Attributes:
        runs: the folder of all runs. cache: of converted networks.
        draw: makes ``picture.png``; None makes none.
        scenes: also write the rollout as a recording, ``scene.npz``.
        sumo: also write ``sumo/``, which sumo-gui opens; of networks it is always written, since
            their road is known from it.
        begun: what the runs read, as it was when the sweep began, see `watch`.
    """

    runs: Path
    cache: Path
    draw: Draw | None = None
    gui: bool = False
    scenes: bool = False
    sumo: bool = True
    begun: tuple[Input, ...] = ()

    def __call__(self, task: Task) -> None:
        """Run the task. A run that fails leaves its reason in ``result.json``."""
        begin = time.perf_counter()
        if other := watch.changed(task, self.begun):
            finish(self.runs, task, result.unfinished(task, "failed", _CHANGED.format(other), 0.0))
            return
        try:
            self._do(task)
        except PlannerError as error:  # it ended the process
            wall_s = time.perf_counter() - begin
            ended = result.unfinished(task, "failed", str(error), wall_s, error.kind)
            finish(self.runs, task, ended)

    def _do(self, task: Task) -> None:
        work = self._work_of(task)
        load = functools.partial(_load, task, self.cache)
        if self.gui:
            work.run()
        elif not fork.pass_on(task, self._work_of, load) and not (
            _foreign(task) and fork.apart(load, work.run)
        ):
            with _as_before():
                work.run()

    def _work_of(self, task: Task) -> fork.ForkedWork:
        case = functools.partial(make_case, task, self.cache)
        return fork.ForkedWork(case=case, run=functools.partial(self._run, task))

    def _run(self, task: Task) -> None:
        folder = working_folder(self.runs, task)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        resolved = yaml.safe_dump(task.resolved(), sort_keys=False, allow_unicode=True)
        files.write(folder / stored.SPEC, resolved)
        begin = time.perf_counter()
        with logged(folder / stored.LOG):
            try:
                found = self._attack(task, folder)
            except ReaderError as error:
                found = result.unfinished(task, "skipped", str(error), time.perf_counter() - begin)
            except UsageError as error:
                found = result.unfinished(task, "failed", str(error), time.perf_counter() - begin)
                found["refused"] = True
            except DeepmfError as error:
                if isinstance(error, PlannerError) and error.__cause__:
                    traceback.print_exc()  # where in the planner it was
                fault = error.kind if isinstance(error, PlannerError) else ""
                seconds = time.perf_counter() - begin
                found = result.unfinished(task, "failed", str(error), seconds, fault)
            except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
                traceback.print_exc()
                reason = f"{type(error).__name__}: {error} (see log.txt)"
                found = result.unfinished(task, "failed", reason, time.perf_counter() - begin)
        shorten(folder / stored.LOG)
        finish(self.runs, task, found)

    def _attack(self, task: Task, folder: Path) -> result.Result:
        begin = time.perf_counter()
        _adversary_of(task)  # first, for what is wrong with the weights shows soonest
        made, nobody = _with_people(task, make_case(task, self.cache))
        case, plain = _with_unattacked(task, made)
        attack = attack_case(task, case, gui=self.gui)
        rollout = attack.rollout
        decisive = turns.decisive_part(rollout, case)
        decided = metrics.Episode(*decisive)
        measured = metrics.measured(decided)
        by_turn = turns.judged(rollout, case, metrics.measure)
        write_tracks(folder / TRACKS, rollout)
        artifacts.write_plans(folder / artifacts.PLANS, rollout)
        artifacts.write_unattacked(folder, *decisive)
        signals.write_signals(folder / signals.FILE, rollout, case.road)
        done = Exportable.of(rollout, case)
        if self.sumo or isinstance(task.spec.source, FromNetwork):
            fcd.write(done, folder / "sumo", fcd.Settings())
        if self.scenes:
            scene_file.write(done, folder / "scene.npz", scene_file.Settings())
        if self.draw:
            self.draw(*decisive, folder / "picture.png")
        wall_s = time.perf_counter() - begin
        found = result.finished(task, case, attack, measured, wall_s, by_turn, decided)
        alone = metrics.measure(plain, case, only=MONITORS) if plain else []
        found["plain"] = result.values_of(alone)
        found["events"] = [*map(asdict, nobody), *found["events"]]
        wrong = result.not_finite(found)
        if wrong:
            raise RunError(f"{wrong} is not a finite number; the run is not used.")
        return found


def _foreign(task: Task) -> bool:
    """Whether planner or adversary are not of this package."""
    choices: tuple[tuple[plugins.Kind, str], ...] = (
        ("planners", task.spec.planner.name),
        ("adversaries", task.spec.adversary.name),
    )
    return not all(plugins.own(kind, name) for kind, name in choices)


def _load(task: Task, cache: Path) -> None:
    """What the runs that follow need, too, and the code of others, which may import a lot."""
    plugins.load("planners", task.spec.planner.name)
    sumo_api.load()
    case = make_case(task, cache)
    if plugins.own("adversaries", task.spec.adversary.name):
        adversary = _adversary_of(task)
        if isinstance(adversary, Loading):
            adversary.load()
            road_index(case.road)  # predictors need it: seconds on the network of a town


@contextmanager
def _as_before() -> Iterator[None]:
    """What a planner changes of the process's folder and environment does not stay."""
    folder, environment = Path.cwd(), dict(os.environ)
    try:
        yield
    finally:
        os.chdir(folder)
        if dict(os.environ) != environment:
            os.environ.clear()
            os.environ.update(environment)


def make_case(task: Task, cache: Path) -> Case:
    """The situation of a task. Raises ReaderError, ConversionError or SimulationError."""
    case = _situation(task, cache)
    return replace(case, in_sight=True) if task.spec.av_sees == "in_sight" else case


def _situation(task: Task, cache: Path) -> Case:
    spec, source = task.spec, task.spec.source
    steps = round(spec.duration_s / DT_S)
    if isinstance(source, FromNetwork):
        case = simulation.network_case(
            source.network,
            source.start_s,
            source.av.vehicle,
            steps,
            spec.seed,
            source.sumo_options,
        )
        in_turn = spec.opponents == "in_turn"
        return replace(
            case,
            name=task.run_id,
            turns=TurnRules(**spec.turns.model_dump()) if in_turn else None,
            only=source.only,
            own_people=source.people.own,
        )
    assert task.record is not None, "the plan finds the scenes of recordings"
    scene, net = _recorded(task.record, cache)
    if isinstance(source, FromRecording):
        scene = _part_of(scene, source)
    return RecordedCase(
        name=task.run_id,
        road=scene.road,
        av_id=scene.av_id,
        duration_steps=steps,
        traffic=spec.traffic,
        seed=spec.seed,
        scene=scene,
        net=net,
        partner_id=scene.partner_id,
        av_driver=getattr(plugins.load("planners", spec.planner.name), "DRIVER", "planner"),
        only=source.only,
    )


def _part_of(scene: Scene, source: FromRecording) -> Scene:
    """The scene from the source's start on, with its road users alone.

    Raises SpecError where the AV is not there at the start, or a road user never is.
    """
    steps = round(source.start_s / DT_S)
    here = f"{source.recording}, scene '{scene.name}'"
    if steps:
        tracks, at = scene.tracks, scene.now + steps
        there = at < tracks.steps and bool(tracks.valid[tracks.row(scene.av_id), at])
        if not there:
            raise SpecError(
                f"key 'source.start_s': {source.start_s:.12g}: the AV '{scene.av_id}' is not there"
                f" at that time ({here}); choose an earlier start."
            )
        scene = scene.later(steps)
    if source.only is None:
        return scene
    for agent in source.only:
        if agent not in scene.tracks.ids:
            hint = nearest(agent, scene.tracks.ids)
            raise SpecError(f"key 'source.only': '{agent}' is not in {here}.{hint}")
    return scene.of_agents(source.only)


@functools.lru_cache(maxsize=4)
def _recorded(record: RecordRef, cache: Path) -> tuple[Scene, SumoNet]:
    """Kept between tasks: the methods of a benchmark follow one another on a scene."""
    scene = readers.read(record)
    return scene, network.cached(scene, cache / "nets")


def _with_people(task: Task, case: Case) -> tuple[Case, tuple[Event, ...]]:
    """The case with the made people that its spec asks for, and where nobody could be made.

    They are drawn around the AV's way in the traffic as SUMO drives it, whatever the planner: so
    all methods and planners of a scene have the same.
    """
    source = task.spec.source
    if not isinstance(source, FromNetwork) or not source.people.made:
        return case, ()
    assert isinstance(case, TrafficCase)
    rollout = fork.tried(task, functools.partial(simulation.plain, case), case)
    rng = np.random.default_rng([*task.entropy(), crc32(b"people")])
    drawn = made_people.drawn(case, source.people, rollout, rng)
    nobody = (
        Event(step=rollout.now, agent_id=place, kind="nobody_made", detail=why)
        for place, why in drawn.nobody
    )
    return replace(case, made=drawn.made), tuple(nobody)


def _with_unattacked(task: Task, case: Case) -> tuple[Case, Rollout | None]:
    """The case with its episode without attack, with which all attacks of the run are compared.

    And that episode, in which the AV keeps or breaks rules, too; None where there is none.

    Simulated once a run, whatever the number of episodes of a search, and only where the traffic
    reacts: a log stays what it is. It comes first: SUMO is at the moment, and the copy that
    simulates it leaves it there.
    """
    logged = isinstance(case, RecordedCase) and case.traffic == "log"
    if logged or task.spec.adversary.name == "none":
        return case, None
    rollout = fork.tried(task, functools.partial(_simulated, task, case, None), case)
    return replace(case, unattacked=rollout.tracks), rollout


def _simulated(
    task: Task,
    case: Case,
    policy: Policy | None,
    planner: Planner | None = None,
    *,
    gui: bool = False,
) -> Rollout:
    """An episode; each of a run begins with the same random numbers."""
    driver = planner or planner_of(task)
    rng = np.random.default_rng([*task.entropy(), 1])
    rollout = simulation.simulate(case, driver, policy, rng=rng, gui=gui)
    fork.note_model(task, driver.model)
    return rollout


def _keeping(
    task: Task, case: Case, policy: Policy | None, kept: tuple[str, ...]
) -> tuple[Rollout, list[Any]]:
    """An episode, and what the policy keeps of it, by name."""
    rollout = _simulated(task, case, policy)
    return rollout, [getattr(policy, name) for name in kept]


def attack_case(
    task: Task, case: Case, *, gui: bool = False, planner: Planner | None = None
) -> Attack:
    """The adversary's attack.

    ``planner`` drives the AV; without it a new one as the spec says does in every episode.
    """

    def simulate(policy: Policy | None) -> Rollout:
        return _simulated(task, case, policy, planner, gui=gui)

    def one_of_several(policy: Policy | None) -> Rollout:
        assert isinstance(case, TrafficCase)
        kept: tuple[str, ...] = getattr(policy, "KEPT", ())
        episode = functools.partial(_keeping, task, case, policy, kept)
        rollout, values = fork.tried(task, episode, case)
        for name, value in zip(kept, values, strict=True):
            setattr(policy, name, value)
        return rollout

    rng = np.random.default_rng(task.entropy())
    spent = task.spec.budget
    budget = Budget(simulations=spent.simulations, seconds=spent.seconds)
    adversary = _adversary_of(task)
    alone = planner is not None or gui or not isinstance(case, TrafficCase)
    several = not alone and isinstance(adversary, Several) and adversary.several
    with fork.tries() if several else nullcontext():
        attack: Attack = adversary.attack(
            case, one_of_several if several else simulate, budget, rng
        )
    return attack


def planner_of(task: Task) -> Planner:
    """A new planner as the spec says."""
    choice = task.spec.planner
    settings = plugins.settings("planners", choice.name, choice.settings)
    with blamed():
        planner: Planner = plugins.load("planners", choice.name).build(settings)
    return planner


def _adversary_of(task: Task) -> Any:
    choice = task.spec.adversary
    settings = pickle.dumps(choice.settings)  # JSON has no dates and no sets; YAML takes long
    return _adversary(choice.name, settings, task.spec.weights)


@functools.lru_cache(maxsize=64)
def _adversary(name: str, settings: bytes, weights: str) -> Any:
    """Kept between tasks: loading its weights takes longer than an episode."""
    given = pickle.loads(settings)  # noqa: S301 - `_adversary_of` wrote it
    checked = plugins.settings("adversaries", name, given)
    return plugins.load("adversaries", name).build(checked, weights)


def working_folder(runs: Path, task: Task) -> Path:
    """Where a run's files lie until it is finished."""
    return runs / f".{task.run_id}.partial"


def finish(runs: Path, task: Task, found: result.Result) -> None:
    """Write ``result.json`` and put the folder in its place."""
    folder, place = working_folder(runs, task), runs / task.run_id
    folder.mkdir(parents=True, exist_ok=True)
    found["expectations_broken"] = broken(task.spec.expect, found)
    files.write_json(folder / stored.RESULT, found)
    if place.exists():
        shutil.rmtree(place)
    folder.rename(place)
