"""Tasks in worker processes, which may crash or hang without harm to other tasks.

Each worker does one task at a time (libsumo is one simulation per process), in its own process
group, so that killing it kills its children, too, and Ctrl-C reaches the parent alone.

The parent reads how much memory each worker holds. A limit on address space (RLIMIT_AS) would not
do: torch reserves gigabytes that it never touches.
"""

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final, Literal, Protocol, TypeVar

from deepmf_sumo import system
from deepmf_sumo.errors import RunError
from deepmf_sumo.planners import _checked
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep.spawn import WATCHER

START_LIMIT_S: Final = 300.0
"""Seconds that a worker may take to load its libraries."""

SINGLE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Sums are the same to the last bit only for the same number of threads; workers are parallel."""

_RENEW_AFTER: Final = 50
"""Tasks after which a worker that holds half of its limit is replaced: memory that earlier tasks
left must not count against the next one."""

_LOOK_S: Final = 0.2
"""Between two looks at the memory of the workers."""

_LAST_WORDS_S: Final = 5.0
"""Time for a worker whose connection is closed to end by itself, so that it has an exit code."""

_LEAVE_S: Final = 2.0
"""Time for a worker to end by itself, before it is killed."""

_FROM_OUTSIDE: Final = (-signal.SIGTERM, -9)
"""Ends of a process that others cause, e.g. a system without memory (SIGKILL)."""

Status = Literal["done", "raised", "crashed", "timeout", "memory", "lost"]
T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """How a task ended; all but ``done`` with a reason.

    ``lost`` is not an end: its machine is gone, and another one repeats the task. ``by_planner``:
    the worker died in code of the planner.
    """

    index: int
    status: Status
    reason: str = ""
    seconds: float = 0.0
    by_planner: bool = False


def run(
    work: Callable[[T], None],
    tasks: Sequence[T],
    *,
    jobs: int,
    timeout_s: float | None,
    memory_mb: float | None = None,
    minutes: float | None = None,
) -> Generator[Finished, None, None]:
    """Do all tasks; yields each as it ends. Closing the iterator kills what still runs.

    Args:
        work: importable by name in a new process; writes its result.
        tasks: begun in this order.
        jobs: workers.
        timeout_s: for one task, without the start of its worker.
        memory_mb: of a worker and its children; above it the task is ended.
        minutes: after that no task starts.

    Raises RunError where a worker does not start.
    """
    pending = deque(enumerate(tasks))
    stop = time.monotonic() + 60.0 * minutes if minutes else float("inf")
    workers = [Worker(work, timeout_s, memory_mb) for _ in range(min(jobs, len(tasks)))]
    try:
        while pending or any(worker.index is not None for worker in workers):
            if time.monotonic() >= stop:
                pending.clear()
            for place, worker in enumerate(workers):
                if pending and worker.free and worker.worn:
                    worker.kill()
                    workers[place] = Worker(work, timeout_s, memory_mb)
                elif pending and worker.free:
                    worker.give(*pending.popleft())
            _wait(workers, stop if pending else float("inf"))
            for place, worker in enumerate(workers):
                if finished := worker.look():
                    yield finished
                if not worker.alive and pending:
                    workers[place] = Worker(work, timeout_s, memory_mb)
            workers = [worker for worker in workers if worker.alive]
    finally:
        for worker in workers:
            worker.kill()


def _wait(workers: Sequence["Worker"], stop: float) -> None:
    """Sleep until a worker sends something, one is out of time, or its memory is due for a look."""
    due = min(stop, *(worker.deadline for worker in workers))
    most = _LOOK_S if any(worker.memory_mb for worker in workers) else 60.0
    connections = [worker.connection for worker in workers]
    wait(connections, min(max(due - time.monotonic(), 0.0), most))


@dataclass
class Worker:
    """The parent's side of a worker process; raises RunError where that does not start.

    Attributes:
        work: importable by name in a new process.
        timeout_s: for one task. memory_mb: of the process and its children.
        ready: it has loaded its libraries.
        alive: it has not been ended, nor found dead.
        index: of its task, None without one. given: number of tasks so far.
        began, deadline: of its task, on the monotonic clock.
        in_planner: whether code of the planner runs; shared with the process.
    """

    work: Callable[[Any], None]
    timeout_s: float | None
    memory_mb: float | None
    ready: bool = False
    alive: bool = True
    index: int | None = None
    given: int = 0
    began: float = 0.0
    deadline: float = field(default_factory=lambda: time.monotonic() + START_LIMIT_S)

    def __post_init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.in_planner = context.RawArray("b", 1)
        self.process: BaseProcess = context.Process(
            target=_serve,
            args=(theirs, self.work, os.getpid(), self.in_planner),
            daemon=system.COPIES,  # what is one cannot start processes, see `spawn`
        )
        resource_tracker.ensure_running()  # starting it would let interrupts through
        with _environment(SINGLE_THREAD), system.interrupts_held_back():
            self.process.start()
        theirs.close()

    @property
    def free(self) -> bool:
        """Whether it waits for a task."""
        return self.ready and self.index is None

    @property
    def worn(self) -> bool:
        """Whether many tasks have left it with much memory."""
        return self.given >= _RENEW_AFTER and self._holds_more_than(0.5)

    def give(self, index: int, task: object) -> None:
        """Give it a task; only while it is `free`."""
        self.given += 1
        self.index, self.began = index, time.monotonic()
        self.deadline = self.began + self.timeout_s if self.timeout_s else float("inf")
        with contextlib.suppress(BrokenPipeError):  # it died while idle: `look` notices
            self.connection.send((task,))

    def do(self, task: object) -> Finished:
        """Give it a task as soon as it is free, and wait for its end."""
        given = False
        while True:
            if self.free and not given:
                self.give(0, task)
                given = True
            _wait([self], float("inf"))
            if finished := self.look():
                return finished

    def look(self) -> Finished | None:
        """How its task ended; None while it runs."""
        try:
            if self.connection.poll():
                return self._hear(*self.connection.recv())
        except (EOFError, ConnectionError):
            return self._dead()
        if time.monotonic() >= self.deadline:
            if self.index is None and not self.ready:
                self.kill()
                raise RunError(f"A worker did not start within {START_LIMIT_S:g} s.")
            self.kill()
            return self._finish("timeout", f"longer than {self.deadline - self.began:g} s")
        if self.index is not None and self._holds_more_than(1.0):
            self.kill()
            return self._finish("memory", f"more than {self.memory_mb:g} MB of memory")
        return None

    def _holds_more_than(self, share: float) -> bool:
        """Of the limit."""
        if not self.memory_mb or not self.process.pid:
            return False
        return system.holds_more_than(share * self.memory_mb, self.process.pid)

    def kill(self) -> None:
        """End the process and its children, which outlive a worker that died by itself."""
        if not self.alive:
            return
        self.alive = False
        if self.process.pid and not system.GROUPS:  # later nobody knows what it has started
            system.kill_group(self.process.pid)
        self.process.terminate()  # while a copy of it does a run, it ends what the copy has started
        self.process.join(_LEAVE_S)
        if self.process.pid and system.GROUPS:
            system.kill_group(self.process.pid)
        self.process.kill()
        self.process.join()
        self.connection.close()

    def _hear(self, status: Literal["ready", "done", "raised"], reason: str) -> Finished | None:
        if status == "ready":
            self.ready, self.deadline = True, float("inf")
            return None
        return self._finish(status, reason)

    def _dead(self) -> Finished | None:
        end = time.monotonic() + _LAST_WORDS_S
        while self.process.is_alive() and time.monotonic() < end:
            time.sleep(0.01)  # `join` waits for ever where a hostile planner has closed its files
        self.kill()
        code = self.process.exitcode or 0
        name = system.ending(code)
        if self.index is None and not self.ready:
            raise RunError(f"A worker process died while it started ({name}); see its message.")
        if self.index is None:
            return None
        if self.in_planner[0] and code not in _FROM_OUTSIDE:
            return self._finish("crashed", str(_checked.ended(name)), by_planner=True)
        return self._finish("crashed", f"the worker died: {name}")

    def _finish(self, status: Status, why: str, *, by_planner: bool = False) -> Finished:
        assert self.index is not None
        index, self.index, self.deadline = self.index, None, float("inf")
        seconds = time.monotonic() - self.began
        return Finished(
            index=index, status=status, reason=why, seconds=seconds, by_planner=by_planner
        )


def _serve(
    connection: Connection, work: Callable[[Any], None], parent: int, in_planner: _checked.Flag
) -> None:
    """A worker's life. ``work`` has been imported by now, and its libraries with it."""
    _checked.share(in_planner)
    if sys.stderr is not None:
        faulthandler.enable()  # a run's log shows where it died
    system.own_group()
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # discards signals from before it had its own group
    system.let_interrupts_through()
    system.end_with_parent()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(parent,), name=WATCHER, daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):  # until the parent hangs up, or is killed
        connection.send(("ready", ""))
        while True:
            (task,) = connection.recv()
            connection.send(_done(work, task))


