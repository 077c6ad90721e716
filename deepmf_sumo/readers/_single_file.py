"""Formats of one scene per file: the file is read, parsed, described and checked."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.datatypes import Scene, Source
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers._checks import checked
from deepmf_sumo.readers._recording import Recording
from deepmf_sumo.readers.base import Refusal

Parse = Callable[[bytes], Any]
"""Content -> its description. Raises ReaderError with the end of a sentence about the file."""
Describe = Callable[[Any, Source], Recording]
"""Raises KeyError for a missing key; other errors of malformed values are also caught."""

_MALFORMED = (TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError)


def head(path: Path, count: int) -> bytes | None:
    """The first bytes of a file; None if it cannot be read."""
    try:
        with files.opened(path) as file:
            return file.read(count)
    except OSError:
        return None


def found(path: Path, dataset: str, read: Callable[[Path], Scene]) -> Iterator[Scene | Refusal]:
    """The file's one scene, or its ReaderError as a Refusal."""
    try:
        yield read(path)
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name=path.stem, reason=str(error), dataset=dataset)


def scene(path: Path, dataset: str, largest: int, parse: Parse, describe: Describe) -> Scene:
    """The file's scene, checked; the file may have ``largest`` bytes.

    Raises ReaderError with the file and the reason.
    """
    try:
        content = files.content(path, largest)
        described = parse(content)
    except OSError as error:
        raise ReaderError(f"{path} cannot be read ({files.reason(error)}).") from None
    except ReaderError as error:
        raise ReaderError(f"{path} {error}.") from None
    digest = hashlib.sha256(content).hexdigest()
    source = Source(dataset=dataset, file=str(path), record=0, sha256=digest)
    try:
        with np.errstate(all="ignore"):  # the checks find numbers that are not finite
            recording = describe(described, source)
    except KeyError as error:
        raise ReaderError(f"{path} is incomplete: it lacks the key {error}.") from None
    except _MALFORMED as error:
        raise ReaderError(f"{path} is not a valid scene: {error}.") from None
    return checked(recording)
