"""Ctrl-C as a wish to leave in order; the second one interrupts."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def leaving() -> Iterator[Callable[[], bool]]:
    """Whether a signal has asked to leave; a second one raises KeyboardInterrupt at once."""
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - as `signal` wants it
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = [signal.signal(number, ask) for number in _SIGNALS]
    try:
        yield lambda: asked
    finally:
        for number, handler in zip(_SIGNALS, before, strict=True):
            signal.signal(number, handler)
