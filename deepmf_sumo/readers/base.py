"""What a reader is: recorded file -> scenes."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from deepmf_sumo.datatypes import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A record that cannot be used, and why."""

    file: str
    record: int
    name: str
    reason: str
    dataset: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a scene lies in a file: its id, its number, and where its record begins.

    A record without an id is named by its file and number, so that it is not lost silently.
    """

    name: str
    record: int
    offset: int


class Reader(Protocol):
    """One file format. A module with these two functions is a reader too."""

    def accepts(self, path: Path) -> bool:
        """Whether the file looks like this format (by its first bytes, not by its name alone)."""
        ...

    def scenes(self, path: Path) -> Iterator[Scene | Refusal]:
        """The file's scenes in order; what cannot be used comes as a Refusal."""
        ...


@runtime_checkable
class IndexedReader(Protocol):
    """What a reader of files with many scenes offers besides: one scene without the others."""

    def places(self, path: Path) -> Iterator[Place]:
        """Where the file's scenes lie, in order, whether or not they can be used."""
        ...

    def scene_at(self, path: Path, place: Place) -> Scene | Refusal:
        """The scene at a place."""
        ...
