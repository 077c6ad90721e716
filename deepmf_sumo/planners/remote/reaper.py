"""Runs a program and ends all of its processes: ``python reaper.py FD COMMAND...``.

Kills the program and all processes that it started as soon as the program ends, or the other end of
the pipe FD is closed, even if the process that held it was killed. On Linux, processes that left
the program's group and lost their parent become children of the reaper (the "child subreaper"), so
that none is missed.

It runs as a file, without the package and its imports, and starts within 20 ms. psutil would not
replace it: a snapshot of a process tree misses processes that fork while it is taken, and those
that have lost their parent.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36


def main(pipe: int, command: list[str]) -> int:
    """Exit code of the program; 127 if it cannot be started."""
    adopt()
    try:
        program = subprocess.Popen(
            command,
            preexec_fn=_die_with_parent,  # noqa: PLW1509 - there are no threads yet
            process_group=0,
        )
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return 127
    os.close(0)  # only the program keeps these open: they close when it ends
    os.close(1)
    threading.Thread(target=_watch, args=(pipe, program.pid), daemon=True).start()
    code = program.wait()
    end_all(program.pid)
    return code if code >= 0 else 128 - code


def adopt() -> None:
    """Become the parent of descendants that lose theirs."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_all(group: int) -> None:
    """Kill a group and all children until none is left: this process adopts their children."""
    while True:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(group, signal.SIGKILL)  # all together: one by one, they could fork faster
        for child in children():
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def _watch(pipe: int, group: int) -> None:
    os.read(pipe, 1)  # returns when the other end is closed
    end_all(group)
    os._exit(0)


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def children() -> list[int]:
    """Ids of this process's children."""
    found: list[int] = []
    for thread in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, thread.read_text("ascii").split())
    return found


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
