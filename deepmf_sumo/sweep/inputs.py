"""The files that tasks read: whether they are the same as before, and on another machine."""

import hashlib
import importlib.util
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError, UsageError, WeightsError
from deepmf_sumo.simulation import sumo_options
from deepmf_sumo.spec import FromNetwork, Plugin, Spec
from deepmf_sumo.tasks import Task

_READ_BYTES: Final = 2**28
"""Up to this size files are compared by content, above by their names and sizes."""


Use = Literal["source", "weights", "planner", "adversary"]
"""What a run reads a file for; ``source``: the network and its traffic, or the recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """A file or folder, and what is in it."""

    path: Path
    digest: str


def inputs_of(tasks: Sequence[Task]) -> tuple[Input, ...]:
    """Recordings, configurations and the files they name, weights, planners and tables of drives.

    What does not exist here is left out: the run itself says so better.
    """
    return fingerprinted(tasks)[1]


def fingerprinted(tasks: Sequence[Task]) -> tuple[list[Task], tuple[Input, ...]]:
    """The tasks, each with the digest of what it reads, and all that they read.

    Files' names are not in it: copies of a file elsewhere are the same.
    """
    looked = _Looked()
    marked = [replace(task, inputs=looked.inputs(task.spec)) for task in tasks]
    return marked, looked.every()


class _Looked:
    """Each file is looked at once: thousands of tasks may read the same ones."""

    def __init__(self) -> None:
        self._by_spec: dict[str, tuple[tuple[str, str], ...]] = {}
        self._digests: dict[Path, str] = {}

    def inputs(self, spec: Spec) -> tuple[tuple[str, str], ...]:
        """For each use the digest of the files that a spec's runs read."""
        source = spec.source
        if isinstance(source, FromNetwork):
            read: tuple[object, ...] = (source.network, source.sumo_options)
        else:
            read = (source.recording,)
        key = repr((*read, spec.weights, spec.planner, spec.adversary))
        if key not in self._by_spec:
            self._by_spec[key] = tuple(
                (use, _joined(found))
                for use, paths in _paths(spec).items()
                if (found := [got for path in dict.fromkeys(paths) if (got := self._digest(path))])
            )
        return self._by_spec[key]

    def _digest(self, path: Path) -> str:
        if path not in self._digests:
            self._digests[path] = digest(path)
        return self._digests[path]

    def every(self) -> tuple[Input, ...]:
        """What all specs read that were asked about."""
        return tuple(Input(path=path, digest=got) for path, got in self._digests.items() if got)


def _joined(digests: Iterable[str]) -> str:
    return hashlib.sha256(" ".join(digests).encode()).hexdigest()


def lacking(inputs: Iterable[Input]) -> str:
    """What this machine lacks, as the end of a sentence; empty where it has all."""
    for one in inputs:
        found = digest(one.path)
        if not found:
            return f"has no {one.path}"
        if found != one.digest:
            return f"has another {one.path}"
    return ""


def digest(path: Path) -> str:
    """Of a file or of all in a folder; empty where there is none that can be read."""
    try:
        found = list(files.inside(path)) if path.is_dir() else [path]
        sizes = [one.stat().st_size for one in found]
        small = sum(sizes) <= _READ_BYTES
        hasher = hashlib.sha256()
        for file, size in zip(found, sizes, strict=True):
            name = os.fsencode(file.relative_to(path))
            hasher.update(b"%s %d " % (name, size))
            for piece in files.pieces(file, _READ_BYTES) if small else ():
                hasher.update(piece)
    except (OSError, ValueError):
        return ""
    return hasher.hexdigest()


def _paths(spec: Spec) -> dict[Use, list[Path]]:
    """The files that a spec's runs read, by what they are for."""
    source = spec.source
    if isinstance(source, FromNetwork):
        read = [source.network, *_named(source.network), *_beside(source.sumo_options)]
    else:
        read = [source.recording]
    return {
        "source": read,
        "weights": _weights(spec.weights),
        "planner": list(_of_plugin(spec.planner)),
        "adversary": list(_of_plugin(spec.adversary)),
    }


def _of_plugin(choice: Plugin) -> Iterator[Path]:
    """The module of the user's, and the program or table that its key ``file`` names."""
    module, colon, _ = choice.name.partition(":")
    origin = _origin(module) if colon else None
    if origin is not None:
        yield origin
    file = choice.settings.get("file")
    if isinstance(file, str) and file:
        yield Path(file).absolute()


def _named(config: Path) -> Iterator[Path]:
    """Files that a .sumocfg names; those that these name in turn are not looked for."""
    with suppress(SimulationError):
        yield from _read_by(sumo_options.of_configuration(config), config.parent)


def _beside(beside: Sequence[str]) -> Iterator[Path]:
    """Files that SUMO's options beside the configuration name, as ``--name value`` or ``=value``.

    None where they are wrong, which the run says.
    """
    with suppress(UsageError):
        yield from _read_by(sumo_options.parse(beside), Path.cwd())


def _read_by(options: Mapping[str, str], folder: Path) -> Iterator[Path]:
    """Files that SUMO reads for options; their names are as of the folder."""
    for name, value in options.items():
        if sumo_options.names_files(name):
            yield from (path for path in sumo_options.paths(value, folder) if path.is_file())


def _weights(name: str) -> list[Path]:
    """The networks of a set of weights, and their cards.

    None for ``open``, which is part of the program, whose version is compared, and for those that
    are nowhere, which are those of methods that use none.
    """
    if name == "open":
        return []
    folder = Path(name)
    if not folder.is_absolute():
        from deepmf_sumo.predictors.weights import find

        try:
            folder = find(name).absolute()
        except WeightsError:
            return []
    kinds = {".json", ".onnx", ".safetensors"}
    return sorted(file for file in folder.glob("*") if file.suffix in kinds)


def _origin(module: str) -> Path | None:
    """The file of a module of the user's."""
    try:
        found = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return None
    return Path(found.origin).absolute() if found and found.origin else None
