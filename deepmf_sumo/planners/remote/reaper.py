"""Runs a program and ends all of its processes: `START`, the number of a pipe, the command.

Kills the program and all processes that it started as soon as the program ends, or the other end of
the pipe is closed, even if the process that held it was killed. On Linux, processes that left
the program's group and lost their parent become children of the reaper (the "child subreaper"), so
that none is missed.

It runs with the standard library alone, and starts within 30 ms. psutil would not replace it: a
snapshot of a process tree misses processes that fork while it is taken, and those that have lost
their parent.
"""

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Final

from deepmf_sumo import system

_ROOT: Final = Path(__file__).resolve().parents[3]
_CODE: Final = (
    f"import sys; sys.path.append({str(_ROOT)!r});"
    " from deepmf_sumo.planners.remote.reaper import main;"
    " sys.exit(main(int(sys.argv[1]), sys.argv[2:]))"
)
START: Final = (sys.executable, "-I", "-S", "-c", _CODE)
"""Beginning of the command line."""


def main(pipe: int, command: list[str]) -> int:
    """Exit code of the program; 127 if it cannot be started."""
    system.become_subreaper()
    try:
        program = subprocess.Popen(
            command,
            preexec_fn=system.end_with_parent,  # noqa: PLW1509 - there are no threads yet
            process_group=0,
        )
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return 127
    os.close(0)  # only the program keeps these open: they close when it ends
    os.close(1)
    threading.Thread(target=_watch, args=(pipe, program.pid), daemon=True).start()
    code = program.wait()
    system.end_all(program.pid)
    return code if code >= 0 else 128 - code


def _watch(pipe: int, group: int) -> None:
    os.read(pipe, 1)  # returns when the other end is closed
    system.end_all(group)
    os._exit(0)
