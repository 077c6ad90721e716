"""Memory of a process, read from outside: what it asked for says nothing, what it holds does.

A limit on address space (RLIMIT_AS) is of no use: torch reserves gigabytes that it never touches.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

_PAGE_MB: Final = os.sysconf("SC_PAGE_SIZE") / 2**20 if hasattr(os, "sysconf") else 0.0


def watched() -> bool:
    """Whether this system shows the memory of processes (Linux does)."""
    return Path("/proc/self/statm").is_file()


def more_than(limit_mb: float, pid: int) -> bool:
    """Whether a process and all that it started hold more; what they share counts once.

    That takes milliseconds to find out, so it is asked only where counting it twice is too much.
    """
    family = list(_family(pid))
    return sum(map(_resident_mb, family)) > limit_mb and sum(map(_own_mb, family)) > limit_mb


def _family(pid: int) -> Iterator[int]:
    yield pid
    for child in _children(pid):
        yield from _family(child)


def _resident_mb(pid: int) -> float:
    """Of one process; 0 if it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * _PAGE_MB
    except (OSError, IndexError):
        return 0.0


def _own_mb(pid: int) -> float:
    """Of one process, each page divided among those that hold it."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text("ascii").splitlines()
    except OSError:
        return _resident_mb(pid)
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _children(pid: int) -> list[int]:
    found: list[int] = []
    try:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            found += map(int, (thread / "children").read_text("ascii").split())
    except OSError:
        return found
    return found
