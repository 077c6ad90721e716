"""Recorded file -> Scene. One file a format; `base.Reader` is the contract.

A file's format is found by its content: every plug-in of the folder is asked. Files are read in a
process of its own each (`bounded`), so that none can end a sweep or a listing.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from deepmf_sumo import files, plugins
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.readers import bounded
from deepmf_sumo.readers.base import IndexedReader, Place, Reader, Refusal
from deepmf_sumo.readers.index import cached
from deepmf_sumo.texts import LONGEST_ID, is_plain, shown

T = TypeVar("T")

__all__ = ["Refusal", "find", "ids", "scene", "scenes"]


def find(paths: Sequence[Path]) -> list[Path]:
    """The given files, and those in the given folders (at any depth, sorted, hidden ones not).

    A file that can be reached in several ways, by links, is given once. A folder of results
    (`deepmf-sumo run --scenes`) gives the scenes of its runs.

    Raises UsageError where a path does not exist, ReaderError where a folder cannot be read.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        for file in _files(path):
            found.setdefault(file.resolve(), file)
    return list(found.values())


def scenes(paths: Sequence[Path]) -> Iterator[Scene | Refusal]:
    """All scenes of the files and folders, one at a time; what cannot be used as a Refusal.

    A file of no known format is a Refusal too, but an error (ReaderError) where it is the only
    one. Raises UsageError at once where a path does not exist.
    """
    found = find(paths)
    if len(found) == 1:
        _check(found[0])
    return (each for file in found for each in _scenes(file))


def ids(path: Path, cache: Path | None = None) -> list[str]:
    """Ids of the scenes in a file or folder, in order, refused ones too if they have one.

    Args:
        path: a recorded file, or a folder of such.
        cache: folder in which to keep what was found out about large files.

    Raises ReaderError where the file is not a recording; one in a folder is left out.
    """
    found = find([path])
    names = [place.name for file in found for place in _places(file, cache)]
    if not names and not path.is_dir():
        _check(path)
    return names


def scene(path: Path, scene_id: str, cache: Path | None = None) -> Scene:
    """One scene of a file or folder, without reading the others where the format allows that.

    Raises ReaderError where there is no scene of this id, or it cannot be used.
    """
    for file in find([path]):
        place = next((one for one in _places(file, cache) if one.name == scene_id), None)
        if place is not None:
            return _at(file, place)
    raise ReaderError(
        f"{path} has no scene '{scene_id}'; `deepmf-sumo scenes {path}` lists those it has."
    )


def _files(path: Path) -> list[Path]:
    """The path itself, or what is in the folder."""
    if path.is_dir():
        try:
            return list(files.inside(path, _scenes_of_results))
        except OSError as error:
            raise ReaderError(f"{error.filename} cannot be read: {files.reason(error)}.") from None
    if path.exists():
        return [path]
    raise UsageError(f"{path} does not exist; give a recorded file or a folder of such.")


def _scenes_of_results(folder: Path) -> list[Path] | None:
    """Of a folder of results, the scenes that its runs wrote; None of any other folder."""
    if (folder / "runs.csv").is_file() and (folder / "runs").is_dir():
        return list(folder.glob("runs/*/scene.npz"))
    return None


def _bounded(path: Path, work: Callable[[], Iterator[T]]) -> Iterator[T]:
    """What the work on a file gives. Raises ReaderError; `bounded.EndedError` is one of them."""
    if not is_plain(str(path)):
        raise bounded.EndedError(
            f"{shown(str(path))} has a name with characters that cannot be shown; rename it."
        )
    for name in plugins.names("readers"):  # once here, not in each process that reads
        plugins.load("readers", name)
    try:
        yield from bounded.each(work)
    except bounded.EndedError as error:
        raise bounded.EndedError(f"{path}: {shown(str(error))}.") from None
    except ReaderError as error:
        raise ReaderError(shown(str(error))) from None


def _check(path: Path) -> None:
    """Raises ReaderError where no plug-in accepts the file."""

    def look() -> Iterator[None]:
        _reader(path)
        return iter(())

    for _ in _bounded(path, look):
        pass


def _reader(path: Path) -> Reader:
    """The plug-in that accepts the file. Raises ReaderError where none does."""
    try:
        files.opened(path).close()
    except OSError as error:
        raise ReaderError(f"{path} cannot be read: {files.reason(error)}.") from None
    known = plugins.names("readers")
    for name in known:
        plugin = plugins.load("readers", name)
        reader: Reader = plugin() if isinstance(plugin, type) else plugin
        if reader.accepts(path):
            return reader
    raise ReaderError(f"{path} is of no known format; known are {', '.join(known)}.")


def _scenes(path: Path) -> Iterator[Scene | Refusal]:
    count = 0
    try:
        for each in _bounded(path, lambda: _read(path)):
            yield each
            count += 1
    except ReaderError as error:
        yield Refusal(file=shown(str(path)), record=count, name="", reason=str(error))


def _read(path: Path) -> Iterator[Scene | Refusal]:
    return map(_told, _reader(path).scenes(path))


def _told(found: Scene | Refusal) -> Scene | Refusal:
    """A refusal names what was not accepted: it may hold anything."""
    if isinstance(found, Scene):
        return found
    name = shown(found.name[:LONGEST_ID])
    return replace(found, name=name, reason=shown(found.reason))


def _places(path: Path, cache: Path | None) -> list[Place]:
    found: list[Place] = []

    def look() -> Iterator[Place]:
        for place in _bounded(path, lambda: _all_places(path)):
            found.append(place)
            yield place

    try:
        return cached(path, cache, look)
    except bounded.EndedError:
        # Named, so that it has a row in a sweep, which says why.
        count = len(found)
        return [*found, Place(name=shown(f"{path.name} record {count}"), record=count, offset=-1)]
    except (ReaderError, OSError):
        return []  # no recording: nothing in it has an id


def _all_places(path: Path) -> Iterator[Place]:
    reader = _reader(path)
    if isinstance(reader, IndexedReader):
        for place in reader.places(path):
            yield replace(place, name=shown(place.name[:LONGEST_ID]))
        return
    for each in map(_told, reader.scenes(path)):
        record = each.record if isinstance(each, Refusal) else each.source.record
        yield Place(name=each.name, record=record, offset=0)


def _at(path: Path, place: Place) -> Scene:
    for each in _bounded(path, lambda: _placed(path, place)):
        if isinstance(each, Refusal):
            raise ReaderError(each.reason)
        return each
    raise ReaderError(f"{path} has no record {place.record} any more; was it changed meanwhile?")


def _placed(path: Path, place: Place) -> Iterator[Scene | Refusal]:
    """The scene at a place, or nothing."""
    reader = _reader(path)
    if isinstance(reader, IndexedReader) and place.offset >= 0:
        yield _told(reader.scene_at(path, place))
        return
    for each in map(_told, reader.scenes(path)):
        record = each.record if isinstance(each, Refusal) else each.source.record
        if record == place.record:
            yield each
            return
