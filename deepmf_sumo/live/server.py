"""A TraCI server with SUMO and attacks behind it: a client takes it for SUMO.

SUMO inside has two clients, `attach` and the one that connects here. TraCI needs a number for each
of several clients (``setOrder``); the `Server` gives it for its client, which needs no change.
Its messages go to SUMO, and SUMO's answers go back, without what `attach` has subscribed to.

Source of the protocol: SUMO's documentation, TraCI/Protocol. A message is its length (4 bytes) and
commands; a command is its length (1 byte, or 0 and 4 bytes), its number and its content.
"""

import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.live.observer import MARK
from deepmf_sumo.network import sumo_tools

LOAD, STEP, ORDER, CLOSE = 0x01, 0x02, 0x03, 0x7F
"""TraCI's numbers of commands."""
LARGEST: Final = 64 * 2**20
"""Bytes of a message."""
_OK: Final = b"\x00"
_ERROR: Final = b"\xff"
_START_S: Final = 60.0
_END_S: Final = 3.0
_AGAIN_S: Final = 0.05
_LOOK_S: Final = 0.2
_NO_LOAD: Final = (
    "deepmf-sumo serve attacks one simulation: end it and start serve again with the other one"
)


class ProtocolError(Exception):
    """A client has sent what is not TraCI."""


class Server:
    """SUMO with a port for `attach`, and a port that looks like SUMO's own.

    Args:
        config: a .sumocfg.
        port: for the client; 0 takes a free one.
        options: of SUMO, beside the configuration.
        gui: start sumo-gui.

    Attributes:
        port: as given, or the one that was free. inner: the port for `attach`.
        joined: set once the client has connected. unused: set once it has left without a step.
        complaints: sentences on clients that were refused or broke off.

    Raises UsageError for a port that is in use, SimulationError where SUMO does not start.
    """

    def __init__(
        self, config: Path, port: int, options: Sequence[str] = (), *, gui: bool = False
    ) -> None:
        self.complaints: list[str] = []
        self.joined, self.unused = threading.Event(), threading.Event()
        self._listener = _listening(port)
        self.port = int(self._listener.getsockname()[1])
        self.inner = _free_port()
        program = sumo_tools.program("sumo-gui" if gui else "sumo")
        ports = ["--remote-port", str(self.inner), "--num-clients", "2"]
        start = ["--start", "--quit-on-end"] if gui else []
        self._sumo = subprocess.Popen(
            [str(program), "-c", str(config), *ports, *start, *options],
            env=sumo_tools.environment(),
            stdout=subprocess.DEVNULL,
        )
        self._thread = threading.Thread(target=self._serve, name="traci server", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether SUMO has."""
        return self._sumo.poll() is not None

    def check(self) -> None:
        """Raise SimulationError where SUMO has ended by an error."""
        if code := self._sumo.poll():
            raise SimulationError(f"SUMO ended with exit code {code}; see what it printed.")

    def stay(self, stopped: Callable[[], bool]) -> None:
        """Until the client has left and SUMO has ended, or until ``stopped``."""
        while not stopped() and (self._thread.is_alive() or not self.ended):
            self._thread.join(_LOOK_S)
            with suppress(subprocess.TimeoutExpired):
                self._sumo.wait(_LOOK_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._listener.close()
        self._sumo.terminate()
        try:
            self._sumo.wait(_END_S)
        except subprocess.TimeoutExpired:  # it does not listen while it waits for clients
            self._sumo.kill()
            self._sumo.wait()

    def _serve(self) -> None:
        """The client's life; others that come meanwhile are turned away."""
        try:
            client, _ = self._listener.accept()
        except OSError:  # closed before one came
            return
        self.joined.set()
        refusing = threading.Thread(target=self._refuse, name="traci refusals", daemon=True)
        refusing.start()
        with client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            try:
                with self._to_sumo() as sumo:
                    self._pass_on(client, sumo)
            except OSError as error:
                self.complaints.append(f"the connection broke off: {error}")

    def _pass_on(self, client: socket.socket, sumo: socket.socket) -> None:
        """All that the client says, until it closes. Raises OSError."""
        closed = stepped = False
        try:
            for commands in _messages(client):
                numbers = {_number(one) for one in commands}
                closed, stepped = closed or CLOSE in numbers, stepped or STEP in numbers
                _send(client, b"".join(_answered(sumo, one) for one in commands))
        except ProtocolError as error:
            self.complaints.append(f"the client was disconnected: {error}")
        finally:
            if not stepped:
                self.complaints.append("the client left before its first step: nothing happened")
                self.unused.set()
            if not closed:  # SUMO ends for all where a client disappears
                with suppress(OSError, ProtocolError):
                    _answered(sumo, _command(CLOSE, b""))

    def _refuse(self) -> None:
        while True:
            try:
                other, _ = self._listener.accept()
            except OSError:
                return
            other.close()
            self.complaints.append("a second client was turned away: there is one place")

    def _to_sumo(self) -> socket.socket:
        """A connection to SUMO as its first client. Raises OSError where it does not come up."""
        end = time.monotonic() + _START_S
        while True:
            try:
                sumo = socket.create_connection(("localhost", self.inner))
                break
            except ConnectionRefusedError:
                if self.ended or time.monotonic() > end:
                    raise
                time.sleep(_AGAIN_S)
        sumo.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _answered(sumo, _command(ORDER, struct.pack("!i", 1)), whole=True)
        return sumo


def _listening(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(sys.platform != "win32"))
    try:
        listener.bind(("localhost", port))
    except OSError as error:
        listener.close()
        raise UsageError(f"--port {port} cannot be used: {error.strerror}.") from None
    listener.listen()
    return listener


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])


