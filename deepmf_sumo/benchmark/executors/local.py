"""Processes of this machine."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Final

from deepmf_sumo.benchmark import pool
from deepmf_sumo.benchmark.executors.base import Limits, Work
from deepmf_sumo.benchmark.pool import Finished
from deepmf_sumo.benchmark.tasks import Task

NAME: Final = "local"


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """So many workers."""

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


__all__ = ["NAME", "Local"]
