"""Tasks on the machines of a Ray cluster (extra `cluster`).

Each `WorkerActor` is a process of Ray's that watches one worker process, as `workers.run` does on
this machine. So a crash, a hang or too much memory costs one task there, too, and never the actor.
"""

import contextlib
import importlib
import io
import os
import shutil
import signal
import socket
import sys
import tarfile
import tempfile
import time
from collections import Counter, deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo.errors import DeepmfError, PluginError, RunError, UsageError
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep.inputs import Input, inputs_of, lacking
from deepmf_sumo.study.sweep.workers import START_LIMIT_S, BatchLimits, Finished, Work, Worker
from deepmf_sumo.sumo.network import sumo_tools

POLL_S: Final = 0.5
"""Longest time of a poll, and so until an actor stops."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeState:
    """The machine that started the sweep: what it has, the others must have, too.

    Attributes:
        version: of the program. sumo: its version of SUMO.
        folder: working folder. modules: other folders with modules of the user's.
        environment: variables that name folders.
        inputs: files of the tasks.
    """

    version: str
    sumo: str
    folder: Path
    modules: tuple[str, ...]
    environment: dict[str, str]
    inputs: tuple[Input, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What an actor answers.

    Attributes:
        refusal: why the machine cannot be used, its name first; else empty.
        finished: how the task ended; None while it runs.
        files: its folder as a tar archive, complete or not; empty where there is none.
    """

    refusal: str = ""
    finished: Finished | None = None
    files: bytes = b""


class WorkerActor:
    """The actor. Its methods are called one at a time."""

    def __init__(self, node: NodeState, work: Any, limits: BatchLimits) -> None:
        self._node, self._limits = node, limits
        self._runs = Path(tempfile.mkdtemp(prefix="deepmf-sumo-"))
        self._work = replace(work, runs=self._runs)
        self._given: tuple[int, Task] | None = None
        self._worker: Worker | None = None

    def start(self) -> Answer:
        """Prepare this machine like the one that asks, or say what it lacks; start the worker."""
        node = self._node
        what = lacking(node.inputs)
        if deepmf_sumo.__version__ != node.version:
            what = f"has deepmf-sumo {deepmf_sumo.__version__}, not {node.version}"
        elif sumo_tools.version() != node.sumo:
            what = f"has SUMO {sumo_tools.version()}, not {node.sumo}"
        elif not node.folder.is_dir():
            what = f"has no {node.folder}, the working folder"
        if what:
            return Answer(refusal=f"{socket.gethostname()} {what}")
        os.environ.update(node.environment)
        os.chdir(node.folder)
        sys.path += [name for name in node.modules if name not in sys.path]
        with contextlib.suppress(AttributeError):  # workers would import Ray's main program
            del sys.modules["__main__"].__file__
        self._worker = self._new()
        return Answer()

    def ping(self) -> Answer:
        """Answered by every actor whose machine still works."""
        return Answer()

    def poll(self, task: tuple[int, Task] | None = None) -> Answer:
        """Start a task, or wait for the one that runs; returns when it ends, or after `POLL_S`."""
        self._given = task or self._given
        end = time.monotonic() + POLL_S
        while time.monotonic() < end:
            worker = self._ready()
            left = min(end, worker.deadline) - time.monotonic()
            wait([worker.connection], min(max(left, 0.0), 0.2))
            if finished := worker.look():
                return Answer(finished=finished, files=self._taken())
        return Answer()

    def stop(self) -> None:
        """End the worker and its children."""
        if self._worker:
            self._worker.kill()
        shutil.rmtree(self._runs, ignore_errors=True)

    def _ready(self) -> Worker:
        """The worker, a new one where it is dead or worn; with the task, as soon as it is free."""
        assert self._worker is not None
        if self._worker.free and self._worker.worn:
            self._worker.kill()
        if not self._worker.alive:
            self._worker = self._new()
        if self._given and self._worker.free:
            self._worker.give(*self._given)
            self._given = None
        return self._worker

    def _new(self) -> Worker:
        return Worker(self._work, self._limits.timeout_s, self._limits.memory_mb)

    def _taken(self) -> bytes:
        """The files of the task, which are removed here."""
        folders = list(self._runs.iterdir())
        archive = packed(self._runs) if folders else b""
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
        return archive


