"""Traffic of SUMO configurations as scenes: of one, and of many networks in a task each.

Networks are given, or generated; each gets a folder of scenes.
"""

import json
import shutil
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.errors import OutputError, SimulationError, UsageError
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, HISTORY_STEPS, Lane, RoadMap, Scene
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.study.sweep import workers
from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.sumo.simulation import sumo_words
from deepmf_sumo.sumo.simulation.observation import LiveSignals
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.sumo.simulation.sumo_api import STEP_OPTIONS, SumoApi, running, sumo_seed
from deepmf_sumo.sumo.simulation.sumo_config import Configuration, read_configuration
from deepmf_sumo.sumo.simulation.sumo_outputs import confined
from deepmf_sumo.training import generated
from deepmf_sumo.training.recording.driver_population import DriverMix
from deepmf_sumo.training.recording.scenes import Recording, Scenes, TrafficState


def record(recording: Recording) -> Iterator[Scene]:
    """Scenes of 91 steps of a SUMO configuration's traffic, in the order of time.

    Lateral motion is continuous (sublane model). Moments without a vehicle that could be the AV
    (present at all steps, moving, with others around) give no scene.

    Raises SimulationError if the configuration cannot be run.
    """
    configuration = read_configuration(recording.config)
    if recording.every_s < DT_S:
        raise SimulationError(f"every_s is {recording.every_s}; it must be at least {DT_S} s.")
    road = road_of_net(configuration.net, configuration.additional)
    rng = np.random.default_rng(recording.seed)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        mix = DriverMix(Path(folder) / "drivers.add.xml", rng) if recording.diverse else None
        arguments = [*_arguments(configuration, recording, mix), *sumo_words.to_file(Path(folder))]
        with running(confined(arguments, Path(folder)), folder=Path(folder)) as api:
            yield from _scenes(api, recording, configuration, road, mix, rng)


def _arguments(
    configuration: Configuration, recording: Recording, mix: DriverMix | None
) -> list[str]:
    additional = [str(path) for path in configuration.additional]
    additional += [str(mix.file)] if mix else []
    return [
        *("-c", str(configuration.file)),
        *(("--additional-files", ",".join(additional)) if additional else ()),
        *("--seed", str(sumo_seed(recording.seed))),
        *("--lateral-resolution", "0.4"),
        *("--lanechange.duration", "0"),  # SUMO takes only one of the two
        *STEP_OPTIONS,
    ]


def _scenes(
    api: SumoApi,
    recording: Recording,
    configuration: Configuration,
    road: RoadMap,
    mix: DriverMix | None,
    rng: np.random.Generator,
) -> Iterator[Scene]:
    if mix is not None:
        slow_down(api, road)
    reader = TrafficReader(api)
    links = signal_links(configuration.net)
    lights = LiveSignals(api, links)
    scenes = Scenes(recording, road, links)
    window: deque[TrafficState] = deque(maxlen=_STEPS)
    stride = round(recording.every_s / DT_S)
    begin = round(recording.start_s / DT_S)
    step = round(api.simulation.getTime() / DT_S)
    while step < round(recording.stop_s / DT_S):
        api.simulationStep()
        step += 1
        if mix is not None:
            mix.assign(api)
        if step < begin:
            continue
        since = (step - begin + 1 - _STEPS) % stride
        if -since % stride < _STEPS:  # other steps are not part of any scene
            window.append(TrafficState(states=reader.states(), signals=lights.states()))
        if len(window) == _STEPS and since == 0:
            yield from scenes.of(list(window), reader.body, step * DT_S - 9.0, rng)
        if api.simulation.getMinExpectedNumber() == 0:
            break


def slow_down(api: SumoApi, road: RoadMap) -> None:
    """Lower the speed limit of each lane with bends to a comfortable speed."""
    for lane in road.lanes.values():
        speed = _comfortable(lane)
        # a straight lane may be one that SUMO does not have
        if np.isfinite(speed) and speed < api.lane.getMaxSpeed(lane.id):
            api.lane.setMaxSpeed(lane.id, speed)


