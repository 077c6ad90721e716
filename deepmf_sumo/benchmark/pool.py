"""Tasks in worker processes that may crash or hang without harm to the others.

Each worker does one task at a time (libsumo is one simulation a process), in its own process group,
so that killing it takes its children along and Ctrl-C reaches the parent alone.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, Literal, TypeVar

from deepmf_sumo.errors import RunError

START_LIMIT_S: Final = 300.0
"""Seconds that a worker may take to load its libraries."""

SINGLE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Sums are the same to the last bit only for the same number of threads; workers are parallel."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """How a task ended; ``raised`` and ``crashed`` with a reason."""

    index: int
    status: Literal["done", "raised", "crashed", "timeout"]
    reason: str = ""
    seconds: float = 0.0


def run(
    work: Callable[[T], None], tasks: Sequence[T], *, jobs: int, timeout_s: float | None
) -> Generator[Finished, None, None]:
    """Do all tasks; yields each as it ends. Closing the iterator kills what still runs.

    ``work`` must be importable by name in a new process; it reports nothing back, but writes its
    result. ``timeout_s`` is for one task, without the start of its worker.

    Raises RunError where a worker does not even start.
    """
    pending = deque(enumerate(tasks))
    workers = [_Worker(work) for _ in range(min(jobs, len(tasks)))]
    try:
        while pending or any(worker.index is not None for worker in workers):
            for worker in workers:
                if worker.ready and worker.index is None and pending:
                    worker.give(*pending.popleft(), timeout_s)
            _wait(workers)
            for place, worker in enumerate(workers):
                finished = worker.look()
                if finished:
                    yield finished
                if not worker.alive and pending:
                    workers[place] = _Worker(work)
            workers = [worker for worker in workers if worker.alive]
    finally:
        for worker in workers:
            worker.kill()


def _wait(workers: Sequence["_Worker"]) -> None:
    """Sleep until a worker says something or one is out of time."""
    due = min(worker.deadline for worker in workers)
    wait([worker.connection for worker in workers], min(max(due - time.monotonic(), 0.0), 60.0))


@dataclass
class _Worker:
    """The parent's side of a worker process."""

    work: Callable[[Any], None]
    ready: bool = False
    alive: bool = True
    index: int | None = None
    began: float = 0.0
    deadline: float = field(default_factory=lambda: time.monotonic() + START_LIMIT_S)

    def __post_init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(
            target=_serve, args=(theirs, self.work, os.getpid()), daemon=True
        )
        with _environment(SINGLE_THREAD):
            self.process.start()
        theirs.close()

    def give(self, index: int, task: object, timeout_s: float | None) -> None:
        self.index, self.began = index, time.monotonic()
        self.deadline = self.began + timeout_s if timeout_s else float("inf")
        with contextlib.suppress(BrokenPipeError):  # it died while idle: `look` finds out
            self.connection.send((task,))

    def look(self) -> Finished | None:
        """What became of its task, if anything."""
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
        return None

    def kill(self) -> None:
        """End the process and its children."""
        self.alive = False
        if self.process.pid and self.process.is_alive():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
        self.process.join()
        self.connection.close()

    def _hear(self, status: Literal["ready", "done", "raised"], reason: str) -> Finished | None:
        if status == "ready":
            self.ready, self.deadline = True, float("inf")
            return None
        return self._finish(status, reason)

    def _dead(self) -> Finished | None:
        self.process.join()
        code = self.process.exitcode or 0
        self.kill()
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        if self.index is None and not self.ready:
            raise RunError(f"A worker process died while it started ({name}); see its message.")
        return None if self.index is None else self._finish("crashed", f"the worker died: {name}")

    def _finish(
        self, status: Literal["done", "raised", "crashed", "timeout"], why: str
    ) -> Finished:
        assert self.index is not None
        index, self.index, self.deadline = self.index, None, float("inf")
        seconds = time.monotonic() - self.began
        return Finished(index=index, status=status, reason=why, seconds=seconds)


def _serve(connection: Connection, work: Callable[[Any], None], parent: int) -> None:
    """A worker's life. ``work`` has been imported by now, and its libraries with it."""
    os.setpgid(0, 0)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    connection.send(("ready", ""))
    while True:
        try:
            (task,) = connection.recv()
        except EOFError:
            return
        try:
            work(task)
        except Exception as error:  # noqa: BLE001 - a task's error must not end the worker
            connection.send(("raised", f"{type(error).__name__}: {error}"))
        else:
            connection.send(("done", ""))


def _end_with(parent: int) -> None:
    """A killed parent cannot end its workers: they notice by themselves."""
    while os.getppid() == parent:
        time.sleep(1.0)
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
