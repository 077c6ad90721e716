"""Tasks -> result folder.

Runs that a resumed folder has beside those of the command are kept where nothing has changed:
`run a b --out r` and then `run a --out r --resume` leaves the runs of b in the tables. Whether one
is still good is told as for the command's own runs: by the key of its spec, which lies beside it.
"""

import math
import re
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from deepmf_sumo import errors
from deepmf_sumo import spec as spec_module
from deepmf_sumo.errors import DeepmfError, Ending, UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.results import exports, junit, stored
from deepmf_sumo.results import result as result_module
from deepmf_sumo.results.folder import Store, opened
from deepmf_sumo.results.reader import Run
from deepmf_sumo.results.result import IDENTITY, Result
from deepmf_sumo.spec import Expect, Spec
from deepmf_sumo.spec import tasks as tasks_module
from deepmf_sumo.spec.tasks import Draw, Task, is_run_id
from deepmf_sumo.study.sweep import episode, fork, shards, watch
from deepmf_sumo.study.sweep.inputs import Input, fingerprinted, of_exporter
from deepmf_sumo.study.sweep.limits import TIMEOUT_S
from deepmf_sumo.study.sweep.ray_cluster import Cluster
from deepmf_sumo.study.sweep.shards import Shard
from deepmf_sumo.study.sweep.workers import BatchLimits, Executor, Finished, Local


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherRuns:
    """What a folder has beside the runs of a command.

    Attributes:
        before, after: results that are kept, in the tables before and after the command's.
        planned: `result.identity` of these, and of runs of other specs that were never begun.
        keys: of the same. read: what the kept ones read.
        stale: ids of those that are in no table any more: their files or the version changed.
    """

    before: tuple[Result, ...] = ()
    after: tuple[Result, ...] = ()
    planned: dict[str, dict[str, Any]] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    read: tuple[Input, ...] = ()
    stale: tuple[str, ...] = ()

    @property
    def kept(self) -> int:
        """Results that are kept."""
        return len(self.before) + len(self.after)

    @property
    def unbegun(self) -> int:
        """Runs of other specs that have no result."""
        return len(self.keys) - self.kept

    def without(self, tasks: Iterable[Task]) -> "OtherRuns":
        """The same but for runs that turn out to be the command's own."""
        own = {task.run_id for task in tasks}
        return replace(
            self,
            before=tuple(one for one in self.before if one["run_id"] not in own),
            after=tuple(one for one in self.after if one["run_id"] not in own),
            planned={name: one for name, one in self.planned.items() if name not in own},
            keys={name: one for name, one in self.keys.items() if name not in own},
            stale=tuple(one for one in self.stale if one not in own),
        )


def others_kept(store: Store, planned: Sequence[Task]) -> OtherRuns:
    """What the folder has beside the planned runs."""
    mine = {task.run_id for task in planned}
    found = {one["run_id"]: one for one in _results(store, mine)}
    marked, read = fingerprinted([task for one in found.values() for task in _task_of(store, one)])
    good = {task.run_id for task in marked if task.key == found[task.run_id]["key"]}
    order = _order(store.out)
    kept = [one for one in sorted(found, key=lambda one: order.get(one, len(order))) if one in good]
    first = min((order[one] for one in mine if one in order), default=len(order))
    front = [one for one in kept if order.get(one, first) < first]
    unbegun = _unbegun(store.out, planned, found)
    identities = {one: {name: found[one][name] for name in IDENTITY} for one in kept}
    return OtherRuns(
        before=tuple(found[one] for one in front),
        after=tuple(found[one] for one in kept if one not in front),
        planned=identities | {run_id: one for run_id, (_, one) in unbegun.items()},
        keys={one: found[one]["key"] for one in kept}
        | {run_id: key for run_id, (key, _) in unbegun.items()},
        read=read,
        stale=tuple(sorted(found.keys() - good)),
    )


def _results(store: Store, without: Collection[str]) -> Iterable[Result]:
    """All other results in a folder; those of an earlier command without tables, too."""
    for file in sorted(store.runs.glob("*/result.json")):
        if is_run_id(file.parent.name) and file.parent.name not in without:
            try:
                found = store.read_run(file.parent.name)
            except UsageError:  # damaged, or of another version
                continue
            if found["run_id"] == file.parent.name:
                yield found


def _task_of(store: Store, result: Result) -> list[Task]:
    """The run as it would be planned today; none where that cannot be told any more."""
    file = store.runs / result["run_id"] / stored.SPEC
    try:
        spec = spec_module.load(file)
        draw = Draw(**result["draw"]) if "draw" in result else None
    except (DeepmfError, TypeError):  # or what is known of its draw is damaged
        return []
    return [Task(run_id=result["run_id"], spec=spec, scene=result["scene"], draw=draw)]