def packed(folder: Path) -> bytes:
    """The content of a folder as a tar archive."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for path in sorted(folder.iterdir()):
            archive.add(path, path.name)
    return buffer.getvalue()


def unpack(archive: bytes, runs: Path) -> None:
    """Put the folders of an archive into ``runs``, each whole or not at all."""
    beside = runs / ".arriving"  # always this name, so that the next call cleans up after a kill
    shutil.rmtree(beside, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(beside, filter="data")
    for folder in beside.iterdir():
        place = runs / folder.name
        if place.exists():
            shutil.rmtree(place)
        folder.rename(place)
    beside.rmdir()


_CONNECT_S: Final = 5.0
"""Ray itself tries for half a minute to reach an address without a server."""

_TRIES: Final = 3
"""A task that was running each time its machine was lost may be the cause."""

_MOST_JOINS: Final = 3
"""Attempts to join a cluster that says that it is busy."""

_BUSY: Final = "client server failed"
"""Ray's words where the process that serves a program was not up in time, as on a busy machine."""

_SILENT: Final = "connection timeout"
"""Ray's words where its server does not answer, as to a program without its token."""

_MODE: Final = "RAY_AUTH_MODE"
_TOKEN: Final = Path(".ray") / "auth_token"
"""In the home folder."""

_LONGEST_CAUSE: Final = 300
"""Characters of Ray's message that are shown, from its end."""

