"""TraCI between a client and SUMO, which has a second client behind it: a process of its own.

Messages go to SUMO, and SUMO's answers go back, without what `attach` has subscribed to. ``load``
ends SUMO, and the parent process starts it anew: SUMO's own ``load`` waits for ever where another
of its clients is within a step of several seconds. Between
two messages it looks for the next one for a while before it sleeps: waking up a process costs more
than SUMO needs for most commands.

Source of the protocol: SUMO's documentation, TraCI/Protocol. A message is its length (4 bytes) and
commands; a command is its length (1 byte, or 0 and 4 bytes), its number and its content.
"""

import contextlib
import json
import multiprocessing
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Final, Literal

from deepmf_sumo.live.observer import MARK

LOAD, STEP, ORDER, CLOSE = 0x01, 0x02, 0x03, 0x7F
"""TraCI's numbers of commands."""
LARGEST: Final = 64 * 2**20
"""Bytes of a message."""
Kind = Literal["joined", "unused", "left", "load", "complaint"]
Said = tuple[Kind, str]
"""What the parent process is told, and the sentence of a complaint, or JSON of what to load."""
Tell = Callable[..., None]

_OURS: Final = frozenset({LOAD, STEP, ORDER, CLOSE})
_OK: Final = b"\x00"
_STRINGS: Final = 0x0E
_START_S: Final = 60.0
_AGAIN_S: Final = 0.05
_END_S: Final = 3.0
_AWAKE_S: Final = 0.001
_PIECE: Final = 2**16
_INT: Final = struct.Struct("!i")


class ProtocolError(Exception):
    """A client has sent what is not TraCI."""


class Wire:
    """Messages over a socket."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection
        self._read = b""

    def send(self, commands: bytes) -> None:
        """A message. Raises OSError."""
        self._socket.sendall(_INT.pack(len(commands) + 4) + commands)

    def receive(self) -> bytes | None:
        """The commands of a message; None where the other side has closed before it.

        Raises ProtocolError for a length that no message has, or half a message, and OSError.
        """
        data = self._read or self._first()
        if not data:
            return None
        data = self._until(data, 4)
        length = _INT.unpack_from(data)[0]
        if not 4 < length <= LARGEST:
            raise ProtocolError(f"a message of {length} bytes is not TraCI")
        data = self._until(data, length)
        self._read = data[length:]
        return data[4:length]

    def _first(self) -> bytes:
        """The first piece of a message; empty where the other side has closed."""
        end = time.monotonic() + _AWAKE_S
        self._socket.setblocking(False)
        try:
            while time.monotonic() < end:
                with contextlib.suppress(BlockingIOError):
                    return self._socket.recv(_PIECE)
                _yield()
        finally:
            self._socket.setblocking(True)
        return self._socket.recv(_PIECE)

    def _until(self, data: bytes, length: int) -> bytes:
        """At least that many bytes, which begin with the data."""
        if len(data) >= length:
            return data
        found = bytearray(data)
        while len(found) < length:
            piece = self._socket.recv(_PIECE)
            if not piece:
                raise ProtocolError("it left in the middle of a message")
            found += piece
        return bytes(found)


def _yield() -> None:
    """Let another process have this core; Windows has no call of that name."""
    getattr(os, "sched_yield", lambda: time.sleep(0))()


def relay(listener: socket.socket, inner: int, parent: Connection, sumo_pid: int) -> None:
    """One client's life; others that come meanwhile are turned away. Then the process ends.

    Args:
        listener: where the client comes.
        inner: SUMO's port on this machine.
        parent: what happens is told there; after ``load`` it answers with the port and the process
            of the SUMO that it has started.
        sumo_pid: SUMO's process, which ends where the parent is killed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this
    pids = [sumo_pid]
    threading.Thread(target=_end_with_parent, args=(pids,), daemon=True).start()
    one_at_a_time = threading.Lock()

    def tell(kind: Kind, text: str = "") -> None:
        with one_at_a_time, contextlib.suppress(OSError):
            parent.send((kind, text))

    client, _ = listener.accept()
    tell("joined")
    threading.Thread(target=_refuse, args=(listener, tell), daemon=True).start()
    with client:
        try:
            with contextlib.closing(_Sumo(inner, parent, pids, tell)) as sumo:
                _pass_on(Wire(client), sumo, tell)
        except (OSError, EOFError) as error:
            tell("complaint", f"the connection broke off: {error}")
            tell("left")


