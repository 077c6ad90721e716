"""A place for one task at a time on a machine of a cluster.

It is an actor: a process of Ray's, which does nothing but watch over a worker process as `pool`
does at home. So a crash, a hang and a hungry planner cost one task there, too, and never the actor.
"""

import contextlib
import io
import os
import shutil
import socket
import sys
import tarfile
import tempfile
import time
from dataclasses import dataclass, replace
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo.benchmark.executors.base import Limits
from deepmf_sumo.benchmark.inputs import Input, lacking
from deepmf_sumo.benchmark.pool import Finished, Worker
from deepmf_sumo.benchmark.tasks import Task

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


__all__ = ["TURN_S", "Answer", "Home", "Place", "packed", "unpack"]
