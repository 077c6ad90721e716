"""The features of one recorded file in a folder of its own, and many such folders as one."""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepmf_sumo import readers
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError, RunError
from deepmf_sumo.readers.base import Refusal
from deepmf_sumo.training import windows
from deepmf_sumo.training.cache import Arrays

Samples = Callable[[Scene], Iterable[Arrays]]
"""What one scene gives."""


@dataclass(slots=True)
class Contents:
    """What a folder of arrays holds; written to its ``index.json``."""

    count: int
    scenes: list[str]
    places: list[str]
    refused: dict[str, str]
    arrays: dict[str, tuple[str, tuple[int, ...]]]

    def write(self, folder: Path) -> None:
        """Put it into the folder that it describes."""
        text = json.dumps({name: getattr(self, name) for name in self.__slots__})
        (folder / "index.json").write_text(text, encoding="utf-8")


def read(folder: Path) -> Contents:
    """What a folder of arrays holds."""
    index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    return Contents(**{name: index[name] for name in Contents.__slots__})


def write(samples: Samples, pair: tuple[Path, Path]) -> None:
    """Features of one recorded file, in a folder that appears whole."""
    file, place = pair
    making = place.with_name(f"{place.name}.{os.getpid()}")
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir()
    contents = Contents(0, [], [], {}, {})
    try:
        for each in _found(file):
            if isinstance(each, Refusal):
                contents.refused[_record(each)] = each.reason
                continue
            for sample in _samples(samples, each, file):
                numbered = {**sample, "scene": np.array(len(contents.scenes), np.int64)}
                _append(making, numbered, contents.arrays)
                contents.count += 1
            contents.scenes.append(each.name)
            contents.places.append(windows.place_of(each))
        contents.write(making)
        if not place.is_dir():
            making.rename(place)
    finally:
        shutil.rmtree(making, ignore_errors=True)


def _found(file: Path) -> Iterator[Scene | Refusal]:
    try:
        yield from readers.scenes([file])
    except ReaderError as error:
        yield Refusal(file=str(file), record=0, name="", reason=str(error))


def _samples(samples: Samples, scene: Scene, file: Path) -> Iterator[Arrays]:
    """What a scene gives; an error names it."""
    try:
        yield from samples(scene)
    except (ArithmeticError, LookupError, ValueError) as error:
        raise RunError(
            f"The features of scene {scene.name} of {file} cannot be computed"
            f" ({type(error).__name__}: {error}); leave it out, and tell the developers."
        ) from error


def _record(refusal: Refusal) -> str:
    return f"{Path(refusal.file).name}: {refusal.name or f'record {refusal.record}'}"


def _append(folder: Path, sample: Arrays, arrays: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, values in sample.items():
        described = (values.dtype.str, values.shape)
        if arrays.setdefault(name, described) != described:
            raise ValueError(f"{name} is {described}, was {arrays[name]}")
        with (folder / f"{name}.bin").open("ab") as file:
            file.write(values.tobytes())


def join(places: Sequence[Path], folder: Path) -> Contents:
    """The arrays of all parts, one after the other; scenes are counted through."""
    folder.mkdir(parents=True)
    whole = Contents(0, [], [], {}, {})
    for place in places:
        part = read(place)
        for name, (dtype, shape) in part.arrays.items():
            whole.arrays.setdefault(name, (dtype, shape))
            if name == "scene":
                scene = np.fromfile(place / "scene.bin", dtype) + len(whole.scenes)
                with (folder / "scene.bin").open("ab") as file:
                    file.write(scene.astype(dtype).tobytes())
                continue
            with (
                (folder / f"{name}.bin").open("ab") as to,
                (place / f"{name}.bin").open("rb") as file,
            ):
                shutil.copyfileobj(file, to, 2**20)
        whole.count += part.count
        whole.scenes += part.scenes
        whole.places += part.places
        whole.refused |= part.refused
    whole.write(folder)
    return whole
