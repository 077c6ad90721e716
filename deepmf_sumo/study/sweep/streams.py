"""Where standard output and error of a process go, those of SUMO included."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

LOGGED_BYTES: Final = 1_000_000
"""Of what a run prints."""


@contextlib.contextmanager
def logged(path: Path) -> Iterator[None]:
    """Redirect standard output and error to a file, those of SUMO included."""
    with path.open("wb") as log:
        kept = [os.dup(number) for number in (1, 2)]
        _flush()
        for number in (1, 2):
            os.dup2(log.fileno(), number)
        try:
            yield
        finally:
            _flush()
            for number, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, number)
                os.close(copy)


def shorten(path: Path) -> None:
    """Leave the middle of a long log out, in place: a planner that talks must not fill the disk."""
    with path.open("r+b") as log:
        size = log.seek(0, os.SEEK_END)
        if size <= LOGGED_BYTES:
            return
        log.seek(size - LOGGED_BYTES // 2)
        last = log.read()
        log.seek(LOGGED_BYTES // 2)
        log.write(f"\n[{size - 2 * (LOGGED_BYTES // 2)} bytes are left out]\n".encode() + last)
        log.truncate()


def silence() -> None:
    """Let nothing that this process prints, or a library in it, reach the terminal."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
