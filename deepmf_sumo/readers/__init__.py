"""Recorded file -> Scene. One file a format; `base.Reader` is the contract.

A file's format is found by its content: every plug-in of the folder is asked.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.readers.base import IndexedReader, Place, Reader, Refusal
from deepmf_sumo.readers.index import cached

__all__ = ["Refusal", "find", "ids", "scene", "scenes"]


def find(paths: Sequence[Path]) -> list[Path]:
    """The given files, and those in the given folders (at any depth, sorted, hidden ones not).

    A folder of results (`deepmf-sumo run --scenes`) gives the scenes of its runs.

    Raises UsageError where a path does not exist, ReaderError where a folder cannot be read.
    """
    found: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            found.update(dict.fromkeys(_inside(path)))
        elif path.exists():
            found[path] = None
        else:
            raise UsageError(f"{path} does not exist; give a recorded file or a folder of such.")
    return list(found)


def scenes(paths: Sequence[Path]) -> Iterator[Scene | Refusal]:
    """All scenes of the files and folders, one at a time; what cannot be used as a Refusal.

    A file of no known format is a Refusal too, but an error (ReaderError) where it is the only
    one. Raises UsageError at once where a path does not exist.
    """
    files = find(paths)
    if len(files) == 1:
        _reader(files[0])
    return (each for file in files for each in _scenes(file))


def ids(path: Path, cache: Path | None = None) -> list[str]:
    """Ids of the scenes in a file or folder, in order, refused ones too if they have one.

    Args:
        path: a recorded file, or a folder of such.
        cache: folder in which to keep what was found out about large files.
    """
    return [place.name for file in find([path]) for place in _places(file, cache)]


def scene(path: Path, scene_id: str, cache: Path | None = None) -> Scene:
    """One scene of a file or folder, without reading the others where the format allows that.

    Raises ReaderError where there is no scene of this id, or it cannot be used.
    """
    files = find([path])
    for file in files:
        place = next((one for one in _places(file, cache) if one.name == scene_id), None)
        if place is not None:
            return _accepted(_at(file, place))
    raise ReaderError(
        f"{path} has no scene '{scene_id}'; `deepmf-sumo scenes {path}` lists those it has."
    )


def _inside(folder: Path) -> list[Path]:
    """Files that are not hidden; of a folder of results, the scenes that its runs wrote alone."""
    if (folder / "runs.csv").is_file() and (folder / "runs").is_dir():
        return sorted(folder.glob("runs/*/scene.npz"))
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        raise ReaderError(f"{folder} cannot be read: {error.strerror}.") from None
    found: list[Path] = []
    for path in inside:
        if path.name.startswith("."):
            continue
        found += _inside(path) if path.is_dir() else [path] if path.is_file() else []
    return found


def _reader(path: Path) -> Reader:
    """The plug-in that accepts the file. Raises ReaderError where none does."""
    try:
        path.open("rb").close()
    except OSError as error:
        raise ReaderError(f"{path} cannot be read: {error.strerror}.") from None
    known = plugins.names("readers")
    for name in known:
        plugin = plugins.load("readers", name)
        reader: Reader = plugin() if isinstance(plugin, type) else plugin
        if reader.accepts(path):
            return reader
    raise ReaderError(f"{path} is of no known format; known are {', '.join(known)}.")


def _scenes(path: Path) -> Iterator[Scene | Refusal]:
    try:
        yield from _reader(path).scenes(path)
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name="", reason=str(error))


def _places(path: Path, cache: Path | None) -> list[Place]:
    def look() -> Iterator[Place]:
        reader = _reader(path)
        if isinstance(reader, IndexedReader):
            yield from reader.places(path)
            return
        for each in reader.scenes(path):
            record = each.record if isinstance(each, Refusal) else each.source.record
            yield Place(name=each.name, record=record, offset=0)

    try:
        return cached(path, cache, look)
    except ReaderError:
        return []  # no recording: nothing in it has an id


def _at(path: Path, place: Place) -> Scene | Refusal:
    reader = _reader(path)
    if isinstance(reader, IndexedReader):
        return reader.scene_at(path, place)
    for each in reader.scenes(path):
        record = each.record if isinstance(each, Refusal) else each.source.record
        if record == place.record:
            return each
    raise ReaderError(f"{path} has no record {place.record} any more; was it changed meanwhile?")


def _accepted(found: Scene | Refusal) -> Scene:
    if isinstance(found, Refusal):
        raise ReaderError(found.reason)
    return found
