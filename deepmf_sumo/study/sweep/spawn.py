"""Work in a new process, where a process cannot be copied (`system.COPIES`).

The process loads everything anew, which takes seconds; it gets the work as a pickle. So SUMO's
state cannot be shared: each run, and each episode of a run, has a SUMO of its own from the
network's first second on. The results are those of copies, byte for byte, which have a SUMO of
their own, too (`study`).
"""

import io
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from multiprocessing import resource_tracker
from pathlib import Path
from typing import IO, Final, NamedTuple

from deepmf_sumo import system
from deepmf_sumo.errors import RunError
from deepmf_sumo.planners import _checked
from deepmf_sumo.study.sweep.streams import logged

_WORK, _ANSWER, _LOG = "work", "answer", "log"
WATCHER: Final = "watches the parent"
"""A thread of every worker, which sleeps and holds no lock."""


class ProcessEnd(NamedTuple):
    """How a process ended; ``blamed``: while code of a planner ran."""

    answer: bytes
    code: int
    blamed: bool


def run(work: Callable[[], object], shared: object = None) -> ProcessEnd:
    """Do the work in a new process; what it prints appears here.

    ``shared``: an object that both have. Raises RunError where the work cannot be pickled.
    """
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as name:
        folder = Path(name)
        try:
            (folder / _WORK).write_bytes(pickle.dumps((work, shared), pickle.HIGHEST_PROTOCOL))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise RunError(
                "This system cannot copy processes, and what is simulated cannot be handed to a new"
                f" one: {error}. Let adversary and policy be made of objects that pickle takes."
            ) from None
        context = multiprocessing.get_context("spawn")
        in_planner = context.RawArray("b", 1)
        process = context.Process(target=_life, args=(folder, Path.cwd(), os.getpid(), in_planner))
        resource_tracker.ensure_running()  # starting it would let interrupts through
        with system.interrupts_held_back():
            process.start()
        process.join()
        _print(folder / _LOG)
        return ProcessEnd(
            answer=(folder / _ANSWER).read_bytes() if (folder / _ANSWER).is_file() else b"",
            code=process.exitcode or 0,
            blamed=bool(in_planner[0]),
        )


def _print(log: Path) -> None:
    if log.is_file() and log.stat().st_size:
        sys.stdout.flush()
        os.write(1, log.read_bytes())


def _life(folder: Path, here: Path, parent: int, in_planner: _checked.Flag) -> None:
    """Main function of the new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    system.let_interrupts_through()
    threading.Thread(
        target=_end_with_parent, args=(folder, parent), name=WATCHER, daemon=True
    ).start()
    os.chdir(here)
    code, said = 1, b""
    _checked.share(in_planner)
    with logged(folder / _LOG):
        work, shared = pickle.loads((folder / _WORK).read_bytes())  # noqa: S301 - our own parent's
        try:
            found = work()
            code, said = 0, packed(found, shared)
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 1
        except Exception as error:  # noqa: BLE001 - raised again in the waiting worker
            said = packed(error, shared)
    if said:
        (folder / _ANSWER).write_bytes(said)
    os._exit(code)


def _end_with_parent(folder: Path, parent: int) -> None:
    system.wait_for_parent(parent)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


class _Packer(pickle.Pickler):
    """Pickles an answer, but not what both processes have."""

    def __init__(self, file: IO[bytes], shared: object) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._shared = shared

    def persistent_id(self, one: object) -> str | None:
        """A name for the shared object."""
        return "shared" if one is self._shared and one is not None else None


class _Unpacker(pickle.Unpickler):
    """The other side of `_Packer`."""

    def __init__(self, file: IO[bytes], shared: object) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, name: object) -> object:  # noqa: ARG002 - there is one
        """The shared object."""
        return self._shared


def packed(one: object, shared: object) -> bytes:
    """What one process tells another one, without the object that both have."""
    file = io.BytesIO()
    _Packer(file, shared).dump(one)
    return file.getvalue()


def unpacked(said: bytes, shared: object) -> object:
    """What `packed` told, of a process of our own."""
    return _Unpacker(io.BytesIO(said), shared).load()
