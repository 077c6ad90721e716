"""Which tests start SUMO or a process: those that are marked `sumo`, and no others.

The mark decides what `make quick` leaves out, so it is checked rather than trusted: a test without
it fails as soon as it starts libsumo, a program or a worker process. A fixture that does so asks
for the fixture `starts_sumo`, which marks each test that uses it.
"""

import platform
import sys
from collections.abc import Callable
from multiprocessing import util
from types import ModuleType
from typing import Any

import pytest

MARK = "sumo"
FIXTURE = "starts_sumo"
EVENTS = {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system", "os.exec"}
"""Audit events of CPython that a start raises; those of `multiprocessing` and libsumo lack one."""

_checked: pytest.Item | None = None
_started: list[str] = []


def check(item: pytest.Item | None) -> None:
    """Refuse starts from now on, for this test; None: allow them."""
    global _checked  # noqa: PLW0603
    marked = item is None or item.get_closest_marker(MARK) or item.get_closest_marker("slow")
    _checked = None if marked else item
    _started.clear()
    for name in ("start", "load"):
        _guard(sys.modules.get("libsumo"), name)


def refusal() -> str | None:
    """What the test started though it is not marked: also where its code caught the failure."""
    return _started[0] if _started else None


def _guard(module: ModuleType | None, name: str) -> None:
    """Let a function of a module, if it is loaded, refuse tests without the mark."""
    function: Callable[..., Any] | None = getattr(module, name, None)
    if module is None or function is None or getattr(function, "guards", False):
        return

    def guarded(*arguments: Any, **named: Any) -> Any:
        refuse(f"{module.__name__}.{name}")
        return function(*arguments, **named)

    guarded.guards = True
    setattr(module, name, guarded)


def refuse(what: str) -> None:
    """Let the test fail that starts something without the mark."""
    if _checked is None:
        return
    sentence = (
        f"{_checked.nodeid} started a program ({what}): mark it @pytest.mark.{MARK}, "
        f"or let the fixture that does so ask for `{FIXTURE}`."
    )
    _started.append(sentence)
    pytest.fail(sentence, pytrace=False)


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if _checked is None:
        return
    if event in EVENTS:
        refuse(event)
    elif event == "import" and arguments[0] == "libsumo":
        refuse("import libsumo")


platform.platform()  # starts `uname` the first time in a process
sys.addaudithook(_audit)
_guard(util, "spawnv_passfds")
