"""Recordings -> features in a folder of memory-mapped arrays, one folder for each source.

A cache that was cut off goes on: the features of each recorded file are kept apart until all are
there, and joined then. Their order is that of the files, whatever the number of processes.
"""

import hashlib
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo import readers
from deepmf_sumo.errors import OutputError, ReaderError, RunError
from deepmf_sumo.files import opened, reason
from deepmf_sumo.training import parts
from deepmf_sumo.training.cache import Arrays, Progress, Source
from deepmf_sumo.training.parts import Contents, Samples

VERSION: Final = 4
"""Changes when features change: older caches are not read."""
_SHOWN: Final = 3
"""Refused records that a message names."""
_SILENCE_S: Final = 10.0
"""Longest time between two lines on the progress."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Data:
    """Where recordings are, and how much they count in training.

    Attributes:
        path: a recorded file, or a folder of such.
        weight: relative to the other sources'; None goes by the number of samples.
    """

    path: Path
    weight: float | None = None


def open_or_make(
    kind: str,
    data: Data,
    settings: str,
    samples: Samples,
    root: Path,
    report: Progress,
    jobs: int = 1,
) -> Source:
    """The features of these recordings, made now if they are not there.

    Args:
        kind: ``opponent``, ``trajectory`` or ``graph``.
        data: recorded file or folder.
        settings: whatever else the features depend on.
        samples: what one scene gives; with several jobs it must be picklable.
        root: folder of all caches.
        report: told how far it is.
        jobs: processes that make features.

    Raises:
        UsageError: the path does not exist.
        ReaderError: there is nothing to learn from.
        OutputError: the features cannot be written.
    """
    files = readers.find([data.path])
    digest = digest_of(kind, data, settings)
    folder = root / f"{kind}-{digest[:16]}"
    if not (folder / "index.json").is_file():
        _mention_others(root, kind, data.path, report)
        try:
            _make(folder, data.path, files, samples, kind, report, jobs)
        except OSError as error:
            if not (folder / "index.json").is_file():  # another process may have made them
                raise OutputError(
                    f"Features cannot be written to {root} ({error.strerror}); make room there, or"
                    " give another folder with --cache."
                ) from None
    contents = parts.read(folder)
    _mention_refused(data.path, contents, report)
    if not contents.count:
        raise ReaderError(_nothing(data.path, files, contents))
    arrays: Arrays = {
        name: np.memmap(
            folder / f"{name}.bin", dtype=dtype, mode="r", shape=(contents.count, *shape)
        )
        for name, (dtype, shape) in contents.arrays.items()
    }
    scene = np.array(arrays.pop("scene"))
    return Source(
        name=data.path.name,
        arrays=arrays,
        scene=scene,
        scenes=contents.scenes,
        places=contents.places,
        refused=contents.refused,
        digest=digest,
        weight=data.weight,
    )


def digest_of(kind: str, data: Data, settings: str) -> str:
    """Of settings, and the files' names and contents: a copy of the recordings is the same data.

    Raises UsageError where the path does not exist.
    """
    hasher = hashlib.sha256(f"{VERSION} {kind} {settings}".encode())
    for path in readers.find([data.path]):
        try:
            with opened(path) as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise ReaderError(f"{path} cannot be read: {reason(error)}.") from None
        hasher.update(f"{path.name} {content}".encode())
    return hasher.hexdigest()


def _make(
    folder: Path,
    path: Path,
    files: Sequence[Path],
    samples: Samples,
    kind: str,
    report: Progress,
    jobs: int,
) -> None:
    """Write each file's features to a folder of its own, then join them and put them in place."""
    apart = folder.with_name(f"{folder.name}.parts")
    apart.mkdir(parents=True, exist_ok=True)
    places = [apart / f"{number:06}" for number in range(len(files))]
    missing = [pair for pair in zip(files, places, strict=True) if not pair[1].is_dir()]
    if len(missing) < len(files):
        report(f"features for {kind}: going on after {len(files) - len(missing)} files")
    last = time.monotonic()
    for number, _ in enumerate(_each(partial(parts.write, samples), missing, jobs), start=1):
        if time.monotonic() - last > _SILENCE_S:
            last = time.monotonic()
            done = len(files) - len(missing) + number
            report(f"features for {kind}: {done} of {len(files)} files of {path.name}")
    making = folder.with_name(f"{folder.name}.{os.getpid()}")
    shutil.rmtree(making, ignore_errors=True)  # of a process of that number that was killed
    try:
        contents = parts.join(places, making)
        (making / "source").write_text(str(path.resolve()), encoding="utf-8")
        making.rename(folder)
    finally:
        shutil.rmtree(making, ignore_errors=True)
    shutil.rmtree(apart, ignore_errors=True)
    report(
        f"features for {kind}: {contents.count} samples of {len(contents.scenes)} scenes"
        f" of {path.name}"
    )


def _each(
    work: Callable[[tuple[Path, Path]], None], pairs: Sequence[tuple[Path, Path]], jobs: int
) -> Iterator[None]:
    if jobs == 1 or len(pairs) < 2:
        yield from map(work, pairs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(pairs)), mp_context=context) as pool:
        try:
            yield from pool.map(work, pairs)
        except BrokenProcessPool:
            raise RunError(
                "A process that computes features was ended from outside, perhaps for want of"
                " memory; give the same command again, with fewer --jobs."
            ) from None
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _nothing(path: Path, files: Sequence[Path], contents: Contents) -> str:
    if not files:
        return f"{path} holds no files; there is nothing to learn from."
    if contents.scenes:
        return (
            f"None of the {len(contents.scenes)} scenes of {path} gives a sample: no vehicle moves"
            " there for 3 s; there is nothing to learn from."
        )
    why = next(iter(contents.refused.values()), "the files are empty")
    return f"No record of {path} can be used ({why.rstrip('.')}); there is nothing to learn from."


def _mention_refused(path: Path, contents: Contents, report: Progress) -> None:
    if not contents.refused:
        return
    shown = [f"{name} ({reason})" for name, reason in list(contents.refused.items())[:_SHOWN]]
    rest = len(contents.refused) - len(shown)
    more = f"; and {rest} more" if rest else ""
    report(
        f"{path.name}: {len(contents.refused)} record(s) left out, as they cannot be used: "
        f"{'; '.join(shown)}{more}"
    )


def _mention_others(root: Path, kind: str, path: Path, report: Progress) -> None:
    """Caches are large: say which ones of the same recordings are there already."""
    for file in sorted(root.glob(f"{kind}-*/source")):
        if file.read_text(encoding="utf-8") == str(path.resolve()):
            size = sum(each.stat().st_size for each in file.parent.iterdir()) / 2**20
            report(
                f"{file.parent} ({size:.0f} MB) holds features of {path.name} as it was before,"
                " or made otherwise; delete it if you do not go back to that"
            )
