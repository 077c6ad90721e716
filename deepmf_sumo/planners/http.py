"""A server on this machine drives the AV: views and commands as JSON over HTTP.

``POST <url>/reset`` and ``POST <url>/act`` with the messages of `remote.protocol` as bodies; the
answers are the bodies of responses with status 200. The user starts the server, which may drive
several episodes at a time: every message names its own. A server that is late or answers with a
command that cannot be driven fails the run (`PlannerError`).
"""

import contextlib
import socket
import threading
import time
from functools import partial
from http.client import HTTPConnection, HTTPException
from typing import Final, Self
from urllib.parse import urlsplit

from pydantic import model_validator

from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote.client import RemotePlanner, RemoteSettings
from deepmf_sumo.planners.remote.protocol import LONGEST_BYTES

LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")


class Settings(RemoteSettings):
    """Address and limits of the server.

    Attributes:
        url: on this machine, e.g. ``http://127.0.0.1:8000/planner``.
    """

    url: str

    @model_validator(mode="after")
    def _is_on_this_machine(self) -> Self:
        try:
            parts = urlsplit(self.url)
            usable = parts.scheme == "http" and parts.port is not None
        except ValueError:  # not a port
            usable = False
        if not usable:
            raise ValueError(f"'{self.url}' must be like http://127.0.0.1:8000")
        if parts.hostname not in LOOPBACK:
            raise ValueError(
                f"'{self.url}' is not on this machine; use {' or '.join(LOOPBACK)}, and a tunnel"
                " to a server elsewhere"
            )
        return self


def build(settings: Settings) -> RemotePlanner:
    """The planner."""
    name = f"server {settings.url}"
    return RemotePlanner(name, settings, partial(HttpConnection, name, settings.url))


class HttpConnection:
    """A server, over one connection.

    Args:
        name: of the server in error messages.
        url: its address and the path before ``/reset`` and ``/act``.
    """

    def __init__(self, name: str, url: str) -> None:
        parts = urlsplit(url)
        self._name = name
        self._path = parts.path.rstrip("/")
        self._host, self._port = parts.hostname or "", parts.port
        self._connection: HTTPConnection | None = None

    def ask(self, path: str, body: bytes, limit_s: float, what: str) -> bytes:
        """The body of the response; see `PlannerConnection`."""
        deadline = time.monotonic() + limit_s
        try:
            connection = self._connected(limit_s)
            status, answer = self._exchange(connection, path, body, deadline)
        except (OSError, HTTPException) as error:
            self.close()
            if time.monotonic() >= deadline:
                raise PlannerError(
                    f"{self._name} did not answer {what} within {limit_s:g} s.", kind="hung"
                ) from None
            reason = f"{self._name} cannot be asked for {what}: {error}."
            raise PlannerError(reason, kind="crashed") from None
        if status != 200:  # its code has raised
            raise PlannerError(
                f"{self._name} answered {what} with status {status}: {answer[:200]!r}.",
                kind="crashed",
            )
        if len(answer) > LONGEST_BYTES:
            raise PlannerError(
                f"{self._name} answered {what} with more than {LONGEST_BYTES} bytes."
            )
        return answer

    def close(self) -> None:
        """Close the connection; the server keeps running."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _connected(self, limit_s: float) -> HTTPConnection:
        if self._connection is None:
            self._connection = HTTPConnection(self._host, self._port, timeout=limit_s)
            self._connection.connect()
        return self._connection

    def _exchange(
        self, connection: HTTPConnection, path: str, body: bytes, deadline: float
    ) -> tuple[int, bytes]:
        """Status and body; of a body that is too long, one byte more than the limit.

        A socket's own time limit starts again with every byte, and a server may send one at a time:
        so the connection is cut at the deadline.
        """
        cut = threading.Timer(deadline - time.monotonic(), _cut, [connection.sock])
        cut.daemon = True
        cut.start()
        try:
            headers = {"Content-Type": "application/json"}
            connection.request("POST", f"{self._path}/{path}", body, headers)
            response = connection.getresponse()
            answer = response.read(LONGEST_BYTES + 1)
        finally:
            cut.cancel()
        if time.monotonic() >= deadline:
            raise TimeoutError
        if not response.isclosed() or response.will_close:
            self.close()
        return response.status, answer


def _cut(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
