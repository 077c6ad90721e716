"""The files that tasks need, and whether another machine has the same ones at the same places."""

import hashlib
import importlib.util
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from deepmf_sumo.benchmark.tasks import Task
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.spec import FromNetwork, Spec

_READ_BYTES: Final = 2**28
"""Up to this size files are compared by content, above by their names and sizes."""

_SYNONYMS: Final = {"net", "n", "routes", "r", "additional", "a"}
"""Short names of SUMO's options that name files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """A file or folder, and what is in it."""

    path: Path
    digest: str


def inputs_of(tasks: Sequence[Task]) -> tuple[Input, ...]:
    """Recordings, configurations and the files they name, weights, and planners of the user's.

    What does not exist here is left out: the run itself says so better.
    """
    found: dict[Path, None] = {}
    known: set[object] = set()
    for task in tasks:
        one = task.spec
        key = (one.source, one.weights, one.planner.name, str(one.planner.settings.get("file")))
        if repr(key) not in known:
            known.add(repr(key))
            found |= dict.fromkeys(_paths(one))
    return tuple(Input(path=path, digest=got) for path in found if (got := digest(path)))


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
        files = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
        sizes = [one.stat().st_size for one in files]
        hasher = hashlib.sha256()
        for file, size in zip(files, sizes, strict=True):
            hasher.update(f"{file.relative_to(path)} {size} ".encode())
            if sum(sizes) <= _READ_BYTES:
                hasher.update(file.read_bytes())
    except OSError:
        return ""
    return hasher.hexdigest()


def _paths(spec: Spec) -> Iterator[Path]:
    source = spec.source
    if isinstance(source, FromNetwork):
        yield source.network
        yield from _named(source.network)
        words = (part for word in source.sumo_options for part in word.split(","))
        yield from (Path(word).absolute() for word in words if word and Path(word).is_file())
    else:
        yield source.recording
    weights = _weights(spec.weights)
    if weights is not None:
        yield weights
    module, colon, _ = spec.planner.name.partition(":")
    origin = _origin(module) if colon else None
    if origin is not None:
        yield origin
    if file := spec.planner.settings.get("file"):
        yield Path(file).absolute()


def _named(config: Path) -> Iterator[Path]:
    """Files that a .sumocfg names; those that these name in turn are not looked for."""
    try:
        elements = list(ET.parse(config).iter())  # noqa: S314 - SUMO reads it, too
    except (ET.ParseError, OSError):
        return
    for element in elements:
        if element.tag in _SYNONYMS or element.tag.endswith(("-file", "-files")):
            for name in element.get("value", "").split(","):
                path = config.parent / name.strip()
                if name.strip() and path.is_file():
                    yield path


def _weights(name: str) -> Path | None:
    """``open`` is part of the program, whose version is compared."""
    if name == "open":
        return None
    from deepmf_sumo.predictors.weights import find  # brings torch along

    try:
        return find(name).absolute()
    except WeightsError:
        return None


def _origin(module: str) -> Path | None:
    """The file of a module of the user's."""
    try:
        found = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return None
    return Path(found.origin).absolute() if found and found.origin else None


__all__ = ["Input", "digest", "inputs_of", "lacking"]