_ENVIRONMENT: Final = (
    "DEEPMF_SUMO_DEVICE",
    "DEEPMF_SUMO_HOME",
    "DEEPMF_SUMO_RUNTIME",
    "XDG_DATA_HOME",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cluster:
    """All processors of a cluster, or ``jobs`` of them.

    Attributes:
        host, port: of its server for programs outside it; without a host it is the cluster that
            this machine is part of, or a new one of this machine alone.
    """

    host: str | None = None
    port: int = 0
    jobs: int | None = None

    @property
    def name(self) -> str:
        """As on the command line."""
        return f"ray://{_bracketed(self.host)}:{self.port}" if self.host else "ray"

    def check(self) -> None:
        """As `Executor.check`: PluginError without Ray, UsageError without a server."""
        if self.host:
            _offer_token()
        _ray()
        if self.host:
            self._check_address(self.host)

    def run(
        self, work: Work, tasks: Sequence[Task], limits: BatchLimits
    ) -> Generator[Finished, None, None]:
        """As `Executor.run`.

        Raises PluginError where Ray is not installed, UsageError where no server answers or a
        machine lacks what the tasks need, RunError where no machine takes them.
        """
        stop = time.monotonic() + 60.0 * limits.minutes if limits.minutes else float("inf")
        if not tasks:
            return
        ray = self._connected()
        try:
            slots = min(self.jobs or int(ray.cluster_resources().get("CPU", 1)), len(tasks))
            actors = _Actors(ray=ray, work=work, tasks=tasks, limits=limits, slots=max(slots, 1))
            try:
                yield from actors.all_done(stop)
            except ConnectionError as error:
                raise RunError(
                    f"The connection to the Ray cluster '{self.name}' is lost ({error});"
                    " --resume goes on."
                ) from None
            finally:
                with contextlib.suppress(ConnectionError):
                    actors.stop()
        finally:
            ray.shutdown()

    def _connected(self) -> Any:
        """The module, connected to the cluster."""
        self.check()
        ray = _ray()
        kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            refusal = _BUSY
            for _ in range(_MOST_JOINS):
                if _BUSY in refusal:
                    refusal = self._refusal(ray)
        finally:
            for number, handler in kept.items():  # Ray's own for SIGTERM loses the tables
                signal.signal(number, handler)
        if refusal:
            cause = (
                refusal if len(refusal) <= _LONGEST_CAUSE else f"... {refusal[-_LONGEST_CAUSE:]}"
            )
            hint = _of_tokens() if _SILENT in refusal else ""
            raise UsageError(f"The Ray cluster '{self.name}' cannot be joined: {cause}{hint}")
        return ray

    def _refusal(self, ray: Any) -> str:
        """Join the cluster; why that failed, or empty."""
        joined = ray.is_initialized()
        try:
            ray.init(address=self.name if self.host else None, **_quiet(new=not self.host))
        except Exception as error:  # noqa: BLE001 - Ray raises errors of many libraries
            if not joined:
                with contextlib.suppress(Exception):
                    ray.shutdown()
            return " ".join(str(error).split()) or type(error).__name__
        return ""

    def _check_address(self, host: str) -> None:
        try:
            socket.create_connection((host, self.port), timeout=_CONNECT_S).close()
        except OSError as error:
            raise UsageError(
                f"No Ray cluster answers at {self.name} ({error.strerror or error}): start its"
                f" head with `ray start --head --ray-client-server-port={self.port}`, or name"
                " another address."
            ) from None


@dataclass(kw_only=True)
class _Slot:
    """An actor, whether it has a worker, and the index of its task."""

    actor: Any
    started: bool = False
    index: int | None = None


@dataclass(kw_only=True)
class _Actors:
    """All actors of a batch.

    Attributes:
        calls: calls without an answer yet. idle: actors without a task.
        pending: indices of tasks not started. tries: of tasks whose machine was lost.
        failed_starts: actors in a row that were lost before they had a worker.
        answered: when an actor last answered, on the monotonic clock.
    """

    ray: Any
    work: Work
    tasks: Sequence[Task]
    limits: BatchLimits
    slots: int
    calls: dict[Any, _Slot] = field(default_factory=dict)
    idle: list[_Slot] = field(default_factory=list)
    tries: Counter[int] = field(default_factory=Counter)
    failed_starts: int = 0
    answered: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.pending = deque(range(len(self.tasks)))
        self._actor = self.ray.remote(WorkerActor).options(
            num_cpus=1, scheduling_strategy="SPREAD", max_restarts=0, max_task_retries=0
        )
        node = NodeState(
            version=deepmf_sumo.__version__,
            sumo=sumo_tools.version(),
            folder=Path.cwd(),
            modules=tuple(one for one in sys.path if one and not one.startswith(sys.prefix)),
            environment={key: os.environ[key] for key in _ENVIRONMENT if key in os.environ},
            inputs=inputs_of(self.tasks),
        )
        self._node = self.ray.put(node)

    def all_done(self, stop: float) -> Generator[Finished, None, None]:
        """Do all tasks; none starts after ``stop``."""
        for _ in range(self.slots):
            self._start_actor()
        while self.pending or self._working():
            if time.monotonic() >= stop:
                self.pending.clear()
            self._assign()
            done, _ = self.ray.wait(list(self.calls), num_returns=1, timeout=1.0)
            for call in done:
                self.answered = time.monotonic()
                yield from self._answered(call, self.calls.pop(call))
            if time.monotonic() - self.answered > START_LIMIT_S:
                raise RunError(
                    f"No machine of the cluster has answered for {START_LIMIT_S:g} s: none has a"
                    " processor free, or all are gone; see `ray status`."
                )

    def stop(self) -> None:
        """End all that still runs: first in order, then by force."""
        slots = [*self.calls.values(), *self.idle]
        stopping = [slot.actor.stop.remote() for slot in slots]
        if stopping:
            self.ray.wait(stopping, num_returns=len(stopping), timeout=3 * POLL_S)
        for slot in slots:
            self.ray.kill(slot.actor)

    def _working(self) -> bool:
        return any(slot.index is not None for slot in self.calls.values())

    def _start_actor(self) -> None:
        """Start an actor, where the cluster has room for it."""
        slot = _Slot(actor=self._actor.remote(self._node, self.work, self.limits))
        self.calls[slot.actor.start.remote()] = slot

    def _assign(self) -> None:
        """Give tasks to idle actors."""
        while self.pending and self.idle:
            slot = self.idle.pop()
            slot.index = self.pending.popleft()
            self.calls[slot.actor.poll.remote((slot.index, self.tasks[slot.index]))] = slot

    def _answered(self, call: Any, slot: _Slot) -> Generator[Finished, None, None]:
        try:
            answer: Answer = self.ray.get(call)
        except DeepmfError:
            raise
        except self.ray.exceptions.RayTaskError as error:
            raise RunError(f"A machine of the cluster cannot work: {_cause(error)}") from None
        except self.ray.exceptions.RayError as error:
            yield from self._lost(slot, _cause(error))
            return
        if answer.refusal:
            raise UsageError(
                f"{answer.refusal}: all machines of the cluster need the same files at the same"
                " places, e.g. on a file system that they share."
            )
        slot.started, self.failed_starts = True, 0
        if not answer.finished and slot.index is not None:
            self.calls[slot.actor.poll.remote()] = slot
            return
        slot.index = None
        self.idle.append(slot)  # before the iterator may be closed: `stop` ends the actors here
        if answer.finished:
            if answer.files:
                unpack(answer.files, self.work.runs)
            yield answer.finished

    def _lost(self, slot: _Slot, why: str) -> Generator[Finished, None, None]:
        """The actor is gone, or cannot be reached: another one does its task."""
        self.ray.kill(slot.actor)
        self.failed_starts += not slot.started
        if self.failed_starts > _TRIES * self.slots:
            raise RunError(
                f"Workers do not start on the machines of the cluster: {why} (is deepmf-sumo"
                " installed on all of them?)"
            )
        self._start_actor()
        for other in self.idle:  # they may be gone as well: a ping finds out, not a task
            self.calls[other.actor.ping.remote()] = other
        self.idle.clear()
        if slot.index is None:
            return
        self.tries[slot.index] += 1
        if self.tries[slot.index] < _TRIES:
            self.pending.appendleft(slot.index)
            yield Finished(index=slot.index, status="lost", reason=why)
        else:
            reason = f"the machine was lost {_TRIES} times while it did this: {why}"
            yield Finished(index=slot.index, status="crashed", reason=reason)


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise PluginError(
            "sweep.executor=ray needs Ray, which is not installed; install deepmf-sumo[cluster]."
        ) from None


def _token_is_here() -> bool:
    """Whether Ray would find a token on this machine, by its own rules."""
    if os.environ.get("RAY_AUTH_TOKEN"):
        return True
    named = os.environ.get("RAY_AUTH_TOKEN_PATH")
    return (Path(named) if named else Path.home() / _TOKEN).is_file()


def _offer_token() -> None:
    """Let Ray send the token of this machine, if there is one: a head that finds one demands it.

    `ray start` does so by itself, a program that joins the cluster only where it is told to. It is
    read when Ray is imported. A head without a token does not mind.
    """
    if _token_is_here():
        os.environ.setdefault(_MODE, "token")


def _of_tokens() -> str:
    """What to do about a server that does not answer."""
    mode, here = os.environ.get(_MODE), _token_is_here()
    found = "a token is here" if here else "no token is here"
    return (
        f". A head that has a token (Ray 2.60 and later) does not answer programs without it:"
        f" {found}, {_MODE} is {mode or 'not set'}. Copy ~/{_TOKEN} from the head to this machine"
        f" and set {_MODE}=token, or start the cluster and this command with {_MODE}=disabled."
    )


def _quiet(*, new: bool) -> dict[str, Any]:
    """Arguments of ``ray.init``: its output must not mix with tables."""
    quiet = {"logging_level": "ERROR", "log_to_driver": False}
    if new:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet["include_dashboard"] = False
    return quiet


def _cause(error: Exception) -> str:
    """The last line that is not empty."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
