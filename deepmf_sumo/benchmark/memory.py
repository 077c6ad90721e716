"""Memory of a process, read from outside: what it asked for says nothing, what it holds does.

A limit on address space (RLIMIT_AS) is of no use: torch reserves gigabytes that it never touches.
"""

import os
from pathlib import Path
from typing import Final

_PAGE_MB: Final = os.sysconf("SC_PAGE_SIZE") / 2**20 if hasattr(os, "sysconf") else 0.0


def watched() -> bool:
    """Whether this system shows the memory of processes (Linux does)."""
    return Path("/proc/self/statm").is_file()


def resident_mb(pid: int) -> float:
    """MB in memory of a process and all that it started; 0 for one that is gone."""
    return _of_one(pid) + sum(resident_mb(child) for child in _children(pid))


def _of_one(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * _PAGE_MB
    except (OSError, IndexError):
        return 0.0


def _children(pid: int) -> list[int]:
    found: list[int] = []
    try:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            found += map(int, (thread / "children").read_text("ascii").split())
    except OSError:
        return found
    return found
