"""Candidates as runs: each is simulated as `deepmf-sumo run` does it, and judged."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.files import cache_folder
from deepmf_sumo.results import findings, quantities, stored, tracks
from deepmf_sumo.results import result as result_module
from deepmf_sumo.results.findings import Worth
from deepmf_sumo.results.result import Result
from deepmf_sumo.scene import DT_S, Floats
from deepmf_sumo.spec import Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.shrink.candidate import Candidate
from deepmf_sumo.study.shrink.failure import RecordedHit
from deepmf_sumo.study.sweep.episode import TaskRunner
from deepmf_sumo.study.sweep.workers import Worker

_TIMEOUT_S: Final = 600.0
_MEMORY_MB: Final = 4096.0
_SPAN: Final = 2
"""Steps on each side of a second difference, as in metrics of motion."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateTrial:
    """What a candidate's simulation showed.

    Attributes:
        candidate: what was tried. values: its spec.
        why: why the opponent did not hit the AV; empty where it did.
        contact: step of the contact, counted from the run's start.
        road_users: that were there up to the contact, with the AV.
        accident: metric ``accident_type``. worth: of the hit; None: not judged.
        feasible: the opponent drove within the limits of a car.
        contact_mps: relative speed at the contact.
        hardest_mps2: largest acceleration of the opponent from the begin to the contact.
        digest: of ``tracks.csv.gz``.
    """

    candidate: Candidate
    values: dict[str, Any]
    why: str = ""
    contact: int = 0
    road_users: int = 0
    accident: float | None = None
    worth: Worth | None = None
    feasible: bool = False
    contact_mps: float = np.inf
    hardest_mps2: float = np.inf
    digest: str = ""

    @property
    def hit(self) -> bool:
        """Whether the opponent hit the AV."""
        return not self.why

    @property
    def steps(self) -> int:
        """From begin to contact."""
        return self.contact - self.candidate.begin


class Simulator:
    """A worker process that does one run after another; use it in a ``with`` block."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="deepmf-sumo-shrink-")
        self._runs = Path(self._folder.name) / "runs"
        self._runs.mkdir()
        self._worker: Worker | None = None
        self.done = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.renew()
        self._folder.cleanup()

    def renew(self) -> None:
        """Let a new process do the next run."""
        if self._worker is not None:
            self._worker.kill()
        self._worker = None

    @contextmanager
    def run(self, task: Task) -> Iterator[tuple[Result, Path]]:
        """The result of a run, and its folder, which is gone after the block."""
        self.done += 1
        if self._worker is None or not self._worker.alive:
            work = TaskRunner(runs=self._runs, cache=cache_folder(), sumo=False)
            self._worker = Worker(work, _TIMEOUT_S, _MEMORY_MB)
        ending = self._worker.do(task)
        folder = self._runs / task.run_id
        if ending.status == "done":
            yield stored.result_of(folder / "result.json"), folder
        else:
            yield result_module.unfinished(task, "failed", ending.reason), folder
        rmtree(folder, ignore_errors=True)


def task_of(failure: RecordedHit, values: dict[str, Any]) -> Task:
    """The run of a spec with the failure's scene."""
    return replace(failure.task, run_id="candidate", spec=Spec.model_validate(values))


def trial(
    simulator: Simulator, failure: RecordedHit, candidate: Candidate, values: dict[str, Any]
) -> CandidateTrial:
    """Simulate a candidate with a spec."""
    with simulator.run(task_of(failure, values)) as (result, folder):
        blank = CandidateTrial(candidate=candidate, values=values)
        if result["status"] != "ok":
            return replace(blank, why=result["error"] or result["status"])
        if result["outcome"] != "av_opponent":
            return replace(blank, why=f"no hit (outcome: {result['outcome']})")
        return _judged(blank, failure, result, folder)


def undisturbed(
    simulator: Simulator, failure: RecordedHit, values: dict[str, Any]
) -> tuple[Floats | None, str]:
    """(N, 3) poses of the opponent from the start on without an attack; or None, and why."""
    with simulator.run(task_of(failure, values)) as (result, folder):
        if result["status"] != "ok":
            return None, result["error"] or result["status"]
        found = tracks.read_tracks(folder / tracks.FILE, [failure.opponent])
        if failure.opponent not in found.tracks.ids:
            return None, f"'{failure.opponent}' is not there without the attack"
        row = found.tracks.row(failure.opponent)
        there = found.tracks.valid[row, found.now :]
        steps = len(there) if there.all() else int(there.argmin())
        shown = slice(found.now, found.now + steps)
        if not steps:
            return None, f"'{failure.opponent}' is not there at the start"
        poses = np.column_stack(
            [found.tracks.position_m[row, shown], found.tracks.heading_rad[row, shown]]
        )
        return poses, ""


def _judged(
    blank: CandidateTrial, failure: RecordedHit, result: Result, folder: Path
) -> CandidateTrial:
    file = folder / tracks.FILE
    found = tracks.read_tracks(file)
    hit = next(one for one in result["contacts"] if one["kind"] == "av_opponent")
    metrics = quantities.values(result)
    shown = slice(found.now, hit["step"] + 1)
    return replace(
        blank,
        contact=blank.candidate.begin + hit["step"] - found.now,
        road_users=int(found.tracks.valid[:, shown].any(axis=1).sum()),
        accident=metrics.get("accident_type"),
        worth=findings.worth(metrics),
        feasible=bool(metrics.get("feasible")),
        contact_mps=float(hit["relative_mps"]),
        hardest_mps2=_hardest(found, failure.opponent, hit["step"]),
        digest=files.sha256(file),
    )


def _hardest(found: tracks.RecordedTracks, agent: str, contact: int) -> float:
    """Largest acceleration of an agent after the current step, up to a step, in m/s2."""
    row = found.tracks.row(agent)
    first = max(found.now - 2 * _SPAN, int(found.tracks.valid[row].argmax()))
    position = found.tracks.position_m[row, first : contact + 1]
    if len(position) <= 2 * _SPAN:
        return 0.0
    second = position[2 * _SPAN :] - 2 * position[_SPAN:-_SPAN] + position[: -2 * _SPAN]
    return float(np.hypot(*second.T).max() / (_SPAN * DT_S) ** 2)
