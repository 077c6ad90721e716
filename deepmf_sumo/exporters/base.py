"""What an exporter is: a rollout in a format that other programs read."""

from pathlib import Path
from typing import Protocol

from deepmf_sumo.datatypes import Case, Rollout


class Exporter(Protocol):
    """One format."""

    @property
    def suffix(self) -> str:
        """Ending of the file that is written, or ``/`` for a folder."""
        ...

    def write(self, rollout: Rollout, case: Case, path: Path) -> None:
        """Write the rollout to ``path``, which appears whole. Raises OutputError."""
        ...
