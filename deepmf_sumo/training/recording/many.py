"""Traffic of many networks, given or generated, as folders of scenes; one task per network."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.study.sweep import workers
from deepmf_sumo.training import generated
from deepmf_sumo.training.recording.record import Recording, record

MANIFEST: Final = ".record.json"
"""Hidden, so that it is not taken for a scene."""
_START_LIMIT_S: Final = 180.0
_SCENE_LIMIT_S: Final = 10.0


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
    if missing:
        for end in workers.run(record_network, missing, jobs=jobs, timeout_s=limit_s):
            yield _recorded(missing[end.index], end.reason)


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
        for left in out.glob(".*-*"):
            shutil.rmtree(left, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"'{out}' cannot be written: {error.strerror}.") from None


def _recorded(task: RecordingTask, reason: str = "") -> Recorded:
    scenes = len(list(task.out.glob("*.npz"))) if task.out.is_dir() else 0
    if not scenes and not reason:
        reason = "no vehicle moves for 9 s with others around"
    return Recorded(name=task.name, given=task.config is not None, scenes=scenes, reason=reason)
