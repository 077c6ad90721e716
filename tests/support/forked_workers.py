"""Workers of sweeps as copies of one process that has loaded the libraries.

Most of the time of a run of one second is that its worker loads numpy, shapely, scipy and torch. A
worker of the tests differs from that of a user in where it comes from alone: it gets environment,
folder, module path, standard output and task of the process that asks for it, and nothing that a
test has patched. Tests of the workers themselves ask for the fixture `spawned_workers`.
"""

import multiprocessing
import os
import sys
from collections.abc import Sequence
from multiprocessing import forkserver, reduction
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from deepmf_sumo.study.sweep import workers

from tests.support import started_programs

LOADED = [
    "deepmf_sumo.study.sweep.episode", "deepmf_sumo.attacks.deepmf",
    "deepmf_sumo.deepmf.networks.torch_networks",
    "deepmf_sumo.report.picture", "libsumo", "scipy.optimize",
]  # fmt: skip


class _Surroundings:
    """What a process takes over from the one that pickles this, when it unpickles it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _take_over, (dict(os.environ), reduction.DupFd(1), reduction.DupFd(2))


def _take_over(environment: dict[str, str], *streams: Any) -> None:
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


def _begin(_: None, serve: Any, theirs: Connection, work: Any, parent: int) -> None:
    serve(theirs, work, os.getppid())  # of the process that it is a copy of


def program(text: str, arguments: Sequence[str], folder: Path) -> str:
    """What a Python program prints that runs in such a process, in a folder; its errors, too.

    As ``python -c``, but the libraries are loaded already. Raises AssertionError if it fails.
    """
    started_programs.refuse("a program")
    output = folder / f"output-{os.getpid()}.txt"
    process = ForkServerProcess(
        target=_program, args=(_Surroundings(), text, list(arguments), folder, output)
    )
    forkserver.set_forkserver_preload(LOADED)
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


def use(patch: pytest.MonkeyPatch) -> None:
    """Let workers be copies from now on."""
    forkserver.set_forkserver_preload(LOADED)
    context = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=_Process)
    patch.setattr(workers, "multiprocessing", SimpleNamespace(get_context=lambda _: context))