def _order(out: Path) -> dict[str, int]:
    """Place of each run in the tables."""
    try:
        return {row["run_id"]: number for number, row in enumerate(stored.rows_of(out))}
    except UsageError:
        return {}


def _unbegun(
    out: Path, planned: Sequence[Task], found: Iterable[str]
) -> dict[str, tuple[str, dict[str, Any]]]:
    """Key and identity of runs of the manifest without a result, of specs that are not named now.

    Those of a spec that is named are as this command plans them.
    """
    try:
        keys, identities = stored.keys_of(out), stored.planned_of(out)
    except UsageError:  # no manifest, or a damaged one
        return {}
    named = {task.spec.name for task in planned}
    gone = keys.keys() - {task.run_id for task in planned} - set(found)
    known = {one: identities[one] for one in sorted(gone) if one in identities}
    return {one: (keys[one], who) for one, who in known.items() if who["spec"] not in named}


_ADDRESS: Final = re.compile(r"ray://(\[[0-9a-fA-F:]+\]|[^\s:/]+)(?::(\d{1,5}))?/?")
_NONE: Final = OtherRuns()
_CLIENT_PORT: Final = 10001
"""Of Ray's own for programs outside the cluster."""


def executor_named(text: str = "local", jobs: int | None = None) -> Executor:
    """The executor of the key ``sweep.executor``: ``local``, ``ray`` or ``ray://host:port``.

    Args:
        text: ``ray`` is the cluster that this machine is part of, or a new one of this machine.
        jobs: workers; None is 1 of this machine, and all processors of a cluster.

    Raises UsageError for anything else.
    """
    if text == "local":
        return Local(jobs=jobs or 1)
    if text == "ray":
        return Cluster(jobs=jobs)
    found = _ADDRESS.fullmatch(text)
    if found is None or int(found[2] or 0) > 65535:
        raise UsageError(
            f"sweep.executor {text}: must be local, ray, or ray://HOST:PORT, e.g."
            f" ray://head.example.org:{_CLIENT_PORT}."
        )
    return Cluster(host=found[1].strip("[]"), port=int(found[2] or _CLIENT_PORT), jobs=jobs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a batch is run; nothing here changes its results.

    Attributes:
        out: the result folder.
        name_filter: only runs whose id holds it.
        executor, jobs: what does the runs, and how many at a time, see `batch.executor_named`.
        timeout_s: for one run; None is no limit.
        draw: makes the pictures, by name importable in a worker; None makes none.
        scenes: also write each rollout as a recording.
        sumo: write one folder per run that sumo-gui opens.
        formats: of other programs, in which each run is written once it has ended.
        resume: keep the runs that an earlier, equal batch finished.
        overwrite: delete earlier results in ``out``; with neither they are refused.
        memory_mb: for one worker; None is no limit.
        minutes: after that no run starts; None is no limit.
        shard: only this part of the runs.
    """

    out: Path
    name_filter: str = ""
    executor: str = "local"
    jobs: int | None = None
    timeout_s: float | None = TIMEOUT_S
    draw: episode.Draw | None = None
    gui: bool = False
    junit: bool = False
    scenes: bool = False
    sumo: bool = True
    formats: tuple[exports.Format, ...] = ()
    resume: bool = False
    overwrite: bool = False
    memory_mb: float | None = None
    minutes: float | None = None
    shard: Shard | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """A run has ended (``last``), or none has yet.

    Attributes:
        done: runs that have a result. kept: those of them from an earlier batch.
        lost: runs that are repeated, since their machine was lost.
        again: successful runs of an earlier batch that are repeated, since their spec or version
            differs, or files that they read have changed.
        changed: files that an earlier batch read with other content.
        others, unbegun: runs of other commands in the folder that are kept, and that have no
            result.
        stale: ids of runs of other commands that are in no table any more.
        unwritten: why ``last``, or at first a run that is kept, is missing in a format.
    """

    done: int
    of: int
    kept: int
    lost: int = 0
    again: int = 0
    changed: tuple[str, ...] = ()
    others: int = 0
    unbegun: int = 0
    stale: tuple[str, ...] = ()
    unwritten: tuple[str, ...] = ()
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
    planned = tasks_module.plan(specs, cache_folder(), options.name_filter)
    return run_tasks(planned, options, report)


class More(Protocol):
    """Runs that are decided by the results of those before."""

    @property
    def left(self) -> int:
        """Number of runs that are not decided yet."""
        ...

    def __call__(self, results: Sequence[Result]) -> Sequence[Task]:
        """The next ones, from the results of all before; none at the end."""
        ...


def run_tasks(
    planned: Sequence[Task],
    options: Options,
    report: Callable[[Progress], None] = lambda _: None,
    more: More | None = None,
) -> list[Result]:
    """As `run`, of tasks; tables are in their order.

    ``more`` decides further ones, each time that all before have ended.
    """
    executor_named(options.executor, options.jobs)  # errors show before anything is done
    stop = time.monotonic() + 60.0 * options.minutes if options.minutes else math.inf
    every, read = fingerprinted(planned)
    mine = options.shard.choose(every) if options.shard else every
    with opened(options.out, resume=options.resume, overwrite=options.overwrite) as store:
        others = others_kept(store, mine) if options.resume else OtherRuns()
        left = more.left if more else 0
        changed = begin(store, mine, options, read, others, left)
        shards.note(options.out, every if options.shard else None)
        known = Known(changed=changed, others=others, left=left, read=read)
        results = fill(store, mine, options, report, known=known)
        while more and len(results) == len(mine) and time.monotonic() < stop:
            further, also = fingerprinted(more(results))
            if not further:
                break
            mine, read = [*mine, *further], tuple(dict.fromkeys([*read, *also]))
            others = others.without(further)
            begin(store, mine, options, read, others, more.left)
            minutes = (stop - time.monotonic()) / 60 if options.minutes else None
            known = Known(others=others, before=tuple(results), left=more.left, read=read)
            results = fill(store, mine, replace(options, minutes=minutes), report, known=known)
    return results


def begin(
    store: Store,
    planned: Sequence[Task],
    options: Options,
    read: Sequence[Input],
    others: OtherRuns = _NONE,
    left: int = 0,
) -> tuple[str, ...]:
    """Write the manifest, with what may differ between equal batches in a part of its own.

    ``read`` is what the runs read; ``others`` are runs that the folder has beside them; ``left`` is
    the number of runs that are not decided yet. Returns the files that an earlier batch of the
    folder read with other content.
    """
    before = stored.inputs_of(store.out)
    wrote = [one for form in options.formats for one in of_exporter(form.name)]
    now = {str(one.path): one.digest for one in (*others.read, *read, *wrote)}
    machine = {
        "executor": options.executor,
        "jobs": options.jobs,
        "timeout_s": options.timeout_s,
        "inputs": now,
    }
    store.manifest(
        others.keys | {task.run_id: task.key for task in planned},
        machine,
        others.planned | {task.run_id: result_module.identity(task) for task in planned},
        left,
    )
    return tuple(path for path, got in before.items() if now.get(path, got) != got)


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What a batch knows of its folder before it does runs.

    Attributes:
        changed: that of `begin`. others: runs of other commands.
        before: results of tasks that this batch did earlier, however they ended.
        left: number of runs that are decided later.
        read: what the runs read, as it was when the batch began.
    """

    changed: tuple[str, ...] = ()
    others: OtherRuns = _NONE
    before: tuple[Result, ...] = ()
    left: int = 0
    read: tuple[Input, ...] = ()


def fill(
    store: Store,
    planned: Sequence[Task],
    options: Options,
    report: Callable[[Progress], None] = lambda _: None,
    *,
    queue: Callable[[Task], Any] | None = None,
    known: Known = Known(),
) -> list[Result]:
    """Do the tasks that have no result yet, and write the tables, in a folder with a manifest.

    Runs start in the order of the key ``queue``. The tables have runs of other commands, too; the
    results are of the tasks alone.
    """
    found = {result["run_id"]: result for result in known.before}
    now, kept = _kept(store, [task for task in planned if task.run_id not in found], options, known)
    found |= kept
    left = [task for task in planned if task.run_id not in found]
    if left or known.others.stale:
        store.forget_views()
    if queue:
        left.sort(key=queue)
    elif options.minutes is None:  # with a limit, the runs done must be spread over all moments
        left = fork.in_order(left)
    report(now)
    endings, interrupted = _endings(store, left, options, known.read), True
    try:
        for ending in endings:
            now = _heard(now, store, left[ending.index], ending)
            if now.last:
                found[now.last["run_id"]] = now.last
                now = replace(now, unwritten=tuple(_unwritten(store, options, now.last)))
            report(now)
        interrupted = len(found) < len(planned) + known.left
    finally:
        endings.close()
        store.forget_begun()
        found |= _unheard(store, [task for task in left if task.run_id not in found])
        results = [found[task.run_id] for task in planned if task.run_id in found]
        expects = any(task.spec.expect != Expect() for task in planned)
        junit_too = options.junit or expects or (store.out / junit.FILE).is_file()
        every = [*known.others.before, *results, *known.others.after]
        store.finish(every, junit_too=junit_too, interrupted=interrupted)
    return results


def _kept(
    store: Store, planned: Sequence[Task], options: Options, known: Known
) -> tuple[Progress, dict[str, Result]]:
    """Where the batch stands, and the results that the folder has of tasks that it did not do."""
    before = {task.run_id: result for task in planned if (result := store.earlier(task))}
    kept = {
        task.run_id: before[task.run_id]
        for task in planned
        if task.run_id in before and before[task.run_id]["key"] == task.key
    }
    done, others = len(known.before), known.others if not known.before else _NONE  # said once
    now = Progress(
        done=done + len(kept),
        of=done + len(planned) + known.left,
        kept=len(kept),
        again=len(before) - len(kept),
        changed=known.changed,
        others=others.kept,
        unbegun=others.unbegun,
        stale=others.stale,
        unwritten=tuple(
            one
            for result in kept.values()
            for one in _unwritten(store, options, result, known.changed)
        ),
    )
    return now, kept


def _unwritten(
    store: Store, options: Options, ended: Result, changed: Sequence[str] = ()
) -> Iterator[str]:
    """Write a run in the formats that it is not there in; gives why it could not be.

    Of an exporter whose code is among the ``changed`` files it is written anew.
    """
    if not options.formats or ended["status"] != "ok":
        return
    run = Run.of_row(store.out, result_module.row(ended))
    for form in options.formats:
        path = form.place(run.folder)
        code = {str(one.path) for one in of_exporter(form.name)}
        if path.exists() and code.isdisjoint(changed):  # also if the run itself wrote it, as sumo/
            continue
        made = exports.written(run, path, form)
        if made.outcome == "failed":
            yield f"{run.run_id} is not written as {form.name}: {made.reason}"


def _unheard(store: Store, tasks: Sequence[Task]) -> dict[str, Result]:
    """Runs that succeeded, though an interrupt or their worker's end came before it said so."""
    written = ((task, store.earlier(task)) for task in tasks)
    return {task.run_id: one for task, one in written if one and one["key"] == task.key}


def _heard(before: Progress, store: Store, task: Task, ending: Finished) -> Progress:
    """A task has ended, or will be repeated; its result is what the worker wrote, or the reason.

    A worker may die after it has finished a run, and before it says so: the run counts.
    """
    if ending.status == "lost":
        return replace(before, lost=before.lost + 1, last=None)
    there = (store.runs / task.run_id / stored.RESULT).is_file()
    if not there or (ending.status != "done" and not _unheard(store, [task])):
        status: result_module.Status = "timeout" if ending.status == "timeout" else "failed"
        fault: Literal["crashed", ""] = "crashed" if ending.by_planner else ""
        why = ending.reason or "its worker has left no result"
        reason = result_module.unfinished(task, status, why, ending.seconds, fault)
        episode.finish(store.runs, task, reason)
    return replace(before, done=before.done + 1, last=store.read_run(task.run_id))


def _endings(
    store: Store, left: Sequence[Task], options: Options, read: Sequence[Input]
) -> Generator[Finished, None, None]:
    work = episode.TaskRunner(
        runs=store.runs.absolute(),  # a planner may go to another folder
        cache=cache_folder(),
        draw=options.draw,
        gui=options.gui,
        scenes=options.scenes,
        sumo=options.sumo,
        begun=watch.watched(left, read),
    )
    limits = BatchLimits(
        timeout_s=options.timeout_s, memory_mb=options.memory_mb, minutes=options.minutes
    )
    return executor_named(options.executor, options.jobs).run(work, left, limits)


def exit_code(results: Sequence[Result]) -> int:
    """What the command ends with, see `errors.exit_code`."""
    return errors.exit_code(*endings(results))


def endings(results: Sequence[Result]) -> list[Ending]:
    """How runs ended.

    ``wrong`` where one showed its spec wrong (e.g. damaged weights), ``failed`` where one failed or
    timed out or all were skipped, ``broken`` where an expectation is.
    """
    statuses = {one["status"] for one in results}
    applies: dict[Ending, bool] = {
        "wrong": any(one.get("refused") for one in results),
        "failed": bool(statuses & {"failed", "timeout"}) or statuses == {"skipped"},
        "broken": any(one["expectations_broken"] for one in results),
    }
    return [ending for ending, true in applies.items() if true]
