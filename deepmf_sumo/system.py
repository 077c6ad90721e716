"""What the operating system can do, and what is done where it cannot.

No other module names calls that only some systems have (ruff refuses them). Where one is missing,
the same results come by a slower way, which `doctor` shows (`abilities`). On Linux all is there.
Other systems were tried as far as an interpreter on Linux without these calls shows
(``tests/support/bare_python.py``); what is for Windows alone is marked so.

It needs the standard library alone, and imports what is large where it is needed: the program that
ends planners' processes loads it within milliseconds (`planners.remote.reaper`).
"""

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

if TYPE_CHECKING:
    import socket

_fork: Final = getattr(os, "fork", None)
_memfd: Final = getattr(os, "memfd_create", None)
_setpgid: Final = getattr(os, "setpgid", None)
_killpg: Final = getattr(os, "killpg", None)
_getppid: Final = getattr(os, "getppid", None)
_set_blocking: Final = getattr(os, "set_blocking", None)
_sched_yield: Final = getattr(os, "sched_yield", None)
_sysconf: Final = getattr(os, "sysconf", None)
_affinity: Final = getattr(os, "sched_getaffinity", None)
_sigmask: Final = getattr(signal, "pthread_sigmask", None)
_setitimer: Final = getattr(signal, "setitimer", None)
_poll: Final = getattr(select, "poll", None)
_SIGALRM, _SIGPROF, _ITIMER_REAL, _ITIMER_PROF = (
    getattr(signal, name, 0) for name in ("SIGALRM", "SIGPROF", "ITIMER_REAL", "ITIMER_PROF")
)
_SIG_BLOCK, _SIG_UNBLOCK, _SIG_SETMASK = (
    getattr(signal, name, 0) for name in ("SIG_BLOCK", "SIG_UNBLOCK", "SIG_SETMASK")
)
_POLLHUP, _POLLERR = (getattr(select, name, 0) for name in ("POLLHUP", "POLLERR"))
_POLLRDHUP: Final = getattr(select, "POLLRDHUP", 0)

SIGKILL: Final = getattr(signal, "SIGKILL", signal.SIGTERM)
"""Ends a process that heeds nothing else; where there is none, SIGTERM does so (on Windows)."""
_LINUX: Final = sys.platform == "linux"
COPIES: Final = _LINUX and None not in {_fork, _memfd, _killpg, _getppid}
"""Whether a process can be copied with all that it has loaded, SUMO's state included."""
GROUPS: Final = None not in {_setpgid, _killpg, _getppid}
"""Whether a process can be ended together with all that it has started."""
POLLS: Final = None not in {_set_blocking, _poll, _killpg}
"""Whether one thread can wait for several pipes."""
REMOVES_OPEN_FILES: Final = sys.platform != "win32"
NEEDS_DISPLAY: Final = sys.platform not in {"win32", "darwin"}
"""Whether windows need DISPLAY or WAYLAND_DISPLAY."""
REUSES_PORTS: Final = sys.platform != "win32"
"""Whether SO_REUSEADDR is harmless: by it, Windows lets two programs listen on one port."""
PROGRAM_SUFFIX: Final = ".exe" if sys.platform == "win32" else ""
TIMER: Final = _setitimer is not None and bool(_SIGALRM)
_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36
_LOOK_S: Final = 1.0
_LOCKED_BYTE: Final = 2**30
"""Windows lets nobody read what is locked: a byte behind the name of the holder."""


class Ability(NamedTuple):
    """Something that not every system can do; ``instead``: what is done where it cannot."""

    name: str
    there: bool
    instead: str


def abilities() -> tuple[Ability, ...]:
    """What this system can do."""
    return (
        Ability("copies of processes", COPIES, "each run and episode starts a process of its own"),
        Ability("groups of processes", GROUPS, "what a planner program starts may outlive it"),
        Ability("limits on reading", limits_reading(), "files are read without limits"),
        Ability("memory of processes", memory_known(), "the limit on memory is not watched"),
        Ability("locks of files", locks_known(), "two sweeps can write into one folder"),
        Ability("polling of pipes", POLLS, "threads read what a planner program says"),
        Ability("timers", TIMER, "a thread keeps the time"),
    )


# Copies of processes


def fork() -> int:
    """0 in the copy of this process, else its id; only with `COPIES`."""
    assert _fork is not None
    return int(_fork())


def memory_file(name: str) -> int:
    """The number of an open file on no disk; only with `COPIES`."""
    assert _memfd is not None
    return int(_memfd(name))


def threads_of_this_process() -> int:
    """How many there are, those of libraries included; only with `COPIES`."""
    return sum(1 for _ in Path("/proc/self/task").iterdir())


