"""HTTP servers for programs of this machine: who may ask, for how long, and how many at a time.

A browser sends what any web page asks it to, also to this machine. Its requests name where they go
and where they come from (``Host``, ``Origin``, ``Sec-Fetch-Site``), which no page can change.
"""

import io
import socket
import sys
import threading
import time
from email.message import Message
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

NAMES: Final = ("localhost", "127.0.0.1", "[::1]")
"""Of this machine. Another name may be that of a page which has been given this address."""
_HTTP: Final = 80
_OWN: Final = frozenset({"same-origin", "none"})


def refused(headers: Message, port: int) -> str:
    """Why a request to a port of this machine is not answered; empty where it is.

    It is not where another web page asks, or a page of another name for this machine.
    """
    here = {f"{name}:{port}" for name in NAMES} | set(NAMES if port == _HTTP else ())
    hosts = [one.strip().lower() for one in headers.get_all("Host") or [""]]
    if len(hosts) != 1 or hosts[0] not in here:
        return f"Host must be localhost:{port}"
    for origin in headers.get_all("Origin") or []:
        if origin.strip().lower() not in {f"http://{one}" for one in here}:
            return "another web page may not ask"
    for site in headers.get_all("Sec-Fetch-Site") or []:
        if site.strip().lower() not in _OWN:
            return "another web page may not ask"
    return ""


class LocalHandler(BaseHTTPRequestHandler):
    """Answers only programs of this machine and its own pages; prints nothing.

    Attributes:
        within_s: time for a connection, from its first byte to its last; None: no limit.
    """

    within_s: float | None = None

    def setup(self) -> None:
        """Read no longer than ``within_s``."""
        super().setup()
        if self.within_s is not None:
            self.rfile = io.BufferedReader(_Limited(self.connection, self.within_s))

    def parse_request(self) -> bool:
        """Whether the request is to be answered; if not, it has been refused."""
        if not super().parse_request():
            return False
        why = refused(self.headers, int(self.connection.getsockname()[1]))
        if why:
            self.close_connection = True  # its content is not read
            self.send_error(HTTPStatus.FORBIDDEN, why)
        return not why

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - of the base class
        """Print no line for each request."""


class LocalServer(ThreadingHTTPServer):
    """A server on 127.0.0.1 that no other machine reaches.

    Args:
        port: 0 takes a free one.
        handler: answers.
        most: connections at a time; those above are closed. None: no limit.

    Raises OSError for a port that is in use.
    """

    daemon_threads = True

    def __init__(self, port: int, handler: type[LocalHandler], most: int | None = None) -> None:
        self._places = None if most is None else threading.Semaphore(most)
        super().__init__(("127.0.0.1", port), handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, if there is place."""
        if self._places is None or self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and leave the place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            if self._places is not None:
                self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that leaves before its answer is no error; others are printed."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class _Limited(io.RawIOBase):
    """What a connection sends within a time; then it is as if the other side were silent."""

    def __init__(self, connection: socket.socket, within_s: float) -> None:
        self._connection = connection
        self._until = time.monotonic() + within_s

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self._until - time.monotonic()
        if left <= 0.0:
            raise TimeoutError
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)
