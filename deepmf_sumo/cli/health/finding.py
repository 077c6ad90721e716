"""What a check found."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

State = Literal["ok", "warning", "broken"]
PROBE_S: Final = 120.0
"""The first import of torch from a slow disk takes a minute."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the report; ``warning``: something that not everybody needs does not work."""

    name: str
    state: State
    text: str


Check = Callable[[], Finding]


def look(name: str, check: Check) -> Finding:
    """The finding of a check; one that fails itself is a finding too."""
    try:
        return check()
    except Exception as error:  # noqa: BLE001 - whatever is broken here is what is looked for
        return Finding(name=name, state="broken", text=f"{type(error).__name__}: {error}")


def probe(code: str) -> tuple[bool, str]:
    """Run Python code in a process of its own; whether it went well, and its last line.

    A wheel that does not fit ends its process, often by a signal and without a traceback.
    """
    return ended([sys.executable, "-c", code], PROBE_S)


def ended(command: list[str], timeout_s: float) -> tuple[bool, str]:
    """Run a program; whether it went well, and the last line that it wrote, else its end."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=timeout_s,
            check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False, f"did not end within {timeout_s:g} s"
    except OSError as error:
        return False, f"{command[0]} cannot be started: {error.strerror}"
    if done.returncode == 0:
        return True, _last(done.stdout)
    if done.returncode < 0:
        return False, f"its process was ended by signal {-done.returncode}"
    return False, _last(done.stderr) or f"exit code {done.returncode}"


def _last(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""
