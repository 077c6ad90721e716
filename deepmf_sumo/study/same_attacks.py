"""Hits of two planners repeated with both, on the paths that the opponents drove.

Runs of two planners differ in more than the planner: an attack answers to what it attacks. So each
hit of both sides is repeated twice, with its own planner and with the other side's, while the
opponent drives the path that it drove. A hit that comes again with its own planner, and not with
the other, is that planner's own.

`results.gate.own_hits` says what own hits mean.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from deepmf_sumo import spec as spec_module
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import stored
from deepmf_sumo.results.gate.own_hits import SameAttacks
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec import Plugin, Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study import shrink
from deepmf_sumo.study.shrink.candidate import AFTER_STEPS, Candidate, path_of, spec_values
from deepmf_sumo.study.sweep import batch

_LONGEST_NAME: Final = 180


class _Hit(NamedTuple):
    """A hit of one side, and its repetitions with its own planner and with the other side's."""

    run_id: str
    own: Task
    other: Task


def repeated(
    new: Path,
    old: Path,
    folder: Path,
    confidence: float,
    jobs: int = 1,
    report: Callable[[batch.Progress], None] = lambda _: None,
) -> SameAttacks:
    """Repeat the hits of two result folders, each with both planners.

    Args:
        new: a result folder.
        old: the baseline's result folder.
        folder: for the repeated runs; those that it has are kept.
        confidence: 1 - ``SameAttacks.level``.
        jobs: runs at a time.
        report: called when a run has ended.

    Raises UsageError where a side is not a result folder, ``folder`` is one of the sides, a run is
    damaged, or the other side does not say which planner to repeat it with; SpecError or
    OutputError before anything is run.
    """
    if folder.resolve() in {new.resolve(), old.resolve()}:
        raise UsageError(f"--same-attacks {folder} holds the results themselves: name another one.")
    sides = _opened(new), _opened(old)
    mine, theirs = [*_hits(*sides, "new")], [*_hits(*sides[::-1], "old")]
    tasks = [task for hit in (*mine, *theirs) for task in (hit.own, hit.other)]
    options = batch.Options(out=folder, jobs=jobs, resume=folder.exists(), sumo=False)
    done = batch.run_tasks(tasks, options, report) if tasks else []
    again = {result["run_id"]: _again(result) for result in done}

    def only(hits: Sequence[_Hit]) -> tuple[str, ...]:
        return tuple(
            hit.run_id for hit in hits if again[hit.own.run_id] and again[hit.other.run_id] is False
        )

    return SameAttacks(
        folder=folder,
        hits=len(mine),
        baseline_hits=len(theirs),
        own=only(mine),
        baseline_own=only(theirs),
        unrepeated=tuple(
            hit.run_id
            for hit in (*mine, *theirs)
            if not again[hit.own.run_id] or again[hit.other.run_id] is None
        ),
        level=1 - confidence,
    )


def _opened(side: Path) -> Results:
    if not side.is_dir():
        raise UsageError(
            f"{side} is a file of --write-baseline: --same-attacks repeats the runs of two result"
            " folders; name the baseline's folder."
        )
    return Results.of(side)


def _hits(side: Results, other: Results, name: str) -> Iterator[_Hit]:
    for run in side.runs:
        if run.part == "main" and run.status == "ok" and run.hit:
            failure = shrink.read(run.folder)
            own = _task(failure, failure.spec.planner, f"{name} own")
            yield _Hit(run.run_id, own, _task(failure, _planner(other, run), f"{name} other"))


def _planner(side: Results, run: Run) -> Plugin:
    """The planner of the side's run of the same id, or the only one of the side."""
    same = [one for one in side.runs if one.run_id == run.run_id]
    specs = [spec_module.load(one.folder / stored.SPEC) for one in same or side.runs[:1]]
    planners = {one.planner for one in side.runs}
    if not specs or (not same and len(planners) > 1):
        raise UsageError(
            f"{side.folders[0]}: no run '{run.run_id}' and not one planner alone, so that it is not"
            " clear with which planner to repeat it; compare runs of the same specs."
        )
    return specs[0].planner


def _task(failure: shrink.RecordedHit, planner: Plugin, name: str) -> Task:
    """The run again with a planner, the opponent on the path that it drove."""
    last = failure.contact + AFTER_STEPS
    candidate = Candidate(last=last, contact=failure.contact, only=None, plans=len(failure.plans))
    values: dict[str, Any] = spec_values(candidate, failure, path_of(candidate, failure, None))
    values |= {"name": f"{name} {failure.run_id[:_LONGEST_NAME]}", "expect": {}}
    spec = Spec.model_validate(values).model_copy(update={"planner": planner})
    run_id = f"{name.replace(' ', '-')}-{failure.run_id}"
    return replace(failure.task, run_id=run_id, spec=spec)


def _again(result: Result) -> bool | None:
    """Whether the opponent hit the AV again; None where the run failed."""
    return result["outcome"] == "av_opponent" if result["status"] == "ok" else None
