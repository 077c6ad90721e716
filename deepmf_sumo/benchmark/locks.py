"""One sweep a folder: an operating system's lock, which dies with its process.

So a ``kill -9`` leaves no folder locked, and a second sweep into the same folder is refused.
"""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from deepmf_sumo.errors import OutputError

try:
    import fcntl
except ImportError:  # Windows has other ones
    fcntl = None  # type: ignore[assignment]

FILE: Final = ".lock"


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """The folder, which exists, is this process's alone; not twice at a time.

    Where the file system has no locks it is nobody's, see `known`.

    Raises OutputError where another process has it, or the file cannot be written.
    """
    number = _locked(folder / FILE)
    try:
        yield
    finally:
        # removed while it is held: who has opened it meanwhile sees that it is not there any more
        (folder / FILE).unlink(missing_ok=True)
        os.close(number)


def known(folder: Path) -> bool:
    """Whether the file system of a folder has locks."""
    probe = folder / f"{FILE}.{os.getpid()}"
    number = os.open(probe, os.O_RDWR | os.O_CREAT)
    try:
        return _lock(number)
    finally:
        probe.unlink(missing_ok=True)
        os.close(number)


def _locked(file: Path) -> int:
    """The open file, locked where that is possible."""
    while True:
        number = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(number)
            if _is(file, number):
                break
        except BlockingIOError:
            holder = os.read(number, 200).decode("utf-8", "replace").strip() or "another process"
            os.close(number)
            raise OutputError(
                f"{file.parent} is being written by {holder}: wait until that has ended, or choose"
                " another folder for --out."
            ) from None
        os.close(number)  # the one before removed it between our opening and locking it
    os.ftruncate(number, 0)
    os.write(number, f"process {os.getpid()} of {socket.gethostname()}\n".encode())
    return number


def _lock(number: int) -> bool:
    """Lock an open file; False where there are no locks. Raises BlockingIOError if it is taken."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # e.g. ENOLCK of a network's file system
        return False
    return True


def _is(file: Path, number: int) -> bool:
    """Whether an open file is still the one of its name."""
    try:
        return os.path.samestat(file.stat(), os.fstat(number))
    except FileNotFoundError:
        return False


__all__ = ["FILE", "held", "known"]