def _done(work: Callable[[Any], None], task: object) -> tuple[Status, str]:
    """Do a task; how it ended."""
    try:
        work(task)
    except Exception as error:  # noqa: BLE001 - a task's error must not end the worker
        return "raised", f"{type(error).__name__}: {error}"
    return "done", ""


def _end_with(parent: int) -> None:
    """End this process when the parent is gone: a killed parent cannot do so.

    Where the system sends it a signal then, it has time to end what its copies have started.
    """
    system.wait_for_parent(parent)
    if system.COPIES:
        time.sleep(_LEAVE_S)
    os._exit(1)


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class Work(Protocol):
    """Does a task and leaves its folder in ``runs``: a dataclass, importable on every machine."""

    @property
    def runs(self) -> Path:
        """The folder of all runs."""

    def __call__(self, task: Task, /) -> None:
        """Do the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchLimits:
    """Limits of a batch.

    Attributes:
        timeout_s: for one task; None is no limit.
        memory_mb: of a worker and its children; None is no limit.
        minutes: after that no task starts; None is no limit.
    """

    timeout_s: float | None = None
    memory_mb: float | None = None
    minutes: float | None = None


class Executor(Protocol):
    """Does tasks; their folders are in ``work.runs`` of this machine when they have ended."""

    def check(self) -> None:
        """Raise UsageError where it cannot be used, as far as a moment shows."""

    def run(
        self, work: Work, tasks: Sequence[Task], limits: BatchLimits
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
        """Always usable."""

    def run(
        self, work: Work, tasks: Sequence[Task], limits: BatchLimits
    ) -> Generator[Finished, None, None]:
        """As `workers.run`."""
        return run(
            work,
            tasks,
            jobs=self.jobs,
            timeout_s=limits.timeout_s,
            memory_mb=limits.memory_mb,
            minutes=limits.minutes,
        )
