"""A Python planner as a program or a server: ``python -m deepmf_sumo.planners.doors.serve NAME``.

So a planner runs in a process of its own, with its own memory and within a time limit, and a
planner in another language has something to be compared with. ``NAME`` is a plug-in (``idm``) or
``my_package.my_module:MyPlanner``; ``--settings`` is a JSON object; ``--port`` makes it a server on
127.0.0.1 (0 chooses a port; its address is the first line on stdout).
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any, Final

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.datatypes import RoadMap
from deepmf_sumo.errors import DeepmfError, PlannerError
from deepmf_sumo.planners.base import Planner
from deepmf_sumo.planners.doors import hearing
from deepmf_sumo.planners.doors.messages import Reset, ViewMessage

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
            asked = hearing.read(text)
            told = self._begin(asked) if isinstance(asked, Reset) else self._act(asked)
        return json.dumps(told, allow_nan=False).encode() + b"\n"

    def _begin(self, told: Reset) -> dict[str, object]:
        planner: Planner = self._plugin.build(self._settings)
        case = hearing.case_of(told)
        planner.reset(case, np.random.default_rng(told.seed))
        for oldest in list(self._episodes)[: 1 - _EPISODES]:
            del self._episodes[oldest]
        self._episodes[told.episode] = (planner, case.road)
        return hearing.ready_answer(planner.model)

    def _act(self, told: ViewMessage) -> dict[str, object]:
        if told.episode not in self._episodes:
            raise PlannerError(f"a view of episode '{told.episode}' before its reset.")
        planner, road = self._episodes[told.episode]
        command = planner.act(hearing.view_of(told, road))
        return hearing.command_answer(command, told.step)


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
    parser = argparse.ArgumentParser(prog="python -m deepmf_sumo.planners.doors.serve")
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
