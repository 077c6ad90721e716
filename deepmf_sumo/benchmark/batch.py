"""Specs -> result folder."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepmf_sumo.benchmark import episode, pool, result, tasks
from deepmf_sumo.benchmark.home import cache_folder
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.store import Store, open_folder
from deepmf_sumo.benchmark.tasks import Task
from deepmf_sumo.spec import Expect, Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a batch is run; nothing here changes its results.

    Attributes:
        out: the result folder.
        name_filter: only runs whose id holds it.
        timeout_s: for one run; None is no limit.
        draw: makes the pictures, by name importable in a worker; None makes none.
        scenes: also write each rollout as a recording.
        sumo: write a folder a run that sumo-gui opens.
        resume: keep the runs that an earlier, equal batch finished.
        memory_mb: for one worker; None is no limit.
        minutes: no run is begun after so many; None is no limit.
    """

    out: Path
    name_filter: str = ""
    jobs: int = 1
    timeout_s: float | None = 600.0
    draw: episode.Draw | None = None
    gui: bool = False
    junit: bool = False
    scenes: bool = False
    sumo: bool = True
    resume: bool = False
    memory_mb: float | None = None
    minutes: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """A run has ended (``last``), or none has yet."""

    done: int
    of: int
    kept: int
    last: Result | None = None


def run(
    specs: Sequence[Spec],
    options: Options,
    report: Callable[[Progress], None] = lambda _: None,
) -> list[Result]:
    """Run all tasks of the specs and write the result folder; results in the order of the tasks.

    An interrupt leaves the finished runs and their tables behind and is passed on. Raises SpecError
    or OutputError before anything runs.
    """
    planned = tasks.plan(specs, cache_folder(), options.name_filter)
    return run_tasks(planned, options, report)


def run_tasks(
    planned: Sequence[Task],
    options: Options,
    report: Callable[[Progress], None] = lambda _: None,
    *,
    queue: Callable[[Task], Any] | None = None,
) -> list[Result]:
    """As `run`; tables are in the order of ``planned``, runs begin in that of the key ``queue``."""
    store = open_folder(options.out, resume=options.resume)
    store.begin(planned, {"jobs": options.jobs, "timeout_s": options.timeout_s})
    found = {task.run_id: kept for task in planned if (kept := store.result(task))}
    left = [task for task in planned if task.run_id not in found]
    if queue:
        left.sort(key=queue)
    kept_runs, interrupted = len(found), True
    report(Progress(done=kept_runs, of=len(planned), kept=kept_runs))
    endings = _endings(store, left, options)
    try:
        for ending in endings:
            task = left[ending.index]
            found[task.run_id] = last = _result(store, task, ending)
            report(Progress(done=len(found), of=len(planned), kept=kept_runs, last=last))
        interrupted = len(found) < len(planned)
    finally:
        endings.close()
        results = [found[task.run_id] for task in planned if task.run_id in found]
        expects = any(task.spec.expect != Expect() for task in planned)
        store.finish(results, junit_too=options.junit or expects, interrupted=interrupted)
    return results


def _endings(
    store: Store, left: Sequence[Task], options: Options
) -> Generator[pool.Finished, None, None]:
    work = episode.Episode(
        runs=store.runs,
        cache=cache_folder(),
        draw=options.draw,
        gui=options.gui,
        scenes=options.scenes,
        sumo=options.sumo,
    )
    return pool.run(
        work,
        left,
        jobs=options.jobs,
        timeout_s=options.timeout_s,
        memory_mb=options.memory_mb,
        minutes=options.minutes,
    )


def _result(store: Store, task: Task, ending: pool.Finished) -> Result:
    """What the worker wrote, or why it could not."""
    if ending.status != "done":
        status: result.Status = "timeout" if ending.status == "timeout" else "failed"
        lost = result.unfinished(task, status, ending.reason, ending.seconds)
        episode.finish(store.runs, task, lost)
    return store.read(task)


def exit_code(results: Sequence[Result]) -> int:
    """What the command ends with.

    2 where a run showed its spec wrong (e.g. damaged weights), else 3 where one failed or timed
    out, or every one was skipped, else 1 where an expectation is broken, else 0.
    """
    statuses = {one["status"] for one in results}
    if any(one.get("refused") for one in results):
        return 2
    if statuses & {"failed", "timeout"} or statuses == {"skipped"}:
        return 3
    return int(any(one["expectations_broken"] for one in results))
