"""Signals to a command that takes part in a simulation of another program."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from deepmf_sumo import system

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
_IDLE_S: Final = 5.0
"""A script that makes no step in this time is idle: it is not waited for."""
_LOOK_S: Final = 0.5
_HINT: Final = b"leaving at the next step of the script; Ctrl-C again leaves immediately\n"


class Leaving:
    """Whether a signal has asked to stop. Asked after each step of the simulation.

    Attributes:
        terminated: whether that was SIGTERM: no user sits there who may press Ctrl-C again.
    """

    def __init__(self) -> None:
        self.terminated = False
        self.ticks = system.Ticks(self._idle)
        self._asked = False
        self._alive_s = time.monotonic()

    def __call__(self) -> bool:
        """Whether to leave now."""
        self._alive_s = time.monotonic()
        return self._asked

    def ask(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - of `signal`
        """Handle a signal; a second one raises KeyboardInterrupt."""
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True
        self._alive_s = time.monotonic()
        if number == signal.SIGTERM:
            self.terminated = True
            self.ticks.every(_LOOK_S)
        elif sys.stderr.isatty():
            os.write(sys.stderr.fileno(), _HINT)

    def _idle(self) -> bool:
        """Now and then after SIGTERM: whether no step comes, so that it is left immediately."""
        return time.monotonic() - self._alive_s > _IDLE_S


@contextmanager
def leaving() -> Iterator[Leaving]:
    """Whether a signal has asked to stop; a second one raises KeyboardInterrupt immediately.

    So does a single SIGTERM while the script makes no step.
    """
    asked = Leaving()
    before = {number: signal.signal(number, asked.ask) for number in SIGNALS}
    try:
        yield asked
    finally:
        asked.ticks.close()
        for number, handler in before.items():
            signal.signal(number, handler)
