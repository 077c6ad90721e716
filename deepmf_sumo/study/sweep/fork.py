"""Runs in copies of a worker.

SUMO is started in copies alone, never in the worker itself: a second SUMO of one process need not
move vehicles as the first did, since some of its decisions depend on the order of memory addresses
(seen with SUMO 1.28 on a real network). The runs of one passage through a network's traffic are
done by one copy, the passage's process. It need not restart SUMO for each: `sumo.simulation.hold`
advances SUMO to the moment, and a copy of that process does the run. Runs with a planner or an
adversary from outside this package are done in copies, too: their changes to the process do not
reach the next run. Each process repeats how its copy ended: it raises what the copy raised, and
dies as the copy died, unless a planner caused it. All processes that a copy leaves behind are
ended.
"""

import contextlib
import functools
import gc
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, NoReturn, TypeVar

from deepmf_sumo import system
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.planners import _checked
from deepmf_sumo.scene import Case, RecordedCase, TrafficCase, VehicleModel
from deepmf_sumo.spec import FromNetwork
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import spawn
from deepmf_sumo.study.sweep.streams import logged
from deepmf_sumo.sumo import simulation


@dataclass(frozen=True, slots=True, kw_only=True)
class ForkedWork:
    """What is done for a task: its case, and the run."""

    case: Callable[[], Case]
    run: Callable[[], None]


WorkOf = Callable[[Task], ForkedWork]
T = TypeVar("T")
_is_copy = False
_models: dict[Any, VehicleModel | None] = {}  # of passages: what their planner asks SUMO for
_unfit: set[Any] = set()  # passages on which SUMO cannot be held, or not be copied


def passage(task: Task) -> tuple[Any, ...] | None:
    """What the runs of one passage through a network's traffic have in common; else None."""
    spec, source = task.spec, task.spec.source
    if not isinstance(source, FromNetwork):
        return None
    return source.network, source.sumo_options, spec.seed, spec.planner.model_dump_json()


def in_order(tasks: Sequence[Task]) -> list[Task]:
    """The runs of a passage in the order of their moments, at the position of its first."""
    first: dict[Any, int] = {}
    keys = []
    for number, task in enumerate(tasks):
        what, source = passage(task), task.spec.source
        place = number if what is None else first.setdefault(what, number)
        start_s = source.start_s if isinstance(source, FromNetwork) else 0.0
        keys.append((place, start_s, number))
    return [tasks[number] for _, _, number in sorted(keys)]


def pass_on(task: Task, work_of: WorkOf, load: Callable[[], object]) -> bool:
    """Do a task's work in the process of its passage; ``load`` loads what all copies share.

    False: nothing was done, since the task is not on a network, or this process has threads, which
    copies lack.
    """
    global _passage  # noqa: PLW0603
    what, source = passage(task), task.spec.source
    if what is not None and not system.COPIES:
        _spawned(work_of(task).run)
        return True
    if what is None or not isinstance(source, FromNetwork) or not _alone():
        end_passage()
        return False
    if _passage is None or _passage.what != what or _passage.start_s > source.start_s:
        end_passage()
        _quietly(load)
        if not _alone():
            return False
        _passage = _Passage(what, work_of)
    _passage.start_s = source.start_s
    _passage.do(task)
    return True


def end_passage() -> None:
    """End the process of the last passage, if there is one."""
    global _passage  # noqa: PLW0603
    if _passage is not None:
        _passage.end()
    _passage = None


def _quietly(load: Callable[[], object]) -> None:
    """Load something; where that fails, the run itself reports it."""
    with contextlib.suppress(Exception), logged(Path(os.devnull)):
        load()


def note_model(task: Task, model: VehicleModel | None) -> None:
    """Remember the vehicle model of a task's planner: it is the same in its passage."""
    what = passage(task)
    if what is not None:
        _models[what] = model


