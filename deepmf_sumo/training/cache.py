"""Features of all scenes, computed once, as memory-mapped arrays in a folder."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import readers
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers.base import Refusal

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[str], None]
VERSION: Final = 1
"""Changes when features change: older caches are not read."""
HELD_OUT: Final = 10
"""One scene in ten is kept from training: for early stopping and temperatures."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cache:
    """N samples.

    Attributes:
        arrays: name -> (N, ...) memory-mapped.
        scene: (N) number of the scene. scenes: how many there are.
        refused: records that could not be used.
        digest: of the data and settings.
        chosen: (N) samples to use; None takes all.
    """

    arrays: Arrays
    scene: NDArray[np.int64]
    scenes: int
    refused: int
    digest: str
    chosen: NDArray[np.bool_] | None = None

    def rows(self, *, held_out: bool) -> NDArray[np.int64]:
        """Samples of the scenes that are trained on, or of those that are held out."""
        wanted = (self.scene % HELD_OUT == HELD_OUT - 1) == held_out
        rows: NDArray[np.int64] = np.flatnonzero(
            wanted if self.chosen is None else wanted & self.chosen
        )
        return rows

    def batch(self, rows: NDArray[np.int64]) -> Arrays:
        """The given samples, in memory."""
        order = np.argsort(rows)
        back = np.argsort(order)
        return {name: np.asarray(values[rows[order]])[back] for name, values in self.arrays.items()}


def open_or_make(
    kind: str,
    data: Sequence[Path],
    settings: str,
    samples: Callable[[Scene], Iterable[Arrays]],
    root: Path,
    report: Progress,
) -> Cache:
    """The cache of these recordings, made now if it is not there.

    Args:
        kind: ``opponent`` or ``trajectory``.
        data: recorded files and folders.
        settings: whatever else the features depend on.
        samples: what one scene gives.
        root: folder of all caches.
        report: told how far it is.
    """
    files = readers.find(data)
    digest = _digest(files, f"{VERSION} {kind} {settings}")
    folder = root / f"{kind}-{digest[:16]}"
    if not (folder / "index.json").is_file():
        _make(folder, _accepted(data), samples, report, kind)
    index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    if not index["count"]:
        raise ReaderError(f"There is nothing to learn from in {', '.join(map(str, data))}.")
    arrays: Arrays = {
        name: np.memmap(
            folder / f"{name}.bin", dtype=dtype, mode="r", shape=(index["count"], *shape)
        )
        for name, (dtype, shape) in index["arrays"].items()
    }
    scene = np.array(arrays.pop("scene"))
    return Cache(
        arrays=arrays,
        scene=scene,
        scenes=index["scenes"],
        refused=index["refused"],
        digest=digest,
    )


def _digest(files: Sequence[Path], settings: str) -> str:
    """Of names, sizes and times of the files: contents are not read twice."""
    hasher = hashlib.sha256(settings.encode())
    for file in files:
        stat = file.stat()
        hasher.update(f"{file.name} {stat.st_size} {stat.st_mtime_ns}".encode())
    return hasher.hexdigest()


def _accepted(data: Sequence[Path]) -> Iterator[Scene | Refusal]:
    return readers.scenes(data)


def _make(
    folder: Path,
    found: Iterator[Scene | Refusal],
    samples: Callable[[Scene], Iterable[Arrays]],
    report: Progress,
    kind: str,
) -> None:
    """Write all samples beside the folder, then put it in place."""
    making = folder.with_name(f"{folder.name}.{os.getpid()}")
    making.mkdir(parents=True)
    shapes: dict[str, tuple[str, tuple[int, ...]]] = {}
    count = scenes = refused = 0
    try:
        for each in found:
            if isinstance(each, Refusal):
                refused += 1
                continue
            for sample in samples(each):
                _append(making, {**sample, "scene": np.array(scenes, np.int64)}, shapes)
                count += 1
            scenes += 1
            if scenes % 50 == 0:
                report(f"features for {kind}: {scenes} scenes, {count} samples")
        index = {"count": count, "scenes": scenes, "refused": refused, "arrays": shapes}
        (making / "index.json").write_text(json.dumps(index), encoding="utf-8")
        making.rename(folder)
    finally:
        shutil.rmtree(making, ignore_errors=True)


def _append(folder: Path, sample: Arrays, shapes: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, values in sample.items():
        described = (values.dtype.str, values.shape)
        if shapes.setdefault(name, described) != described:
            raise ValueError(f"{name} is {described}, was {shapes[name]}")
        with (folder / f"{name}.bin").open("ab") as file:
            file.write(values.tobytes())
