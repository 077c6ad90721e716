"""A planner as a process: its start, and answers in time."""

import contextlib
import os
import selectors
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import Case, Command, VehicleModel, View
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote import http_client, protocol, reaper
from deepmf_sumo.planners.remote.http_client import DoorSettings
from deepmf_sumo.planners.remote.protocol import LONGEST_BYTES

LOGGED_BYTES: Final = 1_000_000
"""Of what the program writes to stderr in an episode; the rest is dropped, and said to be."""

_CHUNK: Final = 65_536
_LEAVE_S: Final = 0.2
"""For the program to end by itself when its stdin does."""
_GRACE_S: Final = 1.0
"""For the reaper to end everything, before it is ended itself."""


class Process:
    """A running program.

    Args:
        name: of the program in messages.
        command: what to start.
    """

    def __init__(self, name: str, command: list[str]) -> None:
        self._name = name
        self._answers = b""
        self._logged = 0
        theirs, self._leash = os.pipe()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", reaper.__file__, str(theirs), *command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                pass_fds=[theirs],
                start_new_session=True,  # else it would be killed before it has ended the program
            )
        finally:
            os.close(theirs)
        streams = (self._process.stdin, self._process.stdout, self._process.stderr)
        self._stdin, self._stdout, self._stderr = (
            stream.fileno() for stream in streams if stream is not None
        )
        for stream in (self._stdin, self._stdout, self._stderr):
            os.set_blocking(stream, False)

    def ask(self, line: bytes, limit_s: float, what: str) -> bytes:
        """The program's next line. Raises PlannerError where none comes in time.

        Args:
            line: what is said to it first.
            limit_s: for saying it and hearing the answer.
            what: is asked, for messages.
        """
        deadline = time.monotonic() + limit_s
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdin, selectors.EVENT_WRITE)
            selector.register(self._stdout, selectors.EVENT_READ)
            selector.register(self._stderr, selectors.EVENT_READ)
            while (answer := self._next_line(what)) is None:
                ready = selector.select(max(0.0, deadline - time.monotonic()))
                if time.monotonic() >= deadline:
                    raise PlannerError(f"{self._name} did not answer {what} within {limit_s:g} s.")
                for key, _ in ready:
                    line = self._serve(selector, key.fd, line, what)
        return answer

    def close(self) -> None:
        """End the program and all that it started."""
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
        with contextlib.suppress(BlockingIOError):
            self._log(os.read(self._stderr, _CHUNK))
        assert self._process.stderr is not None
        self._process.stderr.close()

    def _serve(self, selector: selectors.BaseSelector, fd: int, line: bytes, what: str) -> bytes:
        """Do what a stream is ready for; what is left to be said."""
        if fd == self._stdin:
            try:
                line = line[os.write(fd, line) :]
            except BrokenPipeError:  # it may still answer, or say on stderr why not
                line = b""
            if not line:
                selector.unregister(fd)
            return line
        data = os.read(fd, _CHUNK)
        if not data:
            selector.unregister(fd)
        if fd == self._stderr:
            self._log(data)
        elif data:
            self._answers += data
        else:
            raise PlannerError(f"{self._name} {self._ending()} before it answered {what}.")
        return line

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
        """How it ended, in words; its last words on stderr go to the log."""
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            return "closed its stdout"
        with contextlib.suppress(BlockingIOError):
            self._log(os.read(self._stderr, _CHUNK))
        if code > 128 or code < 0:  # the program, or the reaper itself
            return f"was ended by signal {code - 128 if code > 128 else -code}"
        return f"ended with exit code {code} (see log.txt)"

    def _log(self, data: bytes) -> None:
        """Pass on what it writes to stderr: this process's goes to log.txt."""
        kept = data[: max(0, LOGGED_BYTES - self._logged)]
        self._logged += len(kept)
        if kept:
            sys.stderr.write(kept.decode(errors="replace"))
        if len(kept) < len(data) and self._logged == LOGGED_BYTES:
            self._logged += 1  # said once
            sys.stderr.write(f"\n{self._name}: more than {LOGGED_BYTES} bytes, dropped\n")


def command_of(file: str | None, program: tuple[str, ...], arguments: tuple[str, ...]) -> list[str]:
    """The command line: ``.py`` files are run by this Python where no program is named."""
    first = list(program)
    if file is not None:
        if not first and Path(file).suffix == ".py":
            first = [sys.executable]
        first.append(file)
    return [*first, *arguments]


class ProgramPlanner:
    """Starts the program for every episode, and ends it afterwards with all that it started.

    Args:
        name: of the program in messages.
        command: what to start.
        settings: limits.
    """

    def __init__(self, name: str, command: list[str], settings: DoorSettings) -> None:
        self._name = name
        self._command = command
        self._settings = settings
        self._process: Process | None = None
        self._episode = ""
        self._model: VehicleModel | None = None

    @property
    def model(self) -> VehicleModel | None:
        """What the program asked for when it was ready."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start the program. Its seed is the case's: ``rng`` also serves the adversary."""
        self.close()
        self._episode = http_client.episode_of(case)
        self._process = Process(self._name, self._command)
        line = http_client.reset_message(case, road=self._settings.road)
        answer = self._process.ask(line, self._settings.start_budget_s, "the reset")
        self._model = protocol.read_ready(self._name, answer)

    def act(self, view: View) -> Command:
        """The program's command. Raises PlannerError."""
        assert self._process is not None
        line = http_client.view_message(self._episode, view, self._settings.history_steps)
        answer = self._process.ask(line, self._settings.step_budget_s, f"step {view.step}")
        return protocol.read_command(self._name, answer, view.step)

    def close(self) -> None:
        """End the program, and all that it started."""
        if self._process is not None:
            self._process.close()
            self._process = None
