"""A server that is asked by HTTP, each time within a time limit for the whole exchange."""

import contextlib
import socket
import threading
import time
from http.client import HTTPConnection, HTTPException
from typing import Final
from urllib.parse import urlsplit

from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.doors.answers import LONGEST_BYTES

LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")


class Server:
    """A server, over a connection that is kept between questions.

    Args:
        name: of the server in messages.
        url: its address and the path before those of the questions.
    """

    def __init__(self, name: str, url: str) -> None:
        parts = urlsplit(url)
        self._name = name
        self._path = parts.path.rstrip("/")
        self._host, self._port = parts.hostname or "", parts.port
        self._connection: HTTPConnection | None = None

    def ask(self, path: str, body: bytes, limit_s: float, what: str) -> bytes:
        """The body of the answer. Raises PlannerError where none comes in time.

        Args:
            path: of the question, under the server's own.
            body: what is said.
            limit_s: for connecting, saying it and hearing the answer.
            what: is asked, for messages.
        """
        deadline = time.monotonic() + limit_s
        try:
            connection = self._connected(limit_s)
            status, answer = self._exchange(connection, path, body, deadline)
        except (OSError, HTTPException) as error:
            self.close()
            if time.monotonic() >= deadline:
                raise PlannerError(
                    f"{self._name} did not answer {what} within {limit_s:g} s."
                ) from None
            raise PlannerError(f"{self._name} cannot be asked for {what}: {error}.") from None
        if status != 200:
            raise PlannerError(
                f"{self._name} answered {what} with status {status}: {answer[:200]!r}."
            )
        if len(answer) > LONGEST_BYTES:
            raise PlannerError(
                f"{self._name} answered {what} with more than {LONGEST_BYTES} bytes."
            )
        return answer

    def close(self) -> None:
        """Close the connection."""
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
        """Status and body, up to one byte too many.

        A socket's own time limit begins anew with every byte, and a server may send one at a time:
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
