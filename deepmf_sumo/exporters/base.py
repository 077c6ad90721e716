"""What an exporter is: a rollout in a format that other programs read."""

from pathlib import Path
from typing import Protocol

from deepmf_sumo.datatypes import Case, Rollout


class Exporter(Protocol):
    """One format, usually a module.

    Attributes:
        FILE: name of what is written in a run's folder; ends with ``/`` for a folder.
    """

    FILE: str

    def write(self, rollout: Rollout, case: Case, path: Path) -> None:
        """Write a rollout to ``path``; the same rollout gives the same bytes.

        ``path`` appears whole, and replaces what was there: `files.write` and `files.whole_folder`
        do both. Raises OutputError where it cannot be written.
        """
        ...
