"""Reading in a separate process with limits: a bad file can only end that process.

The process is a copy of this one, so it starts in milliseconds. It returns one item at a time.
Where the system cannot do that (`system.limits_reading`) the file is read in this process, without
limits.
"""

import contextlib
import gc
import os
import pickle
from collections.abc import Callable, Iterator
from typing import Final, NoReturn, TypeVar

from deepmf_sumo import system
from deepmf_sumo.errors import DeepmfError, ReaderError

CPU_S: Final = 4.0
"""CPU time for one item. The largest scenes take less than 1 s."""
MEMORY_MB: Final = 384
"""In addition to the memory of this process. The largest scenes take about 100 MB."""
TOO_LARGE: Final = f"reading it takes more than {MEMORY_MB} MB"

_TOO_SLOW: Final = f"reading it takes more than {CPU_S:g} s of CPU time"
_ITEM, _END, _ERROR = range(3)

T = TypeVar("T")


class EndedError(ReaderError):
    """Reading exceeded the limits, or ended its process."""


def each(work: Callable[[], Iterator[T]]) -> Iterator[T]:
    """The items of ``work``, which is called in the other process; they must be picklable.

    Closing the iterator ends the process. After the items before them it raises every DeepmfError
    of the process, and EndedError if the process exceeds the limits.
    """
    if not system.limits_reading():
        yield from work()
        return
    ours, theirs = os.pipe()
    here = os.getpid()
    pid = system.fork()
    if pid == 0:
        os.close(ours)
        _work(work, theirs, here)
    os.close(theirs)
    status = None
    try:
        with open(ours, "rb") as stream:  # noqa: PTH123 - a pipe has no path
            while status is None:
                # An item is incomplete if the process ended while it wrote it.
                try:
                    kind, value = pickle.load(stream)  # noqa: S301 - our own copy wrote it
                except (EOFError, pickle.UnpicklingError):
                    _, status = os.waitpid(pid, 0)
                    break
                if kind == _END:
                    return
                if kind == _ERROR:
                    raise value
                yield value
    finally:
        if status is None:
            with contextlib.suppress(
                ProcessLookupError, ChildProcessError
            ):  # interrupted as it was reaped
                system.kill(pid)
                os.waitpid(pid, 0)
    raise EndedError(_reason(os.waitstatus_to_exitcode(status)))


def _reason(code: int) -> str:
    if system.ended_by_cpu(code):
        return _TOO_SLOW
    return f"reading it ended the process ({system.ending(code)})"


def _work(work: Callable[[], Iterator[T]], pipe: int, parent: int) -> NoReturn:
    """Main function of the other process."""
    code = 1
    try:
        _limit(parent)
        with open(pipe, "wb") as stream:
            _hand_over(work, stream.fileno())
        code = 0
    finally:
        os._exit(code)


def _limit(parent: int) -> None:
    system.end_with_parent()
    if not system.is_child_of(parent):
        os._exit(1)
    system.default_signals()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # hides the output of a crash, which is reported
    gc.freeze()  # otherwise the first collection touches, and so copies, all objects
    system.limit_memory(MEMORY_MB)


def _hand_over(work: Callable[[], Iterator[T]], pipe: int) -> None:
    system.limit_cpu(CPU_S)
    try:
        for item in work():
            _say(pipe, _ITEM, item)
            del item
            system.limit_cpu(CPU_S)
        _say(pipe, _END, None)
    except DeepmfError as error:
        _say(pipe, _ERROR, error)
    except MemoryError:
        _say(pipe, _ERROR, EndedError(TOO_LARGE))
    except Exception as error:  # noqa: BLE001 - a bug ends one file, not the listing
        reason = f"unexpected {type(error).__name__}: {error}; please report this"
        _say(pipe, _ERROR, EndedError(reason))


def _say(pipe: int, kind: int, value: object) -> None:
    # Pickled completely before it is written: an error must not follow half an item.
    said = memoryview(pickle.dumps((kind, value), protocol=5))
    with contextlib.suppress(BrokenPipeError):
        while said:
            said = said[os.write(pipe, said) :]


__all__ = ["CPU_S", "MEMORY_MB", "TOO_LARGE", "EndedError", "each"]
