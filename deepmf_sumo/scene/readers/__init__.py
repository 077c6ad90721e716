"""Recorded file or folder -> Scene: one module per format; `base.Reader` is the contract.

A format is recognised by its content: every plug-in of the folder is asked. `records` lists the
locations of scenes, and can keep them in a cache folder; `read` reads one scene.

Files come from strangers, and there is one wall against them: each root (a file, or the folder of a
scene) is read in a process of its own with limits for time and memory (`_bounded`), whose end costs
one row of a listing or a sweep. Formats have no limits of their own, then, and refuse only what
could run code or reach into memory (`_pickle`). In the same way all checks and repairs of what a
file says are in one place (`raw.repair`), so that a fault has the same outcome in every format.
"""

import hashlib
import json
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import PluginError, ReaderError, UsageError
from deepmf_sumo.scene import Scene
from deepmf_sumo.scene.readers import _bounded
from deepmf_sumo.scene.readers.base import (
    FolderReader,
    Reader,
    RecordRef,
    Refusal,
    UnknownFormatError,
    UnreadableError,
)
from deepmf_sumo.scene.readers.raw.repair import cut, repair
from deepmf_sumo.texts import LONGEST_ID, is_plain, shown

INDEX_VERSION: Final = 5
OVERVIEWS: Final = frozenset({"dataset_summary.pkl", "dataset_mapping.pkl"})
"""Files of a ScenarioNet folder that describe the others. A folder's scenes are found without."""
_FIRST_BYTES: Final = 2**16
"""Read before a format is looked for: a file whose start cannot be read is of no format."""
_MOST_LOST: Final = 1000
"""Records of a root that cannot be used; a file of some kilobytes can unpack to millions."""

_NO_RECORDING: Final = (UnknownFormatError, UnreadableError)

T = TypeVar("T")

__all__ = [
    "RecordRef",
    "Refusal",
    "find",
    "ids",
    "read",
    "read_by",
    "records",
    "repair",
    "scene",
    "scenes",
]


def find(paths: Sequence[Path]) -> list[Path]:
    """The roots: the given files, and those in the given folders (at any depth, without hidden).

    They are sorted, and a file with several links is given once. The folder of a scene is a root of
    its own, and a folder of results (`deepmf-sumo run --scenes`) gives the scenes of its runs: a
    `FolderReader` says so.

    Raises UsageError if a path does not exist, ReaderError if a folder cannot be read.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        for file in _files(path):
            found.setdefault(file.resolve(), file)
    return list(found.values())


def scenes(paths: Sequence[Path]) -> Iterator[Scene | Refusal]:
    """All scenes of the files and folders, one at a time; unusable records as a Refusal.

    A file of an unknown format is a Refusal too, but an error (ReaderError) if it is the only one.
    Raises UsageError immediately if a path does not exist.
    """
    found = find(paths)
    if len(found) == 1:
        only = _scenes(found[0], is_only=True)
        return _begun(next(only, None), only)
    return (each for root in found for each in _scenes(root))


def records(path: Path, cache: Path | None = None) -> Iterator[RecordRef]:
    """The locations of the scenes in a file or folder, in order, with those of refused records.

    Args:
        path: a recorded file, or a folder of such files.
        cache: folder that keeps the locations of a file's scenes until the file changes.

    A file of a folder that cannot be read, or not to its end, has a location of its own after those
    that were found; `read` says why. Files of unknown formats are left out.

    Raises ReaderError if the path is a file that is no recording or cannot be read.
    """
    is_only = not path.is_dir()
    for root in find([path]):
        yield from _records(root, cache, is_only=is_only)


def ids(path: Path, cache: Path | None = None) -> list[str]:
    """Ids of the scenes in a file or folder, as `records` lists them."""
    return [ref.name for ref in records(path, cache)]


def scene(path: Path, scene_id: str, cache: Path | None = None) -> Scene:
    """One scene of a file or folder by its id; the first one if there are several.

    Raises ReaderError if there is no scene of this id, or it cannot be used.
    """
    for file in find([path]):
        for ref in _records(file, cache):
            if ref.name == scene_id:
                return read(ref)
    raise ReaderError(
        f"{path} has no scene '{scene_id}'; `deepmf-sumo data list {path}` lists its scenes."
    )


def read(ref: RecordRef) -> Scene:
    """The scene at a location, without a search.

    Raises ReaderError if it cannot be used, or is no longer there.
    """
    for found in _guarded(ref.file, lambda: _at(ref)):
        if isinstance(found, Refusal):
            raise ReaderError(found.reason)
        if found.name == ref.name:
            return found
    if not ref.reader:
        raise ReaderError(
            f"{ref.file} contains no record {ref.record}, but could not be read to its end when it "
            "was listed; list it again."
        )
    raise ReaderError(
        f"{ref.file} no longer has the scene '{ref.name}' as record {ref.record}; the file has"
        " changed, so list it again."
    )


def read_by(reader: Reader, root: Path) -> Iterator[Scene | Refusal]:
    """A reader's scenes of a root in this process, without limits: for tests of the reader."""
    name = getattr(reader, "__name__", type(reader).__name__).rpartition(".")[2]
    return (_repaired(reader, ref, name) for ref in reader.recordings(root))


