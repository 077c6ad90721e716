"""`serve`: a planner class of this package behind standard input and output, or HTTP.

A Python planner as a program or a server: ``python -m deepmf_sumo.planners.remote.serve NAME``.

So a planner runs in a process of its own, with its own memory and within a time limit, and a
planner in another language has something to be compared with. ``NAME`` is a plug-in (``idm``) or
``my_package.my_module:MyPlanner``; ``--settings`` is a JSON object; ``--port`` makes it a server on
127.0.0.1 (0 chooses a port; its address is the first line on stdout).
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Final

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import Case, Command, RoadMap, VehicleModel, View
from deepmf_sumo.errors import DeepmfError, PlannerError, UsageError
from deepmf_sumo.planners.base import Planner
from deepmf_sumo.planners.remote import protocol
from deepmf_sumo.planners.remote.protocol import Reset, ViewMessage

_LARGEST: Final = 2**28
"""Bytes of a question: the map of a city is some 10 MB."""

_EPISODES: Final = 64
"""A server forgets the oldest episodes beyond so many: nobody says that one has ended."""


class Answerer:
    """Answers the protocol's questions with planners of a name, one for each episode."""

    def __init__(self, name: str, settings: dict[str, Any]) -> None:
        self._plugin = plugins.load("planners", name)
        self._settings = plugins.settings("planners", name, settings)
        self._episodes: dict[str, tuple[Planner, RoadMap]] = {}
        self._lock = Lock()

    def answer(self, text: bytes) -> bytes:
        """The answer, as a line of JSON."""
        with self._lock:
            asked = protocol.read(text)
            told = self._begin(asked) if isinstance(asked, Reset) else self._act(asked)
        return json.dumps(told, allow_nan=False).encode() + b"\n"

    def _begin(self, told: Reset) -> dict[str, object]:
        planner: Planner = self._plugin.build(self._settings)
        case = protocol.case_of(told)
        planner.reset(case, np.random.default_rng(told.seed))
        for oldest in list(self._episodes)[: 1 - _EPISODES]:
            del self._episodes[oldest]
        self._episodes[told.episode] = (planner, case.road)
        return protocol.ready_answer(planner.model)

    def _act(self, told: ViewMessage) -> dict[str, object]:
        if told.episode not in self._episodes:
            raise PlannerError(f"a view of episode '{told.episode}' before its reset.")
        planner, road = self._episodes[told.episode]
        command = planner.act(protocol.view_of(told, road))
        return protocol.command_answer(command, told.step)


def on_streams(answerer: Answerer) -> None:
    """Answer on stdout what is asked on stdin, until that ends.

    What the planner prints goes to stderr, so that it does not stand between the answers.
    """
    with os.fdopen(os.dup(1), "wb", buffering=0) as answers:
        os.dup2(2, 1)
        for line in sys.stdin.buffer:
            answers.write(answerer.answer(line))


def on_port(answerer: Answerer, port: int) -> ThreadingHTTPServer:
    """A server that answers posts; ``serve_forever`` begins."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True
        wbufsize = -1

        def do_POST(self) -> None:
            """A question."""
            length = self.headers.get("Content-Length", "0")
            known = length.isascii() and length.isdecimal() and len(length) < 20
            body = self.rfile.read(int(length)) if known and int(length) <= _LARGEST else None
            try:
                if body is None:
                    self.close_connection = True  # what follows is not read
                    raise PlannerError(
                        f"Content-Length is {length!r:.80}; it must be a number of bytes, at most"
                        f" {_LARGEST}."
                    )
                status, answer = 200, answerer.answer(body)
            except DeepmfError as error:
                status, answer = 400, str(error).encode(errors="replace")
            self.send_response(status)
            if self.close_connection:
                self.send_header("Connection", "close")
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - http.server's
            """No line a step."""

    return ThreadingHTTPServer(("127.0.0.1", port), Handler)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and answer until nobody asks any more."""
    parser = argparse.ArgumentParser(prog="python -m deepmf_sumo.planners.remote.serve")
    parser.add_argument("name", help="a planner: a plug-in, or package.module:Class")
    parser.add_argument("--settings", default="{}", type=json.loads, help="JSON object")
    parser.add_argument("--port", type=int, help="be a server on 127.0.0.1 (0: any port)")
    parser.add_argument("--path", help="where modules are looked for, instead of the usual places")
    chosen = parser.parse_args(arguments)
    sys.path[:] = chosen.path.split(os.pathsep) if chosen.path else [str(Path.cwd()), *sys.path]
    try:
        answerer = Answerer(chosen.name, chosen.settings)
    except DeepmfError as error:
        parser.error(str(error))
    if chosen.port is None:
        on_streams(answerer)
        return
    server = on_port(answerer, chosen.port)
    sys.stdout.write(f"http://127.0.0.1:{server.server_port}\n")
    sys.stdout.flush()
    server.serve_forever()


if __name__ == "__main__":
    main()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """The episode is over; ``result`` is what its function returned."""

    result: Any


class _LeftError(DeepmfError):
    """The other thread does not go on with the episode."""


_LEAVE: Final = object()


class Turns:
    """Turns an episode inside out: here the simulation waits for the planner.

    Args:
        episode: simulates one with a planner, in a thread of its own; returns what came of it.
        model: parameters of the AV's IDM in SUMO.
    """

    def __init__(self, episode: Callable[[Planner], Any], model: VehicleModel | None) -> None:
        self._model = model
        self._views: SimpleQueue[View | Ended | BaseException] = SimpleQueue()
        self._commands: SimpleQueue[Any] = SimpleQueue()
        self._begun = False
        self._thread = Thread(target=self._run, args=(episode,), daemon=True)
        self._thread.start()

    def next(self, command: Command | None = None) -> View | Ended:
        """The view after a command (None: the first view), or that the episode has ended.

        What is raised in the simulation comes out here.
        """
        if command is not None:
            self._commands.put(command)
        came = self._views.get()
        if isinstance(came, BaseException):
            self._thread.join()
            raise came
        if isinstance(came, Ended):
            self._thread.join()
        return came

    def leave(self) -> None:
        """End the episode here, if it goes on."""
        self._commands.put(_LEAVE)
        self._thread.join()

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of the episode. Raises UsageError for adversaries that simulate several."""
        if self._begun:
            raise UsageError(
                "This adversary simulates an attack more than once before it decides, and an"
                " environment is stepped through once; use deepmf or none."
            )
        self._begun = True

    def act(self, view: View) -> Command:
        """The other thread's command."""
        self._views.put(view)
        command = self._commands.get()
        if command is _LEAVE:
            raise _LeftError
        checked: Command = command
        return checked

    def _run(self, episode: Callable[[Planner], Any]) -> None:
        try:
            ended = Ended(result=episode(self))
        except BaseException as error:  # noqa: BLE001 - it is raised again in the other thread
            self._views.put(error)
        else:
            self._views.put(ended)
