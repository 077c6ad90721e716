"""Reading files that a user names, and writing files that appear whole.

A path can name a device, a pipe or a folder, and a file of a few kilobytes can unpack to gigabytes.
Only regular files pass here, nothing waits, and no more is read than the caller allows. What does
not pass raises OSError like a file that is missing, so that callers handle one kind of error;
`reason` is the end of their sentence::

    except OSError as error:
        raise SpecError(f"{file}: cannot be read: {files.reason(error)}.") from None

A written file appears under its name when it is complete, with the same bytes for the same content.
What the system refuses is an OutputError inside `writing`.
"""

import errno
import gzip
import hashlib
import io
import json
import os
import secrets
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, ParamSpec, TypeVar, cast

from deepmf_sumo.errors import OutputError

if TYPE_CHECKING:  # `--help` does not load numpy
    from numpy.typing import NDArray
from platformdirs import user_data_path

GZIP: Final = b"\x1f\x8b"
"""The first bytes of a gzip file."""

Given = ParamSpec("Given")
Made = TypeVar("Made")
Instead = Callable[[Path], Sequence[Path] | None]

_PIECE: Final = 2**20
MOST: Final = 2**34
"""Bytes that are read where a caller sets no limit: of networks, weights and digests."""
_NAME_BYTES: Final = 100
"""Of a name in that of its part: names have at most 255 bytes."""
_TAKEN: Final = {errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR, errno.EISDIR}
_MOST_OTHERS: Final = 100
_LEAST_EFFORT: Final = 1
_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def opened(path: Path) -> io.BufferedReader:
    """A regular file, open for reading; links are followed. Raises OSError."""
    try:
        _refuse_special(path, path.stat())  # some devices act when they are opened
        return open(path, "rb", opener=_regular)
    except ValueError as error:  # a NUL or half a surrogate pair in the path
        raise OSError(errno.EINVAL, f"no file can have this name ({error})", str(path)) from None


def content(path: Path, largest: int = MOST) -> bytes:
    """All bytes of a regular file. Raises OSError, also where there are more than ``largest``."""
    with opened(path) as file:
        # A first piece of the whole size, so that nothing is copied; files of /proc have size 0.
        size = os.fstat(file.fileno()).st_size
        return b"".join(_pieces(path, file, largest, first=size + 1))


def text(path: Path, largest: int = MOST, encoding: str = "utf-8") -> str:
    """All text of a regular file. Raises OSError as `content`, UnicodeDecodeError."""
    return content(path, largest).decode(encoding)


def pieces(path: Path, largest: int = MOST) -> Iterator[bytes]:
    """A regular file in pieces of 1 MiB, e.g. for a digest. Raises OSError as `content`."""
    with opened(path) as file:
        yield from _pieces(path, file, largest)


def unpacked(path: Path, largest: int = MOST) -> BinaryIO:
    """A regular file's bytes, unpacked where it is gzip.

    Raises OSError, here or from reading, where it is damaged or unpacks to more than ``largest``.
    """
    file = opened(path)
    packed = file.read(len(GZIP)) == GZIP
    file.seek(0)
    return io.BufferedReader(_Unpacked(path, file, packed, largest))


def inside(folder: Path, instead: Instead | None = None, *, lost: bool = False) -> Iterator[Path]:
    """Regular files of a folder at any depth, sorted, without hidden ones.

    With ``lost`` there are links to nowhere, too, which cannot be opened.

    Links are followed, but a folder or file that can be reached in several ways is given once.
    Where ``instead`` gives a list for a folder, that is taken for all that is in the folder; a
    folder in that list is given itself, and not what is in it.
    Raises OSError where a folder cannot be read.
    """
    yield from _inside(folder, instead or (lambda _: None), set(), lost)


def reason(error: OSError) -> str:
    """Why a file cannot be read, as the end of a sentence without its full stop."""
    return error.strerror or str(error)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError of what is done inside into an OutputError that names ``path``."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {reason(error)}.") from None


def check_writable(folder: Path) -> None:
    """Raise OutputError, before any work is done, where no file can be written into a folder.

    The folder may be missing; nothing is left behind.
    """
    there = next(one for one in (folder, *folder.parents) if one.exists())
    with writing(folder), tempfile.TemporaryFile(dir=there):
        pass