def apart(load: Callable[[], object], work: Callable[[], None]) -> bool:
    """Do a task's work in a copy of this process; ``load`` loads what all copies share.

    False: nothing was done, since the process has threads, which copies lack.
    """
    if not system.COPIES:
        _spawned(work)
        return True
    end_passage()
    _quietly(load)
    if not _alone():
        return False
    _copied(work)
    return True


class _Passage:
    """The process that does the runs of one passage, seen from the worker.

    Attributes:
        start_s: moment of the last run; earlier ones need another process.
    """

    def __init__(self, what: object, work_of: WorkOf) -> None:
        self.what, self.start_s = what, -math.inf
        pipe: tuple[Any, Any] = multiprocessing.Pipe()  # of other types on Windows
        self._pipe, theirs = pipe
        here = os.getpid()
        with _frozen():
            self._pid = system.fork()
            if self._pid == 0:
                self._pipe.close()
                _serve(theirs, work_of, here)
        theirs.close()

    def do(self, task: Task) -> None:
        """Raises what the run raised; dies as the process died."""
        try:
            with _leaving_none():
                self._pipe.send(task)
                said = self._pipe.recv()
        except (EOFError, OSError):
            _, status = os.waitpid(self._pid, 0)
            self.end()
            system.end_as(os.waitstatus_to_exitcode(status))
        if said is not None:
            raise said

    def end(self) -> None:
        """End the process; it ends SUMO first, whose files are deleted."""
        self._pipe.close()
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self._pid, 0)
        system.end_all(self._pid)


_passage: _Passage | None = None  # of this worker: at most one at a time


def _serve(pipe: Connection, work_of: WorkOf, parent: int) -> NoReturn:
    """The life of a passage's process: does tasks until the worker hangs up."""
    _begin_life(parent)
    with contextlib.suppress(EOFError, OSError):
        while True:
            task = pipe.recv()
            said = None
            try:
                _in_passage(task, work_of(task))
            except Exception as error:  # noqa: BLE001 - raised again in the worker
                said = error
            pipe.send(said)
    _release()
    os._exit(0)


def _in_passage(task: Task, work: ForkedWork) -> None:
    """Do a run in a copy of this process: SUMO is at its moment, or is started by the copy.

    A first run tells what vehicle model its planner asks SUMO for.
    """
    what = passage(task)
    if what in _models and what not in _unfit and _alone():
        if _held(work.case, _models[what]):
            _copied(work.run)
            return
        _unfit.add(what)  # not tried again: SUMO would simulate up to each moment twice
    _release()
    if _alone():
        _copied(work.run)
    else:
        work.run()


def _release() -> None:
    """End the SUMO that is held; what it prints then (its statistics) belongs to no run."""
    with logged(Path(os.devnull)):
        simulation.release()


def _held(make_case: Callable[[], Case], model: VehicleModel | None) -> bool:
    """Whether SUMO is at the moment and can be copied: it may have threads."""
    with contextlib.suppress(DeepmfError), logged(Path(os.devnull)):  # the run itself reports it
        case = make_case()
        if isinstance(case, TrafficCase):
            simulation.hold(case, model)
            return _alone()
    return False


def _alone() -> bool:
    """Whether a copy of this process is complete: threads are not copied."""
    if not system.COPIES:
        return False
    threads = threading.enumerate()
    known = all(one is threading.main_thread() or one.name == spawn.WATCHER for one in threads)
    return known and system.threads_of_this_process() == len(threads)


def tried(task: Task, simulate: Callable[[], T], case: Case) -> T:
    """What an episode returns, one of several of a run: in a copy with SUMO at the moment.

    So SUMO gets there once for all of them. The road of ``case`` is shared, not copied. Where this
    process is not a copy itself, or has threads, the episode is simulated here; that of a recording
    is in a copy anyway, so that the attack begins in the same process as its unattacked episode.
    """
    if not system.COPIES:
        alone = _is_copy or isinstance(case, RecordedCase)
        return _spawned(simulate, case.road) if alone else simulate()
    if isinstance(case, RecordedCase):
        return _copied(simulate, case.road) if _alone() else simulate()
    if not _is_copy or not _alone():
        return simulate()
    what = passage(task)
    if what in _models and not _held(lambda: case, _models[what]):
        _release()
    return _copied(simulate, case.road) if _alone() else simulate()


