"""What a reader is: recorded file -> scenes."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError


class UnknownFormatError(ReaderError):
    """The file is of no format that is known: no recording, as far as can be told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A record that cannot be used, and why."""

    file: str
    record: int
    name: str
    reason: str
    dataset: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordRef:
    """The location of a recorded scene, which `readers.read` reads without a search.

    Attributes:
        name: the scene's id, else the file's name and the record's number.
        record: index of the record in the file.
        reader: the plug-in that reads the file; empty if the file could not be listed to its end.
        offset: position of the record in the file, if the reader is an `IndexedReader`.
    """

    file: Path
    name: str
    record: int
    reader: str = ""
    offset: int | None = None


class Reader(Protocol):
    """One file format. A module with these two functions is a reader too."""

    def accepts(self, path: Path) -> bool:
        """Whether the file looks like this format (by its first bytes, not by its name alone)."""
        ...

    def scenes(self, path: Path) -> Iterator[Scene | Refusal]:
        """The file's scenes in order; unusable records as a Refusal."""
        ...


@runtime_checkable
class IndexedReader(Protocol):
    """A reader of files with many scenes that can read one of them without the others."""

    def records(self, path: Path) -> Iterator[RecordRef]:
        """The locations of the file's scenes in order, whether or not they can be used."""
        ...

    def scene_at(self, ref: RecordRef) -> Scene | Refusal:
        """The scene at a location."""
        ...
