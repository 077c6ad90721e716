"""Recordings -> features in a folder of memory-mapped arrays, one folder per source.

An interrupted build can be resumed: the features of each recorded file are kept in a shard until
all shards are complete, and then joined. Their order is that of the files, whatever the number of
processes.
"""

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, Self

import numpy as np

from deepmf_sumo.errors import OutputError, ReaderError, RunError
from deepmf_sumo.files import inside, opened
from deepmf_sumo.scene import Scene, readers
from deepmf_sumo.scene.readers.base import Refusal
from deepmf_sumo.training import processes
from deepmf_sumo.training.samples.dataset import Arrays, Progress, SampleSource
from deepmf_sumo.training.samples.places import SceneArea, area_of

VERSION: Final = 5
"""Increased when features change, so that older caches are not read."""
_SHOWN: Final = 3
"""Number of refused records that a message names."""
_SILENCE_S: Final = 10.0
"""Longest time between two progress reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Data:
    """A source of recordings.

    Attributes:
        path: a recorded file, or a folder of such files.
        weight: share in training relative to the other sources; None is the number of samples.
    """

    path: Path
    weight: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """How the samples of a scene are computed.

    Attributes:
        kind: ``opponent``, ``trajectory`` or ``graph``.
        settings: everything that the features depend on, except the scene.
        of: gives the samples of one scene; must be picklable for several processes.
    """

    kind: str
    settings: str
    of: Callable[[Scene], Iterable[Arrays]]


@dataclass(slots=True)
class Contents:
    """Contents of a folder of arrays; written to its ``index.json``."""

    count: int = 0
    scenes: list[str] = field(default_factory=list)
    areas: list[SceneArea] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    arrays: dict[str, tuple[str, tuple[int, ...]]] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write the index of a folder."""
        (folder / "index.json").write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The index of a folder."""
        content = json.loads((folder / "index.json").read_text(encoding="utf-8"))
        content["areas"] = [SceneArea.read(each) for each in content["areas"]]
        return cls(**content)


def open_or_build(
    features: Features, data: Data, root: Path, report: Progress, jobs: int = 1
) -> SampleSource:
    """The features of recordings; if they are missing, ``jobs`` processes compute them.

    ``root`` is the folder of all caches.

    Raises:
        UsageError: the path does not exist.
        ReaderError: there are no samples.
        OutputError: the features cannot be written.
    """
    files = readers.find([data.path])
    digest = digest_of(features.kind, features.settings, data.path)
    folder = root / f"{features.kind}-{digest[:16]}"
    if not (folder / "index.json").is_file():
        _report_others(root, features.kind, data.path, report)
        try:
            _build(folder, data.path, files, features, report, jobs)
        except OSError as error:
            if not (folder / "index.json").is_file():  # another process may have built it
                raise OutputError(
                    f"Features cannot be written to {root} ({error.strerror}); make room there, or"
                    " give another folder with --cache."
                ) from None
    contents = Contents.read(folder)
    _report_refused(data.path, contents, report)
    if not contents.count:
        raise ReaderError(_nothing(data.path, files, contents))
    return _source(folder, contents, data, digest)


def _source(folder: Path, contents: Contents, data: Data, digest: str) -> SampleSource:
    """The arrays of a folder, memory-mapped."""
    arrays: Arrays = {
        name: np.memmap(
            folder / f"{name}.bin", dtype=dtype, mode="r", shape=(contents.count, *shape)
        )
        for name, (dtype, shape) in contents.arrays.items()
    }
    return SampleSource(
        name=data.path.name,
        scene=np.array(arrays.pop("scene")),
        arrays=arrays,
        scenes=contents.scenes,
        areas=contents.areas,
        refused=contents.refused,
        digest=digest,
        weight=data.weight,
    )


def digest_of(kind: str, settings: str, path: Path) -> str:
    """Digest of the settings of the features, and of the files' names and contents.

    A copy of the recordings has the same digest. A file that cannot be read counts as one without
    content, and is refused with the others. Raises UsageError if the path does not exist.
    """
    hasher = hashlib.sha256(f"{VERSION} {kind} {settings}".encode())
    roots = readers.find([path])
    for file in (file for root in roots for file in (inside(root) if root.is_dir() else [root])):
        try:
            with opened(file) as stream:
                content = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError:
            content = ""
        hasher.update(f"{file.name} {content}".encode())
    return hasher.hexdigest()


def _build(
    folder: Path,
    path: Path,
    files: Sequence[Path],
    features: Features,
    report: Progress,
    jobs: int,
) -> None:
    """Write a shard for each file and join the shards."""
    shards = folder.with_name(f"{folder.name}.parts")
    shards.mkdir(parents=True, exist_ok=True)
    places = [shards / f"{number:06}" for number in range(len(files))]
    missing = [pair for pair in zip(files, places, strict=True) if not pair[1].is_dir()]
    complete = len(files) - len(missing)
    if complete:
        report(f"features for {features.kind}: resuming after {complete} files")
    last = time.monotonic()
    for number, _ in enumerate(_each(partial(_write_shard, features), missing, jobs), start=1):
        if time.monotonic() - last > _SILENCE_S:
            last = time.monotonic()
            report(
                f"features for {features.kind}: {complete + number} of {len(files)} files"
                f" of {path.name}"
            )
    with _appears_whole(folder) as unfinished:
        contents = _join_shards(places, unfinished)
        (unfinished / "source").write_text(str(path.resolve()), encoding="utf-8")
    shutil.rmtree(shards, ignore_errors=True)
    report(
        f"features for {features.kind}: {contents.count} samples of {len(contents.scenes)} scenes"
        f" of {path.name}"
    )


@contextmanager
def _appears_whole(folder: Path) -> Iterator[Path]:
    """A temporary folder that is renamed to ``folder`` if the block succeeds.

    If another process has made the folder in the meantime, that one stays.
    """
    beside = folder.with_name(f"{folder.name}.{os.getpid()}")
    shutil.rmtree(beside, ignore_errors=True)  # left by a killed process of the same id
    beside.mkdir()
    try:
        yield beside
        if not (folder / "index.json").is_file():
            beside.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _each(
    work: Callable[[tuple[Path, Path]], None], pairs: Sequence[tuple[Path, Path]], jobs: int
) -> Iterator[None]:
    if jobs == 1 or len(pairs) < 2:
        yield from map(work, pairs)
        return
    with processes.pool(min(jobs, len(pairs))) as pool:
        try:
            yield from pool.map(work, pairs)
        except BrokenProcessPool:
            raise RunError(
                "A process that computes features was killed, perhaps for lack of memory; repeat"
                " the command with fewer --jobs."
            ) from None


def _write_shard(features: Features, pair: tuple[Path, Path]) -> None:
    """Write the features of one recorded file into a folder that appears complete."""
    file, place = pair
    contents = Contents()
    with _appears_whole(place) as unfinished:
        for each in _scenes(file):
            if isinstance(each, Refusal):
                name = each.name or f"record {each.record}"
                contents.refused[f"{Path(each.file).name}: {name}"] = each.reason
                continue
            for sample in _samples(features, each, file):
                numbered = {**sample, "scene": np.array(len(contents.scenes), np.int64)}
                _append(unfinished, numbered, contents.arrays)
                contents.count += 1
            contents.scenes.append(each.name)
            contents.areas.append(area_of(each))
        contents.write(unfinished)


def _scenes(file: Path) -> Iterator[Scene | Refusal]:
    try:
        yield from readers.scenes([file])
    except ReaderError as error:
        yield Refusal(file=str(file), record=0, name="", reason=str(error))


def _samples(features: Features, scene: Scene, file: Path) -> Iterator[Arrays]:
    """The samples of a scene; an error names it."""
    try:
        yield from features.of(scene)
    except (ArithmeticError, LookupError, ValueError) as error:
        raise RunError(
            f"The features of scene {scene.name} of {file} cannot be computed"
            f" ({type(error).__name__}: {error}); leave it out and report this."
        ) from error


def _append(folder: Path, sample: Arrays, arrays: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, values in sample.items():
        described = (values.dtype.str, values.shape)
        if arrays.setdefault(name, described) != described:
            raise ValueError(f"{name} is {described}, was {arrays[name]}")
        with (folder / f"{name}.bin").open("ab") as file:
            file.write(values.tobytes())


def _join_shards(places: Sequence[Path], folder: Path) -> Contents:
    """Concatenate the arrays of all shards; scenes are numbered over all shards."""
    whole = Contents()
    for place in places:
        shard = Contents.read(place)
        for name, (dtype, _) in shard.arrays.items():
            with (folder / f"{name}.bin").open("ab") as to:
                if name == "scene":
                    scene = np.fromfile(place / "scene.bin", dtype) + len(whole.scenes)
                    to.write(scene.astype(dtype).tobytes())
                else:
                    with (place / f"{name}.bin").open("rb") as file:
                        shutil.copyfileobj(file, to, 2**20)
        whole.arrays = shard.arrays | whole.arrays
        whole.count += shard.count
        whole.scenes += shard.scenes
        whole.areas += shard.areas
        whole.refused |= shard.refused
    whole.write(folder)
    return whole


def _nothing(path: Path, files: Sequence[Path], contents: Contents) -> str:
    if not files:
        return f"{path} contains no files; give recordings to train on."
    if contents.scenes:
        return (
            f"None of the {len(contents.scenes)} scenes of {path} gives a sample, since no vehicle"
            " moves for 3 s; give other recordings."
        )
    why = next(iter(contents.refused.values()), "the files are empty")
    return f"No record of {path} can be used ({why.rstrip('.')}); give other recordings."


def _report_refused(path: Path, contents: Contents, report: Progress) -> None:
    if not contents.refused:
        return
    shown = [f"{name} ({reason})" for name, reason in list(contents.refused.items())[:_SHOWN]]
    rest = len(contents.refused) - len(shown)
    more = f"; and {rest} more" if rest else ""
    report(
        f"{path.name}: {len(contents.refused)} record(s) cannot be used and are left out: "
        f"{'; '.join(shown)}{more}"
    )


def _report_others(root: Path, kind: str, path: Path, report: Progress) -> None:
    """Name other caches of the same recordings, since caches are large."""
    for file in sorted(root.glob(f"{kind}-*/source")):
        if file.read_text(encoding="utf-8") == str(path.resolve()):
            size = sum(each.stat().st_size for each in file.parent.iterdir()) / 2**20
            report(
                f"{file.parent} ({size:.0f} MB) contains features of an earlier state of"
                f" {path.name}, or with other settings; delete it if you no longer need them"
            )