def ending(code: int) -> str:
    """How a process ended, in words: ``SIGSEGV``, ``exit code 3``."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def end_as(code: int) -> NoReturn:
    """End this process with an exit code, or by a signal where it is negative."""
    if code < 0 and GROUPS:
        with contextlib.suppress(OSError, ValueError):  # of SIGKILL it cannot be set
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    # Windows counts up to 2**32, and takes numbers of 32 bits with a sign
    os._exit((code + 2**31) % 2**32 - 2**31)


# Parents, children, groups


def own_group() -> None:
    """Let this process begin a group, so that all that it starts can be ended together."""
    if _setpgid is not None:
        _setpgid(0, 0)


def kill(pid: int) -> None:
    """End a process. Raises ProcessLookupError, PermissionError."""
    os.kill(pid, SIGKILL)


def kill_group(group: int) -> None:
    """End a process and its group; without groups, it alone, and on Windows its descendants.

    Of Windows' `taskkill` nothing was tried.
    """
    if sys.platform == "win32":
        command = ["taskkill", "/T", "/F", "/PID", str(group)]
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            subprocess.run(command, capture_output=True, check=False, timeout=10.0)
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):
        _killpg(group, SIGKILL) if _killpg is not None else kill(group)


def end_with_parent(number: int = SIGKILL) -> None:
    """Let the system send this process a signal as soon as its parent ends.

    So no folder has two writers after a resume. On Linux alone; others call `wait_for_parent`.
    """
    if _LINUX:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def is_child_of(parent: int) -> bool:
    """Whether a process is still this one's parent; always so where that is not known."""
    return _getppid is None or _getppid() == parent


def wait_for_parent(parent: int) -> None:
    """Return when the process that started this one has ended, however that was."""
    if _getppid is not None and sys.platform != "win32":
        while _getppid() == parent:
            time.sleep(_LOOK_S)
        return
    import multiprocessing

    started_by = multiprocessing.parent_process()
    if started_by is not None:
        started_by.join()


def become_subreaper() -> None:
    """Become the parent of descendants that lose theirs (Linux)."""
    if _LINUX:
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_all(group: int) -> None:
    """End a group and all children until none is left: this process adopts their children."""
    while True:
        kill_group(group)  # all together: one by one, they could fork faster
        for child in children():
            with contextlib.suppress(ProcessLookupError):
                kill(child)
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def children() -> list[int]:
    """Ids of this process's children (Linux)."""
    return _children("self")


# Signals and time


