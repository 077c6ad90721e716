"""Processes of this machine for work without SUMO's simulation: features, converted networks.

They end with the command, however that ends. Ctrl-C reaches the command alone, which ends their
work: by SystemExit, so that no part of a file is left. A command that is killed leaves no process.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, Final, NoReturn

from deepmf_sumo import system

_LEAVE_S: Final = 2.0
"""For a process whose parent is gone to remove what it has begun."""

_leaving: Final = threading.Event()


class _Pool(ProcessPoolExecutor):
    """Starts its processes while it is given work."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """As of the base class; Ctrl-C waits while a process is started."""
        with system.interrupts_held_back():
            return super().submit(_done, work, *given, **named)


@contextmanager
def pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes; they are spawned, since this one may have threads."""
    resource_tracker.ensure_running()  # starting it would let interrupts through
    before = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    with _Pool(jobs, mp_context=spawn, initializer=_begin, initargs=(os.getpid(),)) as made:
        try:
            yield made
        except BaseException:
            made.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
            raise


def _begin(parent: int) -> None:
    """As a process begins: it heeds its parent's end, and no Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    system.let_interrupts_through()
    signal.signal(signal.SIGTERM, _leave)
    system.end_with_parent(signal.SIGTERM)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _done(work: Callable[..., Any], *given: Any, **named: Any) -> Any:
    """What the work returns. A process that has to leave has one more piece in its queue."""
    if _leaving.is_set():
        sys.exit(1)
    return work(*given, **named)


def _leave(number: int, frame: object) -> NoReturn:  # noqa: ARG001 - as `signal` wants it
    _leaving.set()
    sys.unraisablehook = lambda _: None  # Python prints an exit within a callback
    sys.exit(1)


def _end_with(parent: int) -> None:
    """End this process where the system sends no signal when the parent ends."""
    system.wait_for_parent(parent)
    time.sleep(_LEAVE_S)
    os._exit(1)
