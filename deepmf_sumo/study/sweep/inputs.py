"""The files that tasks read: whether they are the same as before, and on another machine."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.spec import FromNetwork, Plugin, Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import user_code
from deepmf_sumo.sumo.simulation import sumo_options
from deepmf_sumo.sumo.simulation.files_read import files_read

_READ_BYTES: Final = 2**28
"""Up to this size files are compared by content, above by names and sizes, apart from code."""

Use = Literal["source", "weights", "planner", "adversary", "others"]
"""What a run reads a file for; ``source``: the network and its traffic, or the recording."""

_CLASS: Final = re.compile(r"([A-Za-z_][\w.]*):[A-Za-z_]\w*")
"""``my_package.my_module:MyPlanner``"""


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


def of_exporter(name: str) -> tuple[Input, ...]:
    """Code of an exporter of the user's: no run reads it, but what it wrote depends on it."""
    module = plugins.module_of("exporters", name)
    paths = user_code.of_module(module) if module else []
    return tuple(Input(path=path, digest=got) for path in paths if (got := digest(path)))


def fingerprinted(tasks: Sequence[Task]) -> tuple[list[Task], tuple[Input, ...]]:
    """The tasks, each with the digest of what it reads, and all that they read.

    Files' names are not in it: copies of a file elsewhere are the same.
    """
    looked = _Looked()
    marked = [replace(task, inputs=looked.inputs(task.spec)) for task in tasks]
    return marked, looked.every()


class _Looked:
    """Each file is read once: thousands of tasks may read the same ones."""

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
        found = [one for one in found if one.parent.name != "__pycache__"]
        sizes = [one.stat().st_size for one in found]
        small = sum(sizes) <= _READ_BYTES
        hasher = hashlib.sha256()
        for file, size in zip(found, sizes, strict=True):
            name = os.fsencode(file.relative_to(path))
            hasher.update(b"%s %d " % (name, size))
            whole = small or file.suffix == ".py"
            for piece in files.pieces(file, _READ_BYTES) if whole else ():
                hasher.update(piece)
    except (OSError, ValueError):
        return ""
    return hasher.hexdigest()


def _paths(spec: Spec) -> dict[Use, list[Path]]:
    """The files that a spec's runs read, by what they are for."""
    source = spec.source
    read = _of_sumo(source) if isinstance(source, FromNetwork) else [source.recording]
    return {
        "source": read,
        "weights": _weights(spec.weights),
        "planner": list(_of_plugin("planners", spec.planner)),
        "adversary": list(_of_plugin("adversaries", spec.adversary)),
        "others": list(_of_others(("metrics", "readers"))),
    }


def _of_plugin(kind: plugins.Kind, choice: Plugin) -> Iterator[Path]:
    """Code of the user's, and what its settings name: other code, programs, tables, folders."""
    module = plugins.module_of(kind, choice.name)
    yield from user_code.of_module(module) if module else ()
    for text in _texts(choice.settings):
        if match := _CLASS.fullmatch(text):
            yield from user_code.of_module(match[1])
            continue
        path = Path(text).absolute()
        with suppress(OSError, ValueError):  # a text is rarely a name of a file
            if path.is_file():
                yield from user_code.of_program(path)
            elif os.sep in text.strip(os.sep) and path.is_dir():
                yield path


def _texts(value: object) -> Iterator[str]:
    """All texts in the settings of a plug-in, at any depth."""
    inside = value.values() if isinstance(value, Mapping) else value
    if isinstance(value, str):
        yield value
    elif isinstance(inside, Iterable):
        for one in inside:
            yield from _texts(one)


def _of_others(kinds: Sequence[plugins.Kind]) -> Iterator[Path]:
    """Code of plug-ins that no spec names: metrics are measured, and readers tried, in any case."""
    for kind in kinds:
        for name in plugins.names(kind):
            module = plugins.module_of(kind, name)
            yield from user_code.of_module(module) if module else ()


def _of_sumo(source: FromNetwork) -> list[Path]:
    """What SUMO reads; of options beside the configuration that are wrong the run tells."""
    beside: dict[str, str] = {}
    with suppress(UsageError):
        beside = sumo_options.parse(source.sumo_options)
    return files_read(source.network, beside)


def _weights(name: str) -> list[Path]:
    """The networks of a set of weights, and their cards.

    None for ``open``, which is part of the program, whose version is compared, and for those that
    are nowhere, which are those of methods that use none.
    """
    if name == "open":
        return []
    folder = Path(name)
    if not folder.is_absolute():
        from deepmf_sumo.deepmf.networks.weights import find

        try:
            folder = find(name).absolute()
        except WeightsError:
            return []
    kinds = {".json", ".onnx", ".safetensors"}
    return sorted(file for file in folder.glob("*") if file.suffix in kinds)