@contextmanager
def whole(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which takes the name ``path`` at the end of the block.

    It is flushed to the disk before. Where the block raises, ``path`` stays as it was, and no part
    of the file is left. Of several writers at a time the last one's file stays. Raises OSError.
    """
    beside = path.with_name(f".{path.name[:_NAME_BYTES]}.{secrets.token_hex(6)}.part")
    try:
        with beside.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A folder to fill, which takes the name ``path`` at the end of the block.

    It replaces what was there. Where the block raises, ``path`` stays as it was, and nothing of the
    new folder is left. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        yield beside
        beside.chmod(0o755)
        take_place(beside, path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def take_place(folder: Path, path: Path) -> None:
    """Rename a folder to ``path``, in place of what is there; others may do so, too.

    Raises OSError.
    """
    for _ in range(_MOST_OTHERS):
        try:
            folder.replace(path)
            return
        except OSError as error:
            if error.errno not in _TAKEN:
                raise
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}-old-", dir=path.parent))
        with suppress(FileNotFoundError):  # another writer has moved it away
            path.replace(aside / "old")
        shutil.rmtree(aside, ignore_errors=True)
    folder.replace(path)


def copy(file: Path, to: Path) -> None:
    """Copy the content of a regular file; the copy appears whole. Raises OSError."""
    with whole(to) as made:
        for piece in pieces(file):
            made.write(piece)


def sha256(file: Path) -> str:
    """Digest of a regular file's content. Raises OSError."""
    found = hashlib.sha256()
    for piece in pieces(file):
        found.update(piece)
    return found.hexdigest()


def while_unchanged(most: int) -> Callable[[Callable[Given, Made]], Callable[Given, Made]]:
    """Keep the last ``most`` results of a function of files as long as the files stay as they are.

    Arguments of type `Path` are files, which need not exist. Results are shared: change none.
    """

    def keep(function: Callable[Given, Made]) -> Callable[Given, Made]:
        kept: Callable[..., Made] = lru_cache(maxsize=most)(
            lambda _stamps, *given, **named: function(*given, **named)
        )

        @wraps(function)
        def latest(*given: Given.args, **named: Given.kwargs) -> Made:
            stamps = [
                one.stat().st_mtime_ns if one.exists() else -1
                for one in (*given, *named.values())
                if isinstance(one, Path)
            ]
            return kept(tuple(stamps), *given, **named)

        return latest

    return keep


def remove_parts(folder: Path) -> None:
    """Remove what a process has left that was killed while it wrote files into a folder."""
    for left in folder.glob(".*.part"):
        left.unlink(missing_ok=True)


def write(path: Path, content: str | bytes) -> None:
    """Write a file that appears whole, see `whole`. Raises OSError."""
    with whole(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_json(path: Path, values: Any) -> None:
    """Write JSON with sorted keys. Raises OSError, ValueError for NaN, which JSON does not know."""
    text = json.dumps(values, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write(path, f"{text}\n")


def gzipped(text: str) -> bytes:
    """A gzip file without a time stamp and a file name."""
    return gzip.compress(text.encode(), compresslevel=6, mtime=0)


def npz(arrays: "Mapping[str, NDArray[Any]]") -> bytes:
    """A compressed .npz file; its members have a fixed time stamp, and none is an object."""
    import numpy as np

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            packed = io.BytesIO()
            np.lib.format.write_array(packed, np.asarray(array), allow_pickle=False)
            # More effort makes coordinates little smaller.
            archive.writestr(member, packed.getvalue(), compresslevel=_LEAST_EFFORT)
    return buffer.getvalue()


def _inside(folder: Path, instead: Instead, seen: set[Path], lost: bool) -> Iterator[Path]:
    seen.add(folder.resolve())
    chosen = instead(folder)
    if chosen is None:
        listed = [path for path in folder.iterdir() if not path.name.startswith(".")]
    else:
        listed = list(chosen)
    for path in sorted(listed):
        try:
            kind, real = path.stat().st_mode, path.resolve()
        except (OSError, RuntimeError) as error:  # a link to nowhere, or to itself
            if lost and isinstance(error, FileNotFoundError):
                yield path
            continue
        if real in seen and path != folder:
            continue
        if stat.S_ISDIR(kind) and chosen is None:
            yield from _inside(path, instead, seen, lost)
        elif stat.S_ISDIR(kind) or stat.S_ISREG(kind):
            seen.add(real)
            yield path


def _pieces(path: Path, file: BinaryIO, largest: int, first: int = _PIECE) -> Iterator[bytes]:
    total, wanted = 0, min(first, largest + 1)
    while piece := file.read(wanted):
        total, wanted = total + len(piece), _PIECE
        if total > largest:
            raise _too_large(path, largest)
        yield piece


def _regular(name: str, flags: int) -> int:
    # Else a pipe without a writer would wait for ever; Windows has neither.
    number = os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
    try:
        _refuse_special(Path(name), os.fstat(number))
    except OSError:
        os.close(number)
        raise
    return number


def _refuse_special(path: Path, found: os.stat_result) -> None:
    if stat.S_ISREG(found.st_mode):
        return
    kind = next((name for is_one, name in _KINDS if is_one(found.st_mode)), "no regular file")
    number = errno.EISDIR if stat.S_ISDIR(found.st_mode) else errno.EINVAL
    raise OSError(number, f"it is {kind}, not a regular file", str(path))


def _too_large(path: Path, largest: int) -> OSError:
    return OSError(errno.EFBIG, f"it holds more than the {largest} bytes allowed", str(path))


class _Unpacked(io.RawIOBase):
    """Counts what comes out of a file; closes the file with itself."""

    def __init__(self, path: Path, file: BinaryIO, packed: bool, largest: int) -> None:
        self._path, self._file, self._left, self._largest = path, file, largest, largest
        self._stream = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if packed else file

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        try:
            piece = self._stream.read(len(view))
        except (EOFError, zlib.error) as error:
            raise OSError(errno.EIO, f"it is damaged ({error})", str(self._path)) from None
        self._left -= len(piece)
        if self._left < 0:
            raise _too_large(self._path, self._largest)
        view[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        super().close()
        self._file.close()


def cache_folder() -> Path:
    """``$DEEPMF_SUMO_HOME/cache``, else ``cache`` in the user's data folder; may not exist yet.

    On Linux that is ``~/.local/share/deepmf-sumo/cache``, or in ``$XDG_DATA_HOME``.
    """
    home = os.environ.get("DEEPMF_SUMO_HOME")
    return (Path(home) if home else user_data_path("deepmf-sumo", appauthor=False)) / "cache"
