"""Workers of sweeps as copies of one process that has loaded the libraries.

Most of the time of a run of one second is that its worker loads numpy, shapely, scipy and torch. A
worker of the tests differs from that of a user in where it comes from alone: it gets environment,
folder, module path, standard output and task of the process that asks for it, and nothing that a
test has patched. Tests of the workers themselves ask for the fixture `spawned_workers`.
"""

import mmap
import multiprocessing
import os
import signal
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import forkserver, reduction
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from deepmf_sumo.planners import _checked
from deepmf_sumo.study.sweep import workers

from tests.support import started_programs

LOADED = [
    "deepmf_sumo.study.sweep.episode", "deepmf_sumo.attacks.deepmf",
    "deepmf_sumo.deepmf.networks.torch_networks",
    "deepmf_sumo.report.picture", "libsumo", "scipy.optimize",
]  # fmt: skip


class _Surroundings:
    """What a process takes over from the one that pickles this, when it unpickles it."""

    def __init__(self, *streams: int) -> None:
        self._streams = streams or (1, 2)

    def __reduce__(self) -> tuple[Any, ...]:
        return _take_over, (dict(os.environ), *map(reduction.DupFd, self._streams))


def _take_over(environment: dict[str, str], *streams: Any) -> None:
    _checked.share(mmap.mmap(-1, 1))  # else of all copies of the process that has it already
    os.environ.clear()
    os.environ.update(environment)
    for number, stream in enumerate(streams, start=1):
        file = stream.detach()
        os.dup2(file, number)
        os.close(file)


class _Process(ForkServerProcess):
    """`workers.Worker` asks for it."""

    def __init__(self, *, target: Any, args: tuple[Any, ...], daemon: bool) -> None:
        super().__init__(target=_begin, args=(_Surroundings(), target, *args), daemon=daemon)

    def start(self) -> None:
        started_programs.refuse("a worker")
        super().start()


def _begin(
    _: None, serve: Any, theirs: Connection, work: Any, parent: int, in_planner: Any
) -> None:
    serve(theirs, work, os.getppid(), in_planner)  # of the process that it is a copy of


def program(text: str, arguments: Sequence[str], folder: Path) -> str:
    """What a Python program prints that runs in such a process, in a folder; its errors, too.

    As ``python -c``, but the libraries are loaded already. Raises AssertionError if it fails.
    """
    started_programs.refuse("a program")
    output = folder / f"output-{os.getpid()}.txt"
    process = ForkServerProcess(
        target=_program, args=(_Surroundings(), text, list(arguments), folder, output)
    )
    process.start()
    process.join()
    said = output.read_text("utf-8")
    assert process.exitcode == 0, said
    return said


def _program(_: None, text: str, arguments: list[str], folder: Path, output: Path) -> None:
    with output.open("wb") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    os.chdir(folder)
    os.environ.update(workers.SINGLE_THREAD)
    sys.path.insert(0, "")
    sys.argv = ["-c", *arguments]
    exec(compile(text, "<program>", "exec"), {"__name__": "__main__"})


class Command:
    """``deepmf-sumo ...`` in such a process, as `subprocess.Popen` starts it, with text streams."""

    def __init__(self, *arguments: object) -> None:
        started_programs.refuse("a command")
        out, err = os.pipe(), os.pipe()
        self._process = ForkServerProcess(
            target=_command, args=(_Surroundings(out[1], err[1]), [str(one) for one in arguments])
        )
        self._process.start()
        self.pid = self._process.pid
        for end in (out[1], err[1]):
            os.close(end)
        self.stdout, self.stderr = (os.fdopen(end[0], encoding="utf-8") for end in (out, err))

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What is left on both streams, once it has ended."""
        if self.stdout.closed:
            return "", ""
        with ThreadPoolExecutor(2) as pool:
            reading = [pool.submit(stream.read) for stream in (self.stdout, self.stderr)]
            self._process.join(timeout)
            if self.returncode is None:
                self.kill()
                raise TimeoutError(f"the command did not end within {timeout:g} s")
            out, err = (one.result() for one in reading)
        self.stdout.close()
        self.stderr.close()
        return out, err


def _command(_: None, arguments: list[str]) -> None:
    from deepmf_sumo.cli import main

    sys.argv = ["deepmf-sumo", *arguments]
    sys.stdout, sys.stderr = (os.fdopen(os.dup(one), "w", buffering=1) for one in (1, 2))
    main.main()


def use(patch: pytest.MonkeyPatch) -> None:
    """Let workers be copies from now on."""
    forkserver.set_forkserver_preload(LOADED)
    array = multiprocessing.get_context("forkserver").RawArray
    context = SimpleNamespace(Pipe=multiprocessing.Pipe, RawArray=array, Process=_Process)
    patch.setattr(workers, "multiprocessing", SimpleNamespace(get_context=lambda _: context))
