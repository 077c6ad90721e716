"""Where standard output and error of a process go, those of SUMO included."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


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


def silence() -> None:
    """Let nothing that this process prints, or a library in it, reach the terminal."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