# Roots


def _files(path: Path) -> list[Path]:
    """The path itself, or the roots in the folder."""
    if path.is_dir():
        try:
            found = files.inside(path, _roots, lost=True)
            return [file for file in found if file.name not in OVERVIEWS]
        except OSError as error:
            raise ReaderError(f"{error.filename} cannot be read: {files.reason(error)}.") from None
    if path.exists() or path.is_symlink():  # a link to nowhere is a file that cannot be read
        return [path]
    raise UsageError(f"{path} does not exist; give a recorded file or a folder of such files.")


def _roots(folder: Path) -> Sequence[Path] | None:
    """The roots of a folder that a reader knows as a whole; None for any other folder."""
    for name in plugins.names("readers"):
        reader = _reader(name)
        if isinstance(reader, FolderReader) and (found := reader.roots(folder)) is not None:
            return found
    return None


def _guarded(path: Path, work: Callable[[], Iterator[T]]) -> Iterator[T]:
    """The items of some work on a file. Raises ReaderError, e.g. `_bounded.EndedError`."""
    if not is_plain(str(path)):
        raise _bounded.EndedError(
            f"{shown(str(path))} has a name with unprintable characters; rename it."
        )
    for name in plugins.names("readers"):  # once here, not in each reading process
        _reader(name)
    try:
        yield from _bounded.each(work)
    except _bounded.EndedError as error:
        raise _bounded.EndedError(f"{path}: {shown(cut(str(error)))}.") from None
    except ReaderError as error:
        raise type(error)(shown(cut(str(error)))) from None


def _recordings(root: Path) -> tuple[str, Iterable[RecordRef]]:
    """The plug-in that knows the root, and what it finds there.

    Raises UnknownFormatError if none does, and UnreadableError if it cannot be read.
    """
    try:
        if not root.is_dir():
            with files.opened(root) as file:
                file.read(_FIRST_BYTES)
    except OSError as error:
        raise UnreadableError(f"{root} cannot be read: {files.reason(error)}.") from None
    known = plugins.names("readers")
    for name in known:
        found = iter(_reader(name).recordings(root))
        for first in found:
            return name, chain([first], found)
    raise UnknownFormatError(f"{root} has an unknown format; known are {', '.join(known)}.")


def _reader(name: str) -> Reader:
    """A plug-in. Raises PluginError if it does not keep the contract."""
    plugin = plugins.load("readers", name)
    reader: Reader = plugin() if isinstance(plugin, type) else plugin
    for needed in ("recordings", "load"):
        if not callable(getattr(reader, needed, None)):
            raise PluginError(
                f"Reader '{name}' has no '{needed}'; a reader has recordings(root) and load(ref),"
                " see deepmf_sumo.scene.readers.base. (Up to version 0.2: accepts and scenes.)"
            )
    return reader


# Scenes


def _scenes(root: Path, *, is_only: bool = False) -> Generator[Scene | Refusal]:
    """The scenes of a root. Raises ReaderError if it is the only one, and no recording."""
    count = 0
    try:
        for each in _guarded(root, lambda: _read(root)):
            yield each
            count += 1
    except ReaderError as error:
        if is_only and isinstance(error, _NO_RECORDING):
            raise
        yield Refusal(file=shown(str(root)), record=count, name="", reason=str(error))


def _read(root: Path) -> Iterator[Scene | Refusal]:
    """The scenes of a root, until too many of them cannot be used."""
    name, found = _recordings(root)
    lost = 0
    for ref in found:
        scene = _repaired(_reader(name), ref, name)
        yield scene
        lost += isinstance(scene, Refusal)
        if lost == _MOST_LOST:
            raise _bounded.EndedError(_ENOUGH)


