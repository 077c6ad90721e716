"""The machines of a Ray cluster (extra `cluster`); what a machine does is in `place`.

A place for one task at a time on a machine of a cluster.

It is an actor: a process of Ray's, which does nothing but watch over a worker process as `pool`
does at home. So a crash, a hang and a hungry planner cost one task there, too, and never the actor.
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
from deepmf_sumo.sweep.inputs import Input, inputs_of, lacking
from deepmf_sumo.sweep.workers import START_LIMIT_S, Finished, Limits, Work, Worker
from deepmf_sumo.tasks import Task

TURN_S: Final = 0.5
"""Longest wait in a turn: so long does whoever wants the actor to leave have to wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Home:
    """The machine that asks: what it has, the others must have, too.

    Attributes:
        version: of the program.
        folder: where it was started. modules: other folders with modules of the user's.
        environment: variables that say where things are.
        inputs: files of the tasks.
    """

    version: str
    folder: Path
    modules: tuple[str, ...]
    environment: dict[str, str]
    inputs: tuple[Input, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Of a turn.

    Attributes:
        refusal: why the place is of no use, the machine's name first; else empty.
        finished: the task's end, if it has ended.
        files: its folder as a tar archive, whole or as far as it came; empty where there is none.
    """

    refusal: str = ""
    finished: Finished | None = None
    files: bytes = b""


class Place:
    """The actor. Its methods are called one at a time."""

    def __init__(self, home: Home, work: Any, limits: Limits) -> None:
        self._home, self._limits = home, limits
        self._runs = Path(tempfile.mkdtemp(prefix="deepmf-sumo-"))
        self._work = replace(work, runs=self._runs)
        self._given: tuple[int, Task] | None = None
        self._worker: Worker | None = None

    def settle(self) -> Answer:
        """Make this machine like the one that asks, or say what it lacks; start the worker."""
        home = self._home
        what = lacking(home.inputs)
        if deepmf_sumo.__version__ != home.version:
            what = f"has deepmf-sumo {deepmf_sumo.__version__}, not {home.version}"
        elif not home.folder.is_dir():
            what = f"has no {home.folder}, the working folder"
        if what:
            return Answer(refusal=f"{socket.gethostname()} {what}")
        os.environ.update(home.environment)
        os.chdir(home.folder)
        sys.path += [name for name in home.modules if name not in sys.path]
        with contextlib.suppress(AttributeError):  # workers would import Ray's main program
            del sys.modules["__main__"].__file__
        self._worker = self._new()
        return Answer()

    def present(self) -> Answer:
        """Answered by every actor whose machine is still there."""
        return Answer()

    def turn(self, task: tuple[int, Task] | None = None) -> Answer:
        """Begin a task, or go on with the one before; returns when it ends, or soon."""
        self._given = task or self._given
        end = time.monotonic() + TURN_S
        while time.monotonic() < end:
            worker = self._ready()
            left = min(end, worker.deadline) - time.monotonic()
            wait([worker.connection], min(max(left, 0.0), 0.2))
            if finished := worker.look():
                return Answer(finished=finished, files=self._taken())
        return Answer()

    def leave(self) -> None:
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
        """What the task has left, taken away from here."""
        folders = list(self._runs.iterdir())
        archive = packed(self._runs) if folders else b""
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
        return archive


def packed(folder: Path) -> bytes:
    """All that lies in a folder, as a tar archive."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for path in sorted(folder.iterdir()):
            archive.add(path, path.name)
    return buffer.getvalue()


def unpack(archive: bytes, runs: Path) -> None:
    """Put the folders of an archive into ``runs``, each whole or not at all."""
    beside = runs / ".arriving"  # of one name, so that the next one clears up after a kill
    shutil.rmtree(beside, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(beside, filter="data")
    for folder in beside.iterdir():
        place = runs / folder.name
        if place.exists():
            shutil.rmtree(place)
        folder.rename(place)
    beside.rmdir()


_KNOCK_S: Final = 5.0
"""Ray itself tries for half a minute to reach an address where nobody is."""

_TRIES: Final = 3
"""A task that was running whenever its machine was lost may be why."""

_JOINS: Final = 3
"""So often a cluster is asked that says that it is busy."""

_BUSY: Final = "client server failed"
"""Ray's words where the process that serves a program was not up in time, as on a busy machine."""

_SILENT: Final = "connection timeout"
"""Ray's words where its server does not answer: so it treats a program without its token."""

_MODE: Final = "RAY_AUTH_MODE"
_TOKEN: Final = Path(".ray") / "auth_token"
"""In the home folder."""

_SAID: Final = 300
"""Characters of Ray's words that are shown; what matters of a long one is at its end."""

_ENVIRONMENT: Final = ("DEEPMF_SUMO_HOME", "XDG_DATA_HOME")


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
        """As `Executor.check`: PluginError without Ray, UsageError where nobody listens."""
        if self.host:
            _offer_token()
        _ray()
        if self.host:
            self._knock(self.host)

    def run(
        self, work: Work, tasks: Sequence[Task], limits: Limits
    ) -> Generator[Finished, None, None]:
        """As `Executor.run`.

        Raises PluginError where Ray is not installed, UsageError where nobody answers or a machine
        lacks what the tasks need, RunError where no machine takes them.
        """
        stop = time.monotonic() + 60.0 * limits.minutes if limits.minutes else float("inf")
        if not tasks:
            return
        ray = self._connected()
        try:
            seats = min(self.jobs or int(ray.cluster_resources().get("CPU", 1)), len(tasks))
            crew = _Crew(ray=ray, work=work, tasks=tasks, limits=limits, seats=max(seats, 1))
            try:
                yield from crew.all_done(stop)
            except ConnectionError as error:
                raise RunError(
                    f"The connection to the Ray cluster '{self.name}' is lost ({error});"
                    " --resume goes on."
                ) from None
            finally:
                with contextlib.suppress(ConnectionError):
                    crew.dismiss()
        finally:
            ray.shutdown()

    def _connected(self) -> Any:
        """The module, connected to the cluster."""
        self.check()
        ray = _ray()
        kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            refusal = _BUSY
            for _ in range(_JOINS):
                if _BUSY in refusal:
                    refusal = self._refusal(ray)
        finally:
            for number, handler in kept.items():  # Ray's own for SIGTERM loses the tables
                signal.signal(number, handler)
        if refusal:
            cause = refusal if len(refusal) <= _SAID else f"... {refusal[-_SAID:]}"
            hint = _of_tokens() if _SILENT in refusal else ""
            raise UsageError(f"The Ray cluster '{self.name}' cannot be joined: {cause}{hint}")
        return ray

    def _refusal(self, ray: Any) -> str:
        """Join the cluster; what Ray says against it, nothing where this program is part of it."""
        joined = ray.is_initialized()
        try:
            ray.init(address=self.name if self.host else None, **_quiet(new=not self.host))
        except Exception as error:  # noqa: BLE001 - Ray's own, and what it is made of
            if not joined:
                with contextlib.suppress(Exception):
                    ray.shutdown()
            return " ".join(str(error).split()) or type(error).__name__
        return ""

    def _knock(self, host: str) -> None:
        try:
            socket.create_connection((host, self.port), timeout=_KNOCK_S).close()
        except OSError as error:
            raise UsageError(
                f"No Ray cluster answers at {self.name} ({error.strerror or error}): start its"
                f" head with `ray start --head --ray-client-server-port={self.port}`, or name"
                " another address."
            ) from None


@dataclass(kw_only=True)
class _Seat:
    """An actor, whether it has a worker, and the task that it does."""

    actor: Any
    settled: bool = False
    index: int | None = None


@dataclass(kw_only=True)
class _Crew:
    """All actors of a batch.

    Attributes:
        calls: what they have been asked and have not answered yet.
        idle: those without a task.
        pending: tasks not begun, by index. tries: of tasks whose machine was lost.
        stillborn: actors in a row that were lost before they could do anything.
        heard: when an actor last answered, on the monotonic clock.
    """

    ray: Any
    work: Work
    tasks: Sequence[Task]
    limits: Limits
    seats: int
    calls: dict[Any, _Seat] = field(default_factory=dict)
    idle: list[_Seat] = field(default_factory=list)
    tries: Counter[int] = field(default_factory=Counter)
    stillborn: int = 0
    heard: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.pending = deque(range(len(self.tasks)))
        self._actor = self.ray.remote(Place).options(
            num_cpus=1, scheduling_strategy="SPREAD", max_restarts=0, max_task_retries=0
        )
        home = Home(
            version=deepmf_sumo.__version__,
            folder=Path.cwd(),
            modules=tuple(one for one in sys.path if one and not one.startswith(sys.prefix)),
            environment={key: os.environ[key] for key in _ENVIRONMENT if key in os.environ},
            inputs=inputs_of(self.tasks),
        )
        self._home = self.ray.put(home)

    def all_done(self, stop: float) -> Generator[Finished, None, None]:
        """Do all tasks; none is begun after ``stop``."""
        for _ in range(self.seats):
            self._hire()
        while self.pending or self._working():
            if time.monotonic() >= stop:
                self.pending.clear()
            self._occupy()
            done, _ = self.ray.wait(list(self.calls), num_returns=1, timeout=1.0)
            for call in done:
                self.heard = time.monotonic()
                yield from self._hear(call, self.calls.pop(call))
            if time.monotonic() - self.heard > START_LIMIT_S:
                raise RunError(
                    f"No machine of the cluster has answered for {START_LIMIT_S:g} s: none has a"
                    " processor free, or all are gone; see `ray status`."
                )

    def dismiss(self) -> None:
        """End all that still runs: a moment to do it in order, then by force."""
        seats = [*self.calls.values(), *self.idle]
        leaving = [seat.actor.leave.remote() for seat in seats]
        if leaving:
            self.ray.wait(leaving, num_returns=len(leaving), timeout=3 * TURN_S)
        for seat in seats:
            self.ray.kill(seat.actor)

    def _working(self) -> bool:
        return any(seat.index is not None for seat in self.calls.values())

    def _hire(self) -> None:
        """A new actor, where the cluster has room for it."""
        seat = _Seat(actor=self._actor.remote(self._home, self.work, self.limits))
        self.calls[seat.actor.settle.remote()] = seat

    def _occupy(self) -> None:
        """Give tasks to the idle."""
        while self.pending and self.idle:
            seat = self.idle.pop()
            seat.index = self.pending.popleft()
            self.calls[seat.actor.turn.remote((seat.index, self.tasks[seat.index]))] = seat

    def _hear(self, call: Any, seat: _Seat) -> Generator[Finished, None, None]:
        try:
            answer: Answer = self.ray.get(call)
        except DeepmfError:
            raise
        except self.ray.exceptions.RayTaskError as error:
            raise RunError(f"A machine of the cluster cannot work: {_cause(error)}") from None
        except self.ray.exceptions.RayError as error:
            yield from self._lost(seat, _cause(error))
            return
        if answer.refusal:
            raise UsageError(
                f"{answer.refusal}: all machines of the cluster need the same files at the same"
                " places, e.g. on a file system that they share."
            )
        seat.settled, self.stillborn = True, 0
        if not answer.finished and seat.index is not None:
            self.calls[seat.actor.turn.remote()] = seat
            return
        seat.index = None
        self.idle.append(seat)  # before the iterator may be closed: whoever is here is dismissed
        if answer.finished:
            if answer.files:
                unpack(answer.files, self.work.runs)
            yield answer.finished

    def _lost(self, seat: _Seat, why: str) -> Generator[Finished, None, None]:
        """The actor is gone, or cannot be reached: another one does its task."""
        self.ray.kill(seat.actor)
        self.stillborn += not seat.settled
        if self.stillborn > _TRIES * self.seats:
            raise RunError(
                f"Workers do not start on the machines of the cluster: {why} (is deepmf-sumo"
                " installed on all of them?)"
            )
        self._hire()
        for other in self.idle:  # those beside it are gone as well: no task is to find out
            self.calls[other.actor.present.remote()] = other
        self.idle.clear()
        if seat.index is None:
            return
        self.tries[seat.index] += 1
        if self.tries[seat.index] < _TRIES:
            self.pending.appendleft(seat.index)
            yield Finished(index=seat.index, status="lost", reason=why)
        else:
            reason = f"the machine was lost {_TRIES} times while it did this: {why}"
            yield Finished(index=seat.index, status="crashed", reason=reason)


def _ray() -> Any:
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise PluginError(
            "--executor ray needs Ray, which is not installed; install deepmf-sumo[cluster]."
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
    """Arguments of ``ray.init``: what it prints belongs to nobody's table."""
    quiet = {"logging_level": "ERROR", "log_to_driver": False}
    if new:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet["include_dashboard"] = False
    return quiet


def _cause(error: Exception) -> str:
    """The last line that says something."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
