"""Formats of one scene in a file: the file is read, parsed, named and described."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import Source
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.raw import RawScene
from deepmf_sumo.texts import LONGEST_ID, is_plain

MALFORMED: Final = (
    *(TypeError, ValueError, AttributeError),
    *(IndexError, OverflowError, RecursionError),
)
"""What code that trusts a file's content raises where that is malformed."""


@dataclass(frozen=True, kw_only=True)
class OneFile:
    """How a format with one scene in a file is read.

    Attributes:
        dataset: the name of the format.
        largest: bytes that a file may have.
        parse: content -> its description. Raises ReaderError with the end of a sentence about the
            file.
        name: description and file -> the scene's id.
        describe: description, name and source -> the raw scene. It and ``name`` raise KeyError for
            a missing key; other errors of malformed values are also caught.
    """

    dataset: str
    largest: int
    parse: Callable[[bytes], Any]
    name: Callable[[Any, Path], str]
    describe: Callable[[Any, str, Source], RawScene]

    def recordings(self, path: Path) -> Iterator[RecordRef]:
        """The file's one recording, named by the file if it has no id that can be read."""
        try:
            content = self._content(path)
            name = self.name(content[0], path)
        except (ReaderError, KeyError, *MALFORMED):
            yield RecordRef(file=path, name=path.stem, record=0)
            return
        if len(name) > LONGEST_ID or not is_plain(name):
            name = path.stem  # the scene is refused for it
        yield RecordRef(file=path, name=name, record=0, content=content)

    def load(self, ref: RecordRef) -> RawScene:
        """The file's scene. Raises ReaderError with the file and the reason."""
        path = ref.file
        described, digest = ref.content or self._content(path)
        source = Source(dataset=self.dataset, file=str(path), record=0, sha256=digest)
        try:
            return self.describe(described, self.name(described, path), source)
        except KeyError as error:
            raise ReaderError(f"{path} is incomplete: it lacks the key {error}.") from None
        except MALFORMED as error:
            raise ReaderError(f"{path} is not a valid scene: {error}.") from None

    def _content(self, path: Path) -> tuple[Any, str]:
        """The description and the digest of a file. Raises ReaderError with the file."""
        try:
            content = files.content(path, self.largest)
            return self.parse(content), hashlib.sha256(content).hexdigest()
        except OSError as error:
            raise ReaderError(f"{path} cannot be read ({files.reason(error)}).") from None
        except ReaderError as error:
            raise ReaderError(f"{path} {error}.") from None


def head(path: Path, count: int) -> bytes | None:
    """The first bytes of a file; None if it cannot be read."""
    try:
        with files.opened(path) as file:
            return file.read(count)
    except OSError:
        return None
