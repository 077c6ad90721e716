"""A planner program: started with its reaper, asked within time limits, ended with its children.

Where the system cannot wait for several pipes (`system.POLLS`), threads read and write them, and
the program is started without a reaper: what it starts itself may outlive it.
"""

import contextlib
import os
import queue
import selectors
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Final

from deepmf_sumo import system
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote import reaper
from deepmf_sumo.planners.remote.protocol import LONGEST_BYTES

LOGGED_BYTES: Final = 1_000_000
"""Limit of what is kept of the program's stderr in an episode."""

_CHUNK: Final = 65_536
_LEAVE_S: Final = 0.2
"""Time for the program to end by itself after its stdin is closed."""
_GRACE_S: Final = 1.0
"""Time for the reaper to end all processes, before it is killed."""


class Process:
    """A running program, which answers one line of stdout for each line of stdin.

    Args:
        name: of the program in error messages.
        command: the command line.
    """

    def __init__(self, name: str, command: list[str]) -> None:
        self._begin(name)
        leash, self._leash = os.pipe()
        try:
            self._process = subprocess.Popen(
                [*reaper.START, str(leash), *command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                pass_fds=[leash],
                start_new_session=True,  # else Ctrl-C could kill it before it has ended the program
            )
        finally:
            os.close(leash)
        streams = (self._process.stdin, self._process.stdout, self._process.stderr)
        self._stdin, self._stdout, self._stderr = (
            stream.fileno() for stream in streams if stream is not None
        )
        for stream in (self._stdin, self._stdout, self._stderr):
            system.do_not_wait(stream)

    def _begin(self, name: str) -> None:
        self._name = name
        self._answers = b""
        self._logged = 0

    def ask(self, path: str, line: bytes, limit_s: float, what: str) -> bytes:
        """The next line; see `PlannerConnection`. The line itself says what is asked."""
        deadline = time.monotonic() + limit_s
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdin, selectors.EVENT_WRITE)
            selector.register(self._stdout, selectors.EVENT_READ)
            selector.register(self._stderr, selectors.EVENT_READ)
            while (answer := self._next_line(what)) is None:
                ready = selector.select(max(0.0, deadline - time.monotonic()))
                if time.monotonic() >= deadline:
                    raise self._late(what, limit_s)
                for key, _ in ready:
                    line = self._serve(selector, key.fd, line, what)
        return answer

    def close(self) -> None:
        """End the program and all processes that it started."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVE_S)
        os.close(self._leash)  # now the reaper ends it
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log_rest()
        assert self._process.stderr is not None
        self._process.stderr.close()

    def _serve(self, selector: selectors.BaseSelector, fd: int, line: bytes, what: str) -> bytes:
        """Read or write a stream that is ready; returns what is still to be written."""
        if fd == self._stdin:
            try:
                line = line[os.write(fd, line) :]
            except BrokenPipeError:  # it may still answer, or give a reason on stderr
                line = b""
            if not line:
                selector.unregister(fd)
            return line
        data = os.read(fd, _CHUNK)
        if not data:
            selector.unregister(fd)
        self._hear(fd == self._stderr, data, what)
        return line

    def _hear(self, log: bool, data: bytes, what: str) -> None:
        """Take what it said; nothing on stdout is its end."""
        if log:
            self._log(data)
        elif data:
            self._answers += data
        else:
            reason = f"{self._name} {self._ending()} before it answered {what}."
            raise PlannerError(reason, kind="crashed")

    def _late(self, what: str, limit_s: float) -> PlannerError:
        return PlannerError(
            f"{self._name} did not answer {what} within {limit_s:g} s.", kind="hung"
        )

    def _next_line(self, what: str) -> bytes | None:
        line, newline, rest = self._answers.partition(b"\n")
        if newline and len(line) <= LONGEST_BYTES:
            self._answers = rest
            return line
        if len(line) > LONGEST_BYTES:
            raise PlannerError(
                f"{self._name} answered {what} with a line of more than {LONGEST_BYTES} bytes."
            )
        return None

    def _ending(self) -> str:
        """How the program ended, in words; the rest of its stderr goes to the log."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            return "closed its stdout"
        self._log_rest()
        if code > 128 or code < 0:  # the program, or the reaper itself
            return f"was ended by signal {code - 128 if code > 128 else -code}"
        return f"ended with exit code {code} (see log.txt)"

    def _log_rest(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._log(os.read(self._stderr, _CHUNK))

    def _log(self, data: bytes) -> None:
        """Copy its stderr to that of this process, which goes to log.txt."""
        kept = data[: max(0, LOGGED_BYTES - self._logged)]
        self._logged += len(kept)
        if kept:
            sys.stderr.write(kept.decode(errors="replace"))
        if len(kept) < len(data) and self._logged == LOGGED_BYTES:
            self._logged += 1  # reported once
            sys.stderr.write(f"\n{self._name}: more than {LOGGED_BYTES} bytes, dropped\n")


class ThreadedProcess(Process):
    """The same, by threads: one for each of its streams."""

    def __init__(self, name: str, command: list[str]) -> None:
        self._begin(name)
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                bufsize=0,
            )  # fmt: skip
        except OSError as error:
            raise PlannerError(f"{name} cannot be started: {error}", kind="crashed") from None
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._heard: queue.SimpleQueue[tuple[bool, bytes]] = queue.SimpleQueue()
        streams = (self._process.stdin, self._process.stdout, self._process.stderr)
        stdin, stdout, stderr = (one.fileno() for one in streams if one is not None)
        self._threads = [
            threading.Thread(target=self._write, args=(stdin,), daemon=True),
            threading.Thread(target=self._read, args=(stdout, False), daemon=True),
            threading.Thread(target=self._read, args=(stderr, True), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def ask(self, path: str, line: bytes, limit_s: float, what: str) -> bytes:
        """As of `Process`."""
        deadline = time.monotonic() + limit_s
        self._lines.put(line)
        while (answer := self._next_line(what)) is None:
            left_s = deadline - time.monotonic()
            try:
                log, data = self._heard.get(timeout=max(left_s, 0.0))
            except queue.Empty:
                raise self._late(what, limit_s) from None
            self._hear(log, data, what)
        return answer

    def close(self) -> None:
        """End the program."""
        self._lines.put(None)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVE_S)
        if self._process.poll() is None:
            system.kill_group(self._process.pid)  # it leads a group only where it made one
            self._process.kill()
        self._process.wait()
        self._log_rest()
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _write(self, stdin: int) -> None:
        while (line := self._lines.get()) is not None:
            while line:
                try:
                    line = line[os.write(stdin, line) :]
                except OSError:  # it may still answer, or give a reason on stderr
                    line = b""
        if self._process.stdin is not None:
            self._process.stdin.close()

    def _read(self, stream: int, log: bool) -> None:
        data = b" "
        while data:
            data = os.read(stream, _CHUNK)
            self._heard.put((log, data))

    def _log_rest(self) -> None:
        for thread in self._threads[1:]:
            thread.join(_GRACE_S)  # longer only where what it has started has its streams
        while not self._heard.empty():
            log, data = self._heard.get()
            if log:
                self._log(data)


def started(name: str, command: list[str]) -> Process:
    """The running program; ``name`` of it is for error messages."""
    return Process(name, command) if system.POLLS else ThreadedProcess(name, command)


def command_of(file: str | None, program: tuple[str, ...], arguments: tuple[str, ...]) -> list[str]:
    """The command line: this Python runs ``.py`` files if no program is named."""
    first = list(program)
    if file is not None:
        if not first and Path(file).suffix == ".py":
            first = [sys.executable]
        first.append(file)
    return [*first, *arguments]