@contextlib.contextmanager
def tries() -> Iterator[None]:
    """While episodes are `tried`; the SUMO that is held for them ends with it."""
    try:
        yield
    finally:
        if _is_copy:
            _release()


def _copied(work: Callable[[], T], shared: object = None) -> T:
    """Do the work in a copy; returns what it returns, raises what it raised, dies as it died.

    ``shared``: an object that both have already.
    """
    here = os.getpid()
    with os.fdopen(system.memory_file("answer"), "w+b") as answer:  # on no disk that may be full
        with _leaving_none(), _frozen():
            pid = system.fork()
            if pid == 0:
                _work(work, answer, here, shared)
            _, status = os.waitpid(pid, 0)
            system.end_all(pid)
        answer.seek(0)
        said = answer.read()
    code = os.waitstatus_to_exitcode(status)
    models, found = _told(spawn.ProcessEnd(said, code, _checked.at_work()), shared)
    _models.update(models)
    return found


def _spawned(work: Callable[[], T], shared: object = None) -> T:
    """As `_copied`, in a new process: the work must be picklable."""
    ended = spawn.run(functools.partial(_as_copy, work), shared)
    return _told(ended, shared)


def _as_copy(work: Callable[[], T]) -> T:
    """Work in a new process, which is used as a copy is."""
    global _is_copy  # noqa: PLW0603
    _is_copy = True
    return work()


def _told(ended: spawn.ProcessEnd, shared: object) -> Any:
    """What a process returned; raises what it raised, dies as it died."""
    if not ended.answer and ended.blamed:
        raise _checked.ended(system.ending(ended.code))
    if not ended.answer:
        system.end_as(ended.code)
    found = spawn.unpacked(ended.answer, shared)
    if isinstance(found, Exception):
        raise found
    return found


@contextlib.contextmanager
def _frozen() -> Iterator[None]:
    """Else the first garbage collection of a copy touches, and so copies, all memory."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def _leaving_none() -> Iterator[None]:
    """While a copy works: a signal that ends this process ends the copy and its descendants."""
    system.become_subreaper()
    before = signal.signal(signal.SIGTERM, _leave)
    system.end_with_parent(signal.SIGTERM)
    try:
        yield
    finally:
        system.end_with_parent()
        signal.signal(signal.SIGTERM, before)


def _leave(number: int, frame: object) -> NoReturn:  # noqa: ARG001 - as `signal` wants it
    for child in system.children():
        system.end_all(child)
    os._exit(1)


def _work(work: Callable[[], object], answer: IO[bytes], parent: int, shared: object) -> NoReturn:
    """What the copy does; it ends the process."""
    _begin_life(parent)
    code, said = 1, b""
    try:
        found = work()
        code, said = 0, spawn.packed((_models, found), shared)
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else 1
    except Exception as error:  # noqa: BLE001 - raised again in the waiting worker
        said = spawn.packed(error, shared)
    finally:
        with contextlib.suppress(OSError, ValueError):  # a hostile planner may have closed it
            answer.write(said)
            answer.flush()
        os._exit(code)


def _begin_life(parent: int) -> None:
    """As a copy begins: in a group of its own, so that all of it can be ended together."""
    global _is_copy  # noqa: PLW0603
    _is_copy = True
    multiprocessing.current_process().daemon = False  # a planner may start processes: all are ended
    system.own_group()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    system.end_with_parent()
    if not system.is_child_of(parent):
        os._exit(1)
