"""An interpreter on Linux without what only POSIX systems have: what Windows and macOS lack.

`environment` makes each Python that is started with it load `take_away` before all else: modules
are refused, and functions and signals deleted. Modules of the standard library that have been
loaded keep them, as Windows' versions of these modules need none; so SUMO, torch and other
libraries work. ``sys.platform`` stays ``linux``. Of Windows it has `msvcrt.locking`, by the locks
of `fcntl`.
"""

import os
import sys
from pathlib import Path

MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "pty", "tty", "syslog")
OF_OS = (
    "fork", "forkpty", "getpgid", "getpgrp", "getppid", "killpg", "memfd_create", "mkfifo",
    "sched_getaffinity", "sched_setaffinity", "sched_yield", "set_blocking",
    "setpgid", "setpgrp", "setsid", "sysconf", "wait",
    "wait3", "wait4", "pidfd_open", "fchmod", "chown", "lchown", "O_NONBLOCK",
)  # fmt: skip
OF_SIGNAL = (
    "SIGKILL", "SIGALRM", "SIGPROF", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGCHLD", "SIGSTOP",
    "SIGQUIT", "setitimer", "getitimer", "alarm", "pause", "pthread_sigmask", "pthread_kill",
    "siginterrupt", "sigwait", "ITIMER_REAL", "ITIMER_PROF", "ITIMER_VIRTUAL", "SIG_BLOCK",
    "SIG_UNBLOCK", "SIG_SETMASK",
)  # fmt: skip
OF_SELECT = ("poll", "epoll", "POLLHUP", "POLLERR", "POLLRDHUP", "POLLIN", "POLLOUT")
_KEEP = (
    "subprocess", "tempfile", "shutil", "platform", "selectors", "asyncio", "socketserver",
    "multiprocessing.popen_fork", "multiprocessing.popen_spawn_posix", "multiprocessing.util",
    "multiprocessing.spawn", "multiprocessing.resource_tracker", "multiprocessing.context",
    "multiprocessing.connection", "multiprocessing.shared_memory", "multiprocessing.forkserver",
    "concurrent.futures.process", "pathlib", "random", "threading", "logging", "uuid",
)  # fmt: skip
"""Modules of the standard library that keep all."""


def environment(folder: Path) -> dict[str, str]:
    """The environment for such an interpreter; ``folder`` is for a file that it loads."""
    root = Path(__file__).parents[2]
    (folder / "sitecustomize.py").write_text(
        "import importlib.util\n"
        f"made = importlib.util.spec_from_file_location('bare_python', {str(Path(__file__))!r})\n"
        "loaded = importlib.util.module_from_spec(made)\n"
        "made.loader.exec_module(loaded)\n"
        "loaded.take_away()\n",
        "utf-8",
    )
    path = os.pathsep.join([str(folder), str(root), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


def take_away() -> None:
    """Take all of it away from this process."""
    import contextlib
    import fcntl
    import importlib
    import select
    import signal
    import types

    whole = {}
    for module in (os, signal, select):
        copy = types.ModuleType(module.__name__)
        vars(copy).update(vars(module))
        whole[module.__name__] = copy
    for name in _KEEP:
        with contextlib.suppress(ImportError):
            kept = importlib.import_module(name)
            for attribute, value in list(vars(kept).items()):
                for each in (os, signal, select):
                    if value is each:
                        setattr(kept, attribute, whole[each.__name__])
    for module, names in ((os, OF_OS), (signal, OF_SIGNAL), (select, OF_SELECT)):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    sys.modules["msvcrt"] = _msvcrt(fcntl)
    for name in MODULES:
        sys.modules[name] = None  # an import of it raises ModuleNotFoundError


def _msvcrt(fcntl):
    import types

    def locking(number, mode, count):
        assert (mode, count) == (2, 1)
        assert os.lseek(number, 0, os.SEEK_CUR) > 1000, "Windows lets nobody read locked bytes"
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise PermissionError(13, "Permission denied") from error

    return types.SimpleNamespace(LK_NBLCK=2, locking=locking)