def _comfortable(lane: Lane) -> float:
    """Speed at which the lane's tightest bend takes the comfortable lateral acceleration."""
    step = np.diff(polylines.resample(lane.centre_m, _SPACING_M), axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    if abs(float(frames.difference(heading[-1], heading[0]))) < _CURVE_RAD and lane.interpolating:
        return np.inf
    spacing_m = float(np.hypot(step[:, 0], step[:, 1]).mean())
    over = min(round(_WINDOW_M / _SPACING_M), len(heading) - 1)
    if over < 1:
        return np.inf
    turned = float(np.abs(frames.difference(heading[over:], heading[:-over])).max())
    radius_m = over * spacing_m / max(turned, 1e-6)
    return max(_SLOWEST_MPS, float(np.sqrt(COMFORTABLE_MPS2 * radius_m)))


MANIFEST: Final = ".record.json"
"""Hidden, so that it is not taken for a scene."""
_START_LIMIT_S: Final = 180.0
_SCENE_LIMIT_S: Final = 10.0
__all__ = ["Recording", "record"]

_STEPS: Final = HISTORY_STEPS + FUTURE_STEPS
COMFORTABLE_MPS2: Final = 3.0
"""Lateral acceleration at the tightest bend of a lane; the median over whole turns is then 1.9, as
in recordings."""
_SLOWEST_MPS: Final = 3.0
_SPACING_M: Final = 2.0
_WINDOW_M: Final = 10.0
"""Length over which bends are measured: corners of polylines are not bends."""
_CURVE_RAD: Final = 0.25
"""Junction lanes that turn less in all only lead to a lane with a lateral offset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What to record of each network.

    Attributes:
        configs: configurations with traffic. kind: of generated networks. networks: their number.
        scenes: maximum per network. avs: maximum of scenes per moment.
        every_s: time between moments. start_s: time until the first one.
        diverse: use a mixed driver population instead of the demand's vehicle types.
    """

    configs: tuple[Path, ...]
    kind: str
    networks: int
    seed: int
    scenes: int
    avs: int
    start_s: float
    every_s: float
    diverse: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingTask:
    """One network; ``config`` is None for the generated network ``number``."""

    name: str
    config: Path | None
    kind: str
    number: int
    out: Path
    wanted: Wanted


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """The result for a network: its number of scenes, or why there are none."""

    name: str
    given: bool
    scenes: int
    reason: str = ""


def record_all(wanted: Wanted, out: Path, jobs: int) -> Iterator[Recorded]:
    """Record all networks, each into a separate folder; yields each as it finishes.

    The files do not depend on ``jobs``. A network that fails, or whose process dies, is left out
    with the reason. Existing folders of the same command are kept, so that an interrupted command
    can be repeated.

    Raises OutputError if ``out`` cannot be written, UsageError if it contains other files.
    """
    tasks = _tasks(wanted, out)
    _claim(wanted, out)
    for task in tasks:
        if task.out.is_dir():
            yield _recorded(task)
    missing = [task for task in tasks if not task.out.is_dir()]
    limit_s = _START_LIMIT_S + _SCENE_LIMIT_S * wanted.scenes
    try:
        for end in workers.run(record_network, missing, jobs=jobs, timeout_s=limit_s):
            yield _recorded(missing[end.index], _sentence(end.reason))
    finally:  # workers that are ended in the middle of a network cannot do so
        _remove_begun(out)


def record_network(task: RecordingTask) -> None:
    """Record one network; its folder appears when it is complete, with at least one scene."""
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        config = task.config or generated.generate(
            task.kind, task.wanted.seed, task.number, Path(folder)
        )
        beside = Path(tempfile.mkdtemp(prefix=f".{task.name}-", dir=task.out.parent))
        try:
            if _write(_recording(task, config), task.wanted.scenes, beside):
                beside.chmod(0o755)
                beside.replace(task.out)
        finally:
            shutil.rmtree(beside, ignore_errors=True)


def _write(recording: Recording, most: int, folder: Path) -> int:
    written = 0
    for scene in record(recording):
        npz.write(scene, folder / f"{scene.name}.npz")
        written += 1
        if written == most:
            break
    return written


def _recording(task: RecordingTask, config: Path) -> Recording:
    wanted = task.wanted
    # some moments have no possible AV, and so give no scene
    moments = 10 + 3 * wanted.scenes // wanted.avs
    return Recording(
        config=config,
        seed=wanted.seed if task.config else wanted.seed + task.number,
        start_s=wanted.start_s,
        stop_s=wanted.start_s + moments * max(wanted.every_s, 9.0),
        every_s=wanted.every_s,
        diverse=wanted.diverse,
        avs=wanted.avs,
        name=None if task.config else task.name,
    )


def _tasks(wanted: Wanted, out: Path) -> list[RecordingTask]:
    def task(name: str, config: Path | None, kind: str, number: int) -> RecordingTask:
        return RecordingTask(
            name=name, config=config, kind=kind, number=number, out=out / name, wanted=wanted
        )

    tasks = [
        task(f"{config.stem}-{wanted.seed}", config, "", number)
        for number, config in enumerate(wanted.configs)
    ]
    twice = {one.name for one in tasks if [other.name for other in tasks].count(one.name) > 1}
    if twice:
        raise UsageError(
            f"Two configurations are named '{min(twice)}'; rename one, or record it separately."
        )
    kinds = generated.kinds_of(wanted.kind, wanted.networks)
    tasks += [
        task(f"{kind}-{wanted.seed}-{number:03d}", None, kind, number)
        for number, kind in enumerate(kinds)
    ]
    return tasks


def _claim(wanted: Wanted, out: Path) -> None:
    """Create the folder with a note of the command; remove parts of a killed command."""
    note = out / MANIFEST
    described = json.dumps(asdict(wanted), indent=2, sort_keys=True, default=str) + "\n"
    try:
        out.mkdir(parents=True, exist_ok=True)
        if note.is_file() and files.content(note) != described.encode():
            raise UsageError(
                f"'{out}' contains scenes of another command (see {note}); remove it, or give "
                "another folder."
            )
        if not note.is_file() and any(out.iterdir()):
            raise UsageError(f"'{out}' is not empty; remove it, or give another folder.")
        files.write(note, described)
        _remove_begun(out)
    except OSError as error:
        raise OutputError(f"'{out}' cannot be written: {error.strerror}.") from None


def _remove_begun(out: Path) -> None:
    for left in out.glob(".*-*"):
        shutil.rmtree(left, ignore_errors=True)


def _sentence(reason: str) -> str:
    """What a worker says of an error, without its class and full stop where that is ours."""
    return reason.removeprefix(f"{SimulationError.__name__}: ").removesuffix(".")


def _recorded(task: RecordingTask, reason: str = "") -> Recorded:
    scenes = len(list(task.out.glob("*.npz"))) if task.out.is_dir() else 0
    if not scenes and not reason:
        reason = "no vehicle moves for 9 s with others around"
    return Recorded(name=task.name, given=task.config is not None, scenes=scenes, reason=reason)
