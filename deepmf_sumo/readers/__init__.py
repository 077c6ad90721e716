"""Recorded file -> Scene: one module per format; `base.Reader` is the contract.

A file's format is recognised by its content: every plug-in of the folder is tried. Each file is
read in a separate process (`_bounded`), so that no file can end a sweep or a listing. `records`
lists the locations of scenes, and can keep them in a cache folder; `read` reads one scene.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from deepmf_sumo import files, plugins
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.readers import _bounded
from deepmf_sumo.readers.base import (
    IndexedReader,
    Reader,
    RecordRef,
    Refusal,
    UnknownFormatError,
)
from deepmf_sumo.texts import LONGEST_ID, is_plain, shown

INDEX_VERSION: Final = 4
OVERVIEWS: Final = frozenset({"dataset_summary.pkl", "dataset_mapping.pkl"})
"""Files of a ScenarioNet folder that describe the others. A folder's scenes are found without."""
_FIRST_BYTES: Final = 2**16
"""Read before a format is looked for: a file whose start cannot be read is of no format."""

T = TypeVar("T")

__all__ = ["RecordRef", "Refusal", "find", "ids", "read", "records", "scene", "scenes"]


def find(paths: Sequence[Path]) -> list[Path]:
    """The given files, and those in the given folders (at any depth, sorted, without hidden ones).

    A file with several links is given once. A folder of results (`deepmf-sumo run --scenes`) gives
    the scenes of its runs.

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
        _check(found[0])
    return (each for file in found for each in _scenes(file))


def records(path: Path, cache: Path | None = None) -> Iterator[RecordRef]:
    """The locations of the scenes in a file or folder, in order, with those of refused records.

    Args:
        path: a recorded file, or a folder of such files.
        cache: folder that keeps the locations of a file's scenes until the file changes.

    A file of a folder that cannot be read, or not to its end, has a location of its own after those
    that were found; `read` says why. Files of unknown formats are left out.

    Raises ReaderError if the path is a file that is no recording or cannot be read.
    """
    is_folder, listed = path.is_dir(), False
    for file in find([path]):
        for ref in _records(file, cache):
            if not is_folder and not (listed or ref.reader):
                _check(path)
            listed = True
            yield ref
    if not listed and not is_folder:
        _check(path)


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


# Files


def _files(path: Path) -> list[Path]:
    """The path itself, or the files in the folder."""
    if path.is_dir():
        try:
            found = files.inside(path, _scenes_of_results, lost=True)
            return [file for file in found if file.name not in OVERVIEWS]
        except OSError as error:
            raise ReaderError(f"{error.filename} cannot be read: {files.reason(error)}.") from None
    if path.exists() or path.is_symlink():  # a link to nowhere is a file that cannot be read
        return [path]
    raise UsageError(f"{path} does not exist; give a recorded file or a folder of such files.")


def _scenes_of_results(folder: Path) -> list[Path] | None:
    """The scenes that the runs of a result folder wrote; None for any other folder."""
    if (folder / "runs.csv").is_file() and (folder / "runs").is_dir():
        return list(folder.glob("runs/*/scene.npz"))
    return None


def _guarded(path: Path, work: Callable[[], Iterator[T]]) -> Iterator[T]:
    """The items of some work on a file. Raises ReaderError, e.g. `_bounded.EndedError`."""
    if not is_plain(str(path)):
        raise _bounded.EndedError(
            f"{shown(str(path))} has a name with unprintable characters; rename it."
        )
    for name in plugins.names("readers"):  # once here, not in each reading process
        plugins.load("readers", name)
    try:
        yield from _bounded.each(work)
    except _bounded.EndedError as error:
        raise _bounded.EndedError(f"{path}: {shown(str(error))}.") from None
    except ReaderError as error:
        raise type(error)(shown(str(error))) from None


def _check(path: Path) -> None:
    """Raises ReaderError if no plug-in accepts the file."""

    def look() -> Iterator[None]:
        _accepting(path)
        return iter(())

    for _ in _guarded(path, look):
        pass


def _accepting(path: Path) -> str:
    """The plug-in that accepts the file.

    Raises UnknownFormatError if none does, and ReaderError if the file cannot be read.
    """
    try:
        with files.opened(path) as file:
            file.read(_FIRST_BYTES)
    except OSError as error:
        raise ReaderError(f"{path} cannot be read: {files.reason(error)}.") from None
    known = plugins.names("readers")
    for name in known:
        if _reader(name).accepts(path):
            return name
    raise UnknownFormatError(f"{path} has an unknown format; known are {', '.join(known)}.")


def _reader(name: str) -> Reader:
    plugin = plugins.load("readers", name)
    reader: Reader = plugin() if isinstance(plugin, type) else plugin
    return reader


# Scenes


def _scenes(path: Path) -> Iterator[Scene | Refusal]:
    count = 0
    try:
        for each in _guarded(path, lambda: _read(_reader(_accepting(path)), path)):
            yield each
            count += 1
    except ReaderError as error:
        yield Refusal(file=shown(str(path)), record=count, name="", reason=str(error))


def _read(reader: Reader, path: Path) -> Iterator[Scene | Refusal]:
    """What the reader finds in the file. Raises ReaderError if that is nothing."""
    empty = True
    for found in reader.scenes(path):
        empty = False
        yield _printable(found)
    if empty:
        raise ReaderError(_EMPTY.format(path))


_EMPTY: Final = "{} contains no scene; copy or download the file again."


def _printable(found: Scene | Refusal) -> Scene | Refusal:
    """A refusal quotes parts of the file, which can contain any characters."""
    if isinstance(found, Scene):
        return found
    return replace(found, name=shown(found.name[:LONGEST_ID]), reason=shown(found.reason))


def _at(ref: RecordRef) -> Iterator[Scene | Refusal]:
    """The scene at a location, or nothing."""
    reader = _reader(ref.reader or _accepting(ref.file))
    if isinstance(reader, IndexedReader) and ref.offset is not None:
        yield _printable(reader.scene_at(ref))
        return
    yield from (each for each in _read(reader, ref.file) if _number(each) == ref.record)


def _number(found: Scene | Refusal) -> int:
    return found.record if isinstance(found, Refusal) else found.source.record


# Locations of scenes


def _records(path: Path, cache: Path | None) -> list[RecordRef]:
    """The locations of a file's scenes; none if its format is unknown.

    What cannot be read has a location, too, with a name: so it gets a row with the reason in a
    sweep.
    """
    found: list[RecordRef] = []
    try:
        entry = cache / "index" / f"{_key(path)}.json" if cache else None
        known = _indexed(entry, path) if entry else None
        if known is not None:
            return known
        found.extend(_guarded(path, lambda: _listed(path)))  # what came before an error stays
        if entry:
            with suppress(OSError):  # on a read-only or full disk, files are listed every time
                _write_index(entry, found)
    except UnknownFormatError:
        return []
    except (ReaderError, OSError):
        count = len(found)
        found.append(RecordRef(file=path, name=shown(f"{path.name} record {count}"), record=count))
    return found


def _listed(path: Path) -> Iterator[RecordRef]:
    name = _accepting(path)
    reader = _reader(name)
    if isinstance(reader, IndexedReader):
        empty = True
        for ref in reader.records(path):
            empty = False
            yield replace(ref, name=shown(ref.name[:LONGEST_ID]), reader=name)
        if empty:
            raise ReaderError(_EMPTY.format(path))
        return
    for each in _read(reader, path):
        yield RecordRef(file=path, name=each.name, record=_number(each), reader=name)


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