def _messages(client: socket.socket) -> Iterator[list[bytes]]:
    """The commands of each message, until the client closes. Raises ProtocolError."""
    while True:
        body = _received(client)
        if body is None:
            return
        yield list(_commands(body))


def _received(connection: socket.socket) -> bytes | None:
    """A message without its length; None where the other side has closed before it."""
    head = _exactly(connection, 4)
    if not head:
        return None
    length = struct.unpack("!i", head)[0] - 4
    if not 0 < length <= LARGEST:
        raise ProtocolError(f"a message of {length + 4} bytes is not TraCI")
    body = _exactly(connection, length)
    if len(body) < length:
        raise ProtocolError("it left in the middle of a message")
    return body


def _exactly(connection: socket.socket, count: int) -> bytes:
    """That many bytes, fewer where the other side closes."""
    found = bytearray()
    while len(found) < count:
        piece = connection.recv(min(count - len(found), 2**16))
        if not piece:
            break
        found += piece
    return bytes(found)


def _commands(body: bytes) -> Iterator[bytes]:
    """The commands of a message, each with its length. Raises ProtocolError."""
    at = 0
    while at < len(body):
        end = at + _length(body, at)
        if not at + 1 < end <= len(body):
            raise ProtocolError("a command is longer than its message")
        yield body[at:end]
        at = end


def _length(data: bytes, at: int) -> int:
    """Of the command or response there, its length field included."""
    if data[at]:
        return data[at]
    if len(data) < at + 5:
        raise ProtocolError("a length is cut off")
    return int(struct.unpack_from("!i", data, at + 1)[0])


def _number(command: bytes) -> int:
    place = 1 if command[0] else 5
    if len(command) <= place:
        raise ProtocolError("a command has no number")
    return command[place]


def _command(number: int, content: bytes) -> bytes:
    return bytes((2 + len(content), number)) + content


def _send(connection: socket.socket, body: bytes) -> None:
    connection.sendall(struct.pack("!i", len(body) + 4) + body)


def _answered(sumo: socket.socket, command: bytes, *, whole: bool = False) -> bytes:
    """SUMO's answer to one command; ``whole``: also to those that it must not get of a client."""
    number = _number(command)
    if not whole and number == ORDER:
        return _status(ORDER, _OK, "")  # the number of the client is ours to give
    if not whole and number == LOAD:
        return _status(LOAD, _ERROR, _NO_LOAD)
    _send(sumo, command)
    answer = _received(sumo)
    if answer is None:
        raise ProtocolError("SUMO has ended")
    return _without_ours(answer) if number == STEP else answer


def _status(number: int, result: bytes, text: str) -> bytes:
    encoded = text.encode()
    content = bytes((number,)) + result + struct.pack("!i", len(encoded)) + encoded
    return bytes((1 + len(content),)) + content


def _without_ours(answer: bytes) -> bytes:
    """The answer to a step without the results of subscriptions that `attach` has made."""
    begin = _length(answer, 0)
    if len(answer) < begin + 4:  # an error: there is nothing behind its status
        return answer
    kept, at = [], begin + 4
    for _ in range(struct.unpack_from("!i", answer, begin)[0]):
        end = at + _length(answer, at)
        if not _object(answer, at).startswith(MARK.encode()):
            kept.append(answer[at:end])
        at = end
    return answer[:begin] + struct.pack("!i", len(kept)) + b"".join(kept)


def _object(data: bytes, at: int) -> bytes:
    """What a subscription's result is of."""
    start = at + (1 if data[at] else 5) + 1
    length = struct.unpack_from("!i", data, start)[0]
    return data[start + 4 : start + 4 + length]
