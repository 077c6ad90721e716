"""What an executor is, and the one of this machine."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from deepmf_sumo.benchmark import pool
from deepmf_sumo.benchmark.pool import Finished
from deepmf_sumo.benchmark.tasks import Task


class Work(Protocol):
    """Does a task, and leaves its folder in ``runs``: a dataclass, importable on every machine."""

    @property
    def runs(self) -> Path:
        """The folder of all runs."""

    def __call__(self, task: Task, /) -> None:
        """Do the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Of a batch.

    Attributes:
        timeout_s: for one task; None is no limit.
        memory_mb: of a worker and its children; None is no limit.
        minutes: no task is begun after so many; None is no limit.
    """

    timeout_s: float | None = None
    memory_mb: float | None = None
    minutes: float | None = None


class Executor(Protocol):
    """Does tasks; their folders are in ``work.runs`` of this machine when they have ended."""

    def check(self) -> None:
        """Raise UsageError where it cannot be used, as far as a moment shows."""

    def run(
        self, work: Work, tasks: Sequence[Task], limits: Limits
    ) -> Generator[Finished, Any, None]:
        """Do all tasks; yields each as it ends. Closing the iterator ends what still runs.

        A task whose machine is lost is yielded as ``lost`` and done again.

        Raises RunError where no worker starts.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """Processes of this machine; ``jobs`` at a time."""

    jobs: int = 1

    def check(self) -> None:
        """Nothing can be wrong."""

    def run(
        self, work: Work, tasks: Sequence[Task], limits: Limits
    ) -> Generator[Finished, None, None]:
        """As `pool.run`."""
        return pool.run(
            work,
            tasks,
            jobs=self.jobs,
            timeout_s=limits.timeout_s,
            memory_mb=limits.memory_mb,
            minutes=limits.minutes,
        )


__all__ = ["Executor", "Limits", "Local", "Work"]
