"""What a reader is: recorded file -> scenes."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from deepmf_sumo.datatypes import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A record that cannot be used, and why."""

    file: str
    record: int
    name: str
    reason: str


class Reader(Protocol):
    """One file format."""

    def accepts(self, path: Path) -> bool:
        """Whether the file looks like this format (by its first bytes, not by its name alone)."""
        ...

    def scenes(self, path: Path) -> Iterator[Scene | Refusal]:
        """The file's scenes in order; what cannot be used comes as a Refusal."""
        ...