class _Sumo:
    """SUMO as its first client, which `load` replaces by another. Raises OSError, EOFError."""

    def __init__(self, inner: int, parent: Connection, pids: list[int], tell: Tell) -> None:
        self._parent, self._pids, self._tell = parent, pids, tell
        self._socket = _to_sumo(inner)
        self._wire = Wire(self._socket)

    def asked(self, commands: bytes) -> bytes:
        """SUMO's answer. Raises ProtocolError where it has ended."""
        return _asked(self._wire, commands)

    def load(self, arguments: list[str]) -> None:
        """Go on with a SUMO of these arguments, once `attach` has left the one before."""
        self._tell("load", json.dumps(arguments))  # before SUMO knows: `attach` goes on at once
        self.asked(_command(CLOSE, b""))
        self.close()
        inner, self._pids[0] = self._parent.recv()
        self._socket = _to_sumo(inner)
        self._wire = Wire(self._socket)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _pass_on(client: Wire, sumo: _Sumo, tell: Tell) -> None:
    """All that the client says, until it closes. Raises OSError, EOFError."""
    closed = stepped = False
    try:
        while (body := client.receive()) is not None:
            commands = list(commands_of(body))
            numbers = {number_of(one) for one in commands}
            stepped = stepped or STEP in numbers
            if CLOSE in numbers:
                closed = True
                tell("left")  # before SUMO knows: the other client goes on at once
            if numbers & _OURS:
                client.send(b"".join(_answered(sumo, one) for one in commands))
            else:
                client.send(sumo.asked(body))
            if closed:
                return
    except ProtocolError as error:
        tell("complaint", f"the client was disconnected: {error}")
    finally:
        if not stepped:
            tell("complaint", "the client left before its first step: nothing happened")
            tell("unused")
        if not closed:  # SUMO ends for all where a client disappears
            tell("left")
            with contextlib.suppress(OSError, ProtocolError):
                sumo.asked(_command(CLOSE, b""))


def _end_with_parent(pids: list[int]) -> None:
    """End SUMO (its only one is in ``pids``) and this process with a parent that cannot do it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        with contextlib.suppress(OSError):
            os.kill(pids[0], signal.SIGTERM)
            time.sleep(_END_S)  # it does not listen while it waits for clients
            os.kill(pids[0], getattr(signal, "SIGKILL", signal.SIGTERM))
        os._exit(1)


def _refuse(listener: socket.socket, tell: Tell) -> None:
    while True:
        other, _ = listener.accept()
        tell("complaint", "a second client was turned away: there is one place")
        other.close()  # now: the first client may end this process as soon as it sees that


def _to_sumo(inner: int) -> socket.socket:
    """A connection to SUMO as its first client. Raises OSError where it does not come up."""
    end = time.monotonic() + _START_S
    while True:
        try:
            sumo = socket.create_connection(("localhost", inner))
            break
        except ConnectionRefusedError:
            if time.monotonic() > end:
                raise
            time.sleep(_AGAIN_S)
    _asked(Wire(sumo), _command(ORDER, _INT.pack(1)))
    return sumo


def commands_of(body: bytes) -> Iterator[bytes]:
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
    return int(_INT.unpack_from(data, at + 1)[0])


def number_of(command: bytes) -> int:
    """The number of a command. Raises ProtocolError where it has none."""
    place = 1 if command[0] else 5
    if len(command) <= place:
        raise ProtocolError("a command has no number")
    return command[place]


def _command(number: int, content: bytes) -> bytes:
    return bytes((2 + len(content), number)) + content


def _asked(sumo: Wire, commands: bytes) -> bytes:
    """SUMO's answer."""
    sumo.send(commands)
    answer = sumo.receive()
    if answer is None:
        raise ProtocolError("SUMO has ended")
    return answer


def _answered(sumo: _Sumo, command: bytes) -> bytes:
    """The answer to one command; some do not reach SUMO as they are."""
    number = number_of(command)
    if number == ORDER:
        return _done(ORDER)  # the number of the client is ours to give
    if number == LOAD:
        sumo.load(_strings(command))
        return _done(LOAD)
    answer = sumo.asked(command)
    return _without_ours(answer) if number == STEP else answer


def _strings(command: bytes) -> list[str]:
    """The list of strings that a command contains. Raises ProtocolError."""
    at = 2 if command[0] else 6
    try:
        (kind, count), at = struct.unpack_from("!Bi", command, at), at + 5
        found: list[str] = []
        while len(found) < count:
            (size,) = _INT.unpack_from(command, at)
            end = at + 4 + max(size, 0)
            found.append(command[at + 4 : end].decode())
            at = end
    except (struct.error, UnicodeDecodeError):
        kind = None
    if kind != _STRINGS or at != len(command) or any("\0" in one for one in found):
        raise ProtocolError("load is not followed by a list of strings")
    return found


def _done(number: int) -> bytes:
    """The status of a command that is done."""
    content = bytes((number,)) + _OK + _INT.pack(0)
    return bytes((1 + len(content),)) + content


def _without_ours(answer: bytes) -> bytes:
    """The answer to a step without the results of subscriptions that `attach` has made."""
    if MARK.encode() not in answer:
        return answer
    begin = _length(answer, 0)
    kept, at = [], begin + 4
    for _ in range(_INT.unpack_from(answer, begin)[0]):
        end = at + _length(answer, at)
        if not _object(answer, at).startswith(MARK.encode()):
            kept.append(answer[at:end])
        at = end
    return answer[:begin] + _INT.pack(len(kept)) + b"".join(kept)


def _object(data: bytes, at: int) -> bytes:
    """What a subscription's result is of."""
    start = at + (1 if data[at] else 5) + 1
    length = _INT.unpack_from(data, start)[0]
    return data[start + 4 : start + 4 + length]