_ENOUGH: Final = f"the rest of it was not read, since {_MOST_LOST} records could not be used"


def _begun(
    first: Scene | Refusal | None, others: Generator[Scene | Refusal]
) -> Generator[Scene | Refusal]:
    """An iterator whose first item was taken."""
    with closing(others):
        if first is not None:
            yield first
        yield from others


def _repaired(reader: Reader, ref: RecordRef, dataset: str) -> Scene | Refusal:
    """The scene at a location, or why it cannot be used."""
    where = f"{ref.file} record {ref.record}"
    try:
        with np.errstate(all="ignore"):  # the checks find numbers that are not finite
            loaded = reader.load(ref)
    except ReaderError as error:
        return _refusal(ref, str(error), dataset)
    except MemoryError:
        return _refusal(ref, f"{where}: {_bounded.TOO_LARGE}.", dataset)
    try:
        return repair(loaded)
    except ReaderError as error:
        return _refusal(ref, f"{where}: {error}.", dataset)


def _refusal(ref: RecordRef, reason: str, dataset: str) -> Refusal:
    """A refusal quotes parts of the file, which can contain any characters."""
    return Refusal(
        file=str(ref.file),
        record=ref.record,
        name=shown(ref.name[:LONGEST_ID]),
        reason=shown(cut(reason)),
        dataset=dataset,
    )


def _at(ref: RecordRef) -> Iterator[Scene | Refusal]:
    """The scene at a location, or nothing."""
    if ref.reader:
        yield _repaired(_reader(ref.reader), ref, ref.reader)
        return
    name, found = _recordings(ref.file)
    yield from (_repaired(_reader(name), one, name) for one in found if one.record == ref.record)


# Locations of scenes


def _records(path: Path, cache: Path | None, *, is_only: bool = False) -> list[RecordRef]:
    """The locations of a root's scenes; none if its format is unknown, unless it is the only one.

    What cannot be read has a location, too, with a name: so it gets a row with the reason in a
    sweep.
    """
    found: list[RecordRef] = []
    try:
        is_kept = not path.is_dir()  # a folder's key would have to name all in it
        entry = cache / "index" / f"{_key(path)}.json" if cache and is_kept else None
        known = _indexed(entry, path) if entry else None
        if known is not None:
            return known
        found.extend(_guarded(path, lambda: _listed(path)))  # what came before an error stays
        if entry:
            with suppress(OSError):  # on a read-only or full disk, files are listed every time
                _write_index(entry, found)
    except (ReaderError, OSError) as error:
        if is_only and isinstance(error, _NO_RECORDING):
            raise
        if isinstance(error, UnknownFormatError):
            return []
        count = len(found)
        found.append(RecordRef(file=path, name=shown(f"{path.name} record {count}"), record=count))
    return found


def _listed(root: Path) -> Iterator[RecordRef]:
    reader, found = _recordings(root)
    lost = 0
    for ref in found:
        lost += not ref.name
        name = ref.name or f"{root.name} record {ref.record}"
        yield replace(ref, name=shown(name[:LONGEST_ID]), reader=reader, content=None)
        if lost == _MOST_LOST:
            raise _bounded.EndedError(_ENOUGH)


def _key(path: Path) -> str:
    """Key of an index: digest of the file's path, size and time of change."""
    state = path.stat()
    text = f"{INDEX_VERSION}|{path.resolve()}|{state.st_size}|{state.st_mtime_ns}"
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _indexed(entry: Path, path: Path) -> list[RecordRef] | None:
    """The index of a file; None if it is missing, damaged, or of a plug-in that is missing."""
    try:
        content = json.loads(files.content(entry))
        reader = str(content["reader"])
        if reader not in ("", *plugins.names("readers")):
            return None
        return [
            RecordRef(
                file=path,
                name=str(name),
                record=int(record),
                reader=reader,
                offset=None if offset is None else int(offset),
            )
            for name, record, offset in content["records"]
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write_index(entry: Path, refs: Sequence[RecordRef]) -> None:
    """Write an index that appears complete or not at all. Raises OSError."""
    entry.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "format_version": INDEX_VERSION,
        "reader": refs[0].reader if refs else "",
        "records": [(ref.name, ref.record, ref.offset) for ref in refs],
    }
    files.write(entry, json.dumps(content))