@contextlib.contextmanager
def interrupts_held_back() -> Iterator[None]:
    """A process started in the block gets no Ctrl-C while it loads; this one gets it afterwards."""
    if _sigmask is None:
        yield
        return
    before = _sigmask(_SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        _sigmask(_SIG_SETMASK, before)


def let_interrupts_through() -> None:
    """The end of `interrupts_held_back` in a process that was started in the block."""
    if _sigmask is not None:
        _sigmask(_SIG_UNBLOCK, {signal.SIGINT})


def interrupts() -> Iterator[signal.Signals]:
    """What interrupts this process from outside.

    Not Ctrl-C in what a script started with `&`, which SIGTERM can interrupt all the same; neither
    in a worker.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) not in (signal.SIG_IGN, signal.SIG_DFL):
            yield number


def interrupt() -> None:
    """Interrupt this process from any thread, as from outside; nothing where nothing does."""
    number = next(interrupts(), None)
    if number is None:
        return
    if _sigmask is None:
        import _thread

        _thread.interrupt_main(number)
    else:  # it wakes what waits, too
        os.kill(os.getpid(), number)


class Ticks:
    """Calls a function now and then, once `every` has said how often.

    Where it returns True, what is going on is interrupted as by Ctrl-C. Where the system has no
    timer, a thread calls it.
    """

    def __init__(self, call: Callable[[], bool]) -> None:
        self._call, self._stop = call, threading.Event()
        self._before: Any = None
        if TIMER:
            self._before = signal.signal(_SIGALRM, self._on_alarm)

    def every(self, seconds: float) -> None:
        """Begin; 0 ends it."""
        if TIMER:
            assert _setitimer is not None
            _setitimer(_ITIMER_REAL, seconds, seconds)
            return
        self._stop.set()
        if seconds:
            self._stop = threading.Event()
            threading.Thread(target=self._thread, args=(seconds, self._stop), daemon=True).start()

    def close(self) -> None:
        """End it, and restore what was there before."""
        self.every(0.0)
        if TIMER:
            signal.signal(_SIGALRM, self._before)

    def _on_alarm(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        if self._call():
            self.every(0.0)
            raise KeyboardInterrupt

    def _thread(self, seconds: float, stop: threading.Event) -> None:
        import _thread

        while not stop.wait(seconds):
            if self._call():
                _thread.interrupt_main()
                return


def yield_core() -> None:
    """Let another process have this core."""
    if _sched_yield is None:
        time.sleep(0)
    else:
        _sched_yield()


def cores() -> int:
    """How many this process may use."""
    return len(_affinity(0)) if _affinity is not None else os.cpu_count() or 1


# Files, pipes and sockets


def lock(number: int) -> bool:
    """Lock an open file for this process, until it is closed; False where there are no locks.

    Raises BlockingIOError where another process has it.
    """
    fcntl, msvcrt = _module("fcntl"), _module("msvcrt")
    try:
        if fcntl is not None:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        elif msvcrt is not None:
            os.lseek(number, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
        else:
            return False
    except BlockingIOError:
        raise
    except PermissionError as error:
        if fcntl is not None:
            return False
        raise BlockingIOError(*error.args) from None  # so Windows says that it is taken
    except OSError:  # e.g. ENOLCK of a network's file system
        return False
    finally:
        os.lseek(number, 0, os.SEEK_SET)
    return True


def locks_known() -> bool:
    """Whether this system has locks of files; a file system need not have them."""
    return _module("fcntl") is not None or _module("msvcrt") is not None


def do_not_wait(stream: int) -> None:
    """Let reading and writing of a pipe return immediately; only with `POLLS`."""
    assert _set_blocking is not None
    _set_blocking(stream, False)


def hung_up(connection: "socket.socket") -> bool:
    """Whether the other side has closed a connection, also where there is something left to read.

    Without `POLLS` only once all is read.
    """
    import socket

    if _poll is not None:
        ends = _POLLRDHUP | _POLLHUP | _POLLERR
        look = _poll()
        look.register(connection, ends)
        return any(event & ends for _, event in look.poll(0))
    if not select.select([connection], [], [], 0)[0]:
        return False
    try:
        return not connection.recv(1, socket.MSG_PEEK)
    except OSError:
        return True


def _module(name: str) -> Any:
    """A module that not every system has; None without it."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        return None


# Memory and limits


def memory_known() -> bool:
    """Whether this system shows the memory of processes (Linux)."""
    return Path("/proc/self/statm").is_file() and _sysconf is not None


def holds_more_than(limit_mb: float, pid: int) -> bool:
    """Whether a process and its descendants hold more; shared memory counts once.

    That takes milliseconds, so it is measured only where counting shared memory twice is too much.
    False where the system does not say.
    """
    if _sysconf is None:
        return False
    family = list(_family(pid))
    return sum(map(_resident_mb, family)) > limit_mb and sum(map(_own_mb, family)) > limit_mb


def _family(pid: int) -> Iterator[int]:
    yield pid
    for child in _children(pid):
        yield from _family(child)


def _resident_mb(pid: int) -> float:
    """Memory of one process; 0 if it is gone."""
    assert _sysconf is not None
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * float(_sysconf("SC_PAGE_SIZE")) / 2**20


def _own_mb(pid: int) -> float:
    """Memory of one process, each page divided among the processes that hold it."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text("ascii").splitlines()
    except OSError:
        return _resident_mb(pid)
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _children(pid: int | str) -> list[int]:
    found: list[int] = []
    with contextlib.suppress(OSError):  # it, or one of its threads, may end meanwhile
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):
                found += map(int, (thread / "children").read_text("ascii").split())
    return found


def limits_reading() -> bool:
    """Whether a copy of this process can be limited in time and memory."""
    return COPIES and _setitimer is not None and _module("resource") is not None


def limit_memory(more_mb: float) -> None:
    """Limit this process to what it holds now and so much more; it leaves no core file."""
    resource = _module("resource")
    status = Path("/proc/self/status").read_text("ascii", "replace")
    # what the limit counts; statm adds the stack
    present_kb = int(status.partition("VmData:")[2].split(maxsplit=1)[0])
    most = present_kb * 2**10 + round(more_mb * 2**20)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(
        resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard)
    )
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def limit_cpu(seconds: float) -> None:
    """End this process when it has used so much CPU time from now on, see `ended_by_cpu`."""
    assert _setitimer is not None
    _setitimer(_ITIMER_PROF, seconds)


def ended_by_cpu(code: int) -> bool:
    """Whether `limit_cpu` ended a process that has this exit code."""
    return code < 0 and code == -_SIGPROF


def default_signals() -> None:
    """Let signals end this process as they end one that handles none."""
    for name in ("SIGINT", "SIGTERM", "SIGPROF"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
