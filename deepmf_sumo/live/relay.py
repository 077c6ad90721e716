"""TraCI between a client and SUMO, which has a second client behind it: a process of its own.

Messages go to SUMO, and SUMO's answers go back, without what `attach` has subscribed to. ``load``
ends SUMO, and the parent process starts it anew: SUMO's own ``load`` waits for ever where another
of its clients is within a step of several seconds. Files that the client names are in one folder,
see `kept_files`. A SUMO that does not answer, as after some malformed commands, is ended. Between
two messages it looks for the next one for a while before it sleeps: waking up a process costs more
than SUMO needs for most commands.

Source of the protocol: SUMO's documentation, TraCI/Protocol. A message is its length (4 bytes) and
commands; a command is its length (1 byte, or 0 and 4 bytes), its number and its content.
"""

import contextlib
import json
import math
import multiprocessing
import os
import select
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, Literal

from deepmf_sumo import system
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.live import MARK
from deepmf_sumo.live.kept_files import SET_GUI, SET_SIMULATION, KeptFiles, RefusedError, framed
from deepmf_sumo.sumo.simulation.sumo_outputs import confined

LOAD, STEP, ORDER, CLOSE, HALF_STEP = 0x01, 0x02, 0x03, 0x7F, 0x7D
GET_SIMULATION: Final = 0xAB
"""TraCI's numbers of commands."""
_TIME, _STEP_LENGTH, _OPTION = 0x66, 0x7B, 0x32
_SUBSCRIBED: Final = 0xEB
"""A result of a subscription to variables of the simulation."""
_EVENTS: Final = frozenset({*range(0x68, 0x7B), *range(0x24, 0x28), 0x89, 0x8A})
"""Variables of the simulation on what has happened in a step: departures, arrivals, stops ..."""
_DOUBLE, _STRING = 0x0B, 0x0C
LARGEST: Final = 64 * 2**20
"""Bytes of a message."""
Kind = Literal["joined", "unused", "left", "load", "complaint", "stuck"]
Said = tuple[Kind, str]
"""What the parent process is told, and the sentence of a complaint, or JSON of what to load."""
Tell = Callable[..., None]

_OURS: Final = frozenset({LOAD, STEP, ORDER, CLOSE, HALF_STEP, SET_SIMULATION, SET_GUI})
_OK, _ERROR = b"\x00", b"\xff"
_STRINGS: Final = 0x0E
_START_S: Final = 60.0
_AGAIN_S: Final = 0.05
_END_S: Final = 3.0
_LOOK_S: Final = 0.5
_GONE_S: Final = 10.0
"""For SUMO's answer to a client that has left."""
_ANSWER_S: Final = 20.0
"""For SUMO's answer to anything but a step, or a state: others take it milliseconds."""
_AWAKE_S: Final = 0.001
_PIECE: Final = 2**16
_INT: Final = struct.Struct("!i")
_FLOAT: Final = struct.Struct("!d")


class ProtocolError(Exception):
    """A client has sent what is not TraCI."""


class StuckError(Exception):
    """SUMO does not answer; the message says why it is not waited for any longer."""


class Wire:
    """Messages over a socket."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection
        self._read = b""

    def send(self, commands: bytes) -> None:
        """A message. Raises OSError."""
        self._socket.sendall(_INT.pack(len(commands) + 4) + commands)

    def receive(self, meanwhile: Callable[[], None] | None = None) -> bytes | None:
        """The commands of a message; None where the other side has closed before it.

        ``meanwhile``: called now and then until it begins.

        Raises ProtocolError for a length that no message has, or half a message, and OSError.
        """
        data = self._read or self._first(meanwhile)
        if not data:
            return None
        data = self._until(data, 4)
        length = _INT.unpack_from(data)[0]
        if not 4 < length <= LARGEST:
            raise ProtocolError(f"a message of {length} bytes is not TraCI")
        data = self._until(data, length)
        self._read = data[length:]
        return data[4:length]

    @property
    def gone(self) -> bool:
        """Whether the other side has closed, also where there is something left to read."""
        return system.hung_up(self._socket)

    def _first(self, meanwhile: Callable[[], None] | None) -> bytes:
        """The first piece of a message; empty where the other side has closed."""
        end = time.monotonic() + _AWAKE_S
        self._socket.setblocking(False)
        try:
            while time.monotonic() < end:
                with contextlib.suppress(BlockingIOError):
                    return self._socket.recv(_PIECE)
                system.yield_core()
        finally:
            self._socket.setblocking(True)
        while meanwhile is not None and not select.select([self._socket], [], [], _LOOK_S)[0]:
            meanwhile()
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


def relay(
    listener: socket.socket, inner: int, parent: Connection, sumo_pid: int, folder: Path,
    *, gui: bool = False, step_s: float | None = None,
) -> None:  # fmt: skip
    """One client's life; others that come meanwhile are turned away. Then the process ends.

    Args:
        listener: where the client comes.
        inner: SUMO's port on this machine.
        parent: what happens is told there; after ``load`` it answers with the port and the process
            of the SUMO that it has started, and with ``step_s``.
        sumo_pid: SUMO's process, which ends where the parent is killed.
        folder: for files that the client has SUMO write.
        gui: it is sumo-gui, which does not answer while its user pauses it.
        step_s: of the client's steps without an end of their own; None: they are SUMO's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this
    system.let_interrupts_through()
    pids = [sumo_pid]
    threading.Thread(target=_end_with_parent, args=(pids,), daemon=True).start()
    _serve(listener, inner, parent, pids, folder, gui=gui, step_s=step_s)


def _serve(
    listener: socket.socket, inner: int, parent: Connection, pids: list[int], folder: Path,
    *, gui: bool = False, step_s: float | None = None,
) -> None:  # fmt: skip
    one_at_a_time = threading.Lock()

    def tell(kind: Kind, text: str = "") -> None:
        with one_at_a_time, contextlib.suppress(OSError):
            parent.send((kind, text))

    client, _ = listener.accept()
    tell("joined")
    threading.Thread(target=_refuse, args=(listener, tell), daemon=True).start()
    with client:
        outside = Wire(client)
        watched = None if gui else outside
        try:
            with contextlib.closing(_Sumo(inner, parent, pids, tell, watched, step_s)) as sumo:
                _pass_on(outside, _Filter(sumo, folder), tell)
        except StuckError as error:
            tell("complaint", f"SUMO was ended: {error}")
            tell("stuck")  # before it ends: `attach` sees that immediately
            tell("left")
            with contextlib.suppress(ProcessLookupError):
                system.kill(pids[0])  # it may heed no other
        except (OSError, EOFError) as error:
            tell("complaint", f"the connection broke off: {error}")
            tell("left")


class _Sumo:
    """SUMO as its first client, which `load` replaces by another. Raises OSError, EOFError.

    ``client``: whom SUMO has to answer; None: it is waited for without a limit.
    ``step_s``: of the client's steps; None: they are SUMO's.
    """

    def __init__(
        self, inner: int, parent: Connection, pids: list[int], tell: Tell, client: Wire | None,
        step_s: float | None,
    ) -> None:  # fmt: skip
        self._parent, self._pids, self._tell, self._client = parent, pids, tell, client
        self.step_s = step_s
        self._join(inner)

    def _join(self, inner: int) -> None:
        self._socket = _to_sumo(inner)
        self._wire = Wire(self._socket)
        self._patience_s = _START_S  # it answers only when `attach` has joined, too

    def asked(self, commands: bytes, *, may_take_long: bool = False) -> bytes:
        """SUMO's answer.

        Raises ProtocolError where it has ended; StuckError where it does not answer in time, or
        not within a while after the client has left.
        """
        client, begin, left_since = self._client, time.monotonic(), math.inf
        within_s = math.inf if may_take_long else self._patience_s

        def look() -> None:
            nonlocal left_since
            now = time.monotonic()
            if client is None:
                return
            if client.gone:
                left_since = min(left_since, now)
            if now - left_since > _GONE_S:
                raise StuckError("it had not answered when the client left, nor since")
            if now - begin > within_s:
                asked = ", ".join(_named(number_of(one)) for one in commands_of(commands))
                raise StuckError(f"it has not answered {asked} in {within_s:g} s")

        answer = _asked(self._wire, commands, look)
        self._patience_s = _ANSWER_S
        return answer

    def load(self, arguments: list[str]) -> None:
        """Go on with a SUMO of these arguments, once `attach` has left the one before."""
        self._tell("load", json.dumps(arguments))  # before SUMO knows: `attach` goes on immediately
        self.asked(_command(CLOSE, b""), may_take_long=True)
        self.close()
        inner, self._pids[0], self.step_s = self._parent.recv()
        self._join(inner)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class _Filter:
    """Commands on their way to SUMO: some do not reach it as they are."""

    def __init__(self, sumo: _Sumo, folder: Path) -> None:
        self._sumo, self._folder, self._files = sumo, folder, KeptFiles(folder)

    def answered(self, body: bytes) -> bytes:
        """The answer to the commands of a message."""
        commands = list(commands_of(body))
        if self._sumo.step_s is not None or any(number_of(one) in _OURS for one in commands):
            return b"".join(self._answer(one) for one in commands)
        return self._sumo.asked(body)

    def close(self) -> None:
        """Tell SUMO that the client has left."""
        self._sumo.asked(_command(CLOSE, b""), may_take_long=True)

    def _answer(self, command: bytes) -> bytes:
        number = number_of(command)
        if number == ORDER:
            return _done(ORDER)  # the number of the client is ours to give
        try:
            if number == HALF_STEP:
                raise RefusedError("simulation.executeMove: SUMO does it for a lone client")
            if number == LOAD:
                return self._load(command)
            if self._files.concerns(command):
                return self._sumo.asked(self._files.moved(command), may_take_long=True)
        except RefusedError as why:
            return _refused(number, f"{why}.")
        if number == STEP:
            whole = _until(command, self._sumo)
            answer = _without_ours(self._sumo.asked(whole, may_take_long=True))
            single = whole.endswith(_FLOAT.pack(0.0))  # one of SUMO's own
            return answer if single else _with_events(answer, self._sumo)
        own = _of_step_length(command, self._sumo.step_s)
        return own or self._sumo.asked(command, may_take_long=number == CLOSE)

    def _load(self, command: bytes) -> bytes:
        arguments = self._files.of_load(_strings(command))
        try:
            confined(arguments, self._folder)
        except DeepmfError as error:
            return _refused(LOAD, f"load: {error}")
        self._sumo.load(arguments)
        return _done(LOAD)


def _until(command: bytes, sumo: _Sumo) -> bytes:
    """A step of the client with the time at which it ends, where that is not SUMO's next step.

    A client that names a time, or sends nonsense, is passed on as it is.
    """
    named = command[2 if command[0] else 6 :]
    if sumo.step_s is None or named != _FLOAT.pack(0.0):
        return command
    answer = sumo.asked(_command(GET_SIMULATION, bytes((_TIME,)) + _INT.pack(0)))
    now_s = _FLOAT.unpack(answer[-_FLOAT.size :])[0]
    return _command(STEP, _FLOAT.pack(round(now_s + sumo.step_s, 6)))


def _of_step_length(command: bytes, step_s: float | None) -> bytes:
    """The answer to `getDeltaT` and to `getOption` of the step length; empty to all else.

    ``step_s``: of the client's steps; None: they are SUMO's, which answers itself.
    """
    asked = command[1 if command[0] else 5 :]
    if step_s is None or asked[:1] != bytes((GET_SIMULATION,)):
        return b""
    if asked[1:2] == bytes((_STEP_LENGTH,)):
        value = bytes((_DOUBLE,)) + _FLOAT.pack(step_s)
    elif asked[1:] == bytes((_OPTION,)) + _text("step-length"):
        value = bytes((_STRING,)) + _text(f"{step_s:g}")
    else:
        return b""
    return _done(GET_SIMULATION) + framed(bytes((GET_SIMULATION + 0x10,)) + asked[1:] + value)


def _text(text: str) -> bytes:
    return _INT.pack(len(text)) + text.encode()


def _pass_on(client: Wire, sumo: _Filter, tell: Tell) -> None:
    """All that the client says, until it closes. Raises OSError, EOFError, StuckError."""
    closed = stepped = False
    try:
        while (body := client.receive()) is not None:
            numbers = {number_of(one) for one in commands_of(body)}
            stepped = stepped or STEP in numbers
            if CLOSE in numbers:
                closed = True
                tell("left")  # before SUMO knows: the other client goes on immediately
            client.send(sumo.answered(body))
            if closed:
                return
    except ProtocolError as error:
        tell("complaint", f"the client was disconnected: {error}")
    except StuckError:
        closed = True  # SUMO cannot be told
        raise
    finally:
        if not stepped:
            tell("complaint", "the client left before its first step: nothing happened")
            tell("unused")
        if not closed:  # SUMO ends for all where a client disappears
            tell("left")
            with contextlib.suppress(OSError, ProtocolError):
                sumo.close()


def _end_with_parent(pids: list[int]) -> None:
    """End SUMO (its only one is in ``pids``) and this process with a parent that cannot do it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        with contextlib.suppress(OSError):
            os.kill(pids[0], signal.SIGTERM)
            time.sleep(_END_S)  # it does not listen while it waits for clients
            system.kill(pids[0])
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


def _named(number: int) -> str:
    """``CMD_GET_VEHICLE_VARIABLE (0xa4)``; of a number that has no name, the number."""
    from traci import constants

    names = [
        name
        for name, value in vars(constants).items()
        if name.startswith("CMD_") and value == number
    ]
    return f"{' or '.join(names) or 'command'} (0x{number:02x})"


def _command(number: int, content: bytes) -> bytes:
    return bytes((2 + len(content), number)) + content


def _asked(sumo: Wire, commands: bytes, meanwhile: Callable[[], None] | None = None) -> bytes:
    """SUMO's answer."""
    sumo.send(commands)
    answer = sumo.receive(meanwhile)
    if answer is None:
        raise ProtocolError("SUMO has ended")
    return answer


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
    return framed(bytes((number,)) + _OK + _INT.pack(0))


def _refused(number: int, why: str) -> bytes:
    """The status of a command that is not done."""
    told = why.encode(errors="replace")
    return framed(bytes((number,)) + _ERROR + _INT.pack(len(told)) + told)


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


def _with_events(answer: bytes, sumo: _Sumo) -> bytes:
    """The answer to a step with all that has happened in it.

    Where another client makes shorter steps, SUMO puts into subscriptions what happened in its last
    one; asked for the same variable, it tells all since the client's last step.
    """
    begin = _length(answer, 0)
    if len(answer) < begin + 4:  # the step was refused
        return answer
    found, at = [answer[: begin + 4]], begin + 4
    while at < len(answer):
        end = at + _length(answer, at)
        found.append(_renewed(answer[at:end], sumo))
        at = end
    return b"".join(found)


def _renewed(result: bytes, sumo: _Sumo) -> bytes:
    """A subscription's result, in which what has happened is as asked for."""
    head = 1 if result[0] else 5
    if result[head] != _SUBSCRIBED:
        return result
    named = _object(result, 0)
    of, places = _INT.pack(len(named)) + named, _places(result, head + 5 + len(named))
    asked = [framed(bytes((GET_SIMULATION, one)) + of) for one in places if one in _EVENTS]
    if not asked:
        return result
    told = {}
    for one in commands_of(sumo.asked(b"".join(asked))):
        body = one[1 if one[0] else 5 :]
        if body[0] != GET_SIMULATION:  # not the status
            told[body[1]] = body[2 + len(of) :]
    kept, done = b"", head
    for variable, (begin, end) in places.items():
        kept += result[done:begin] + told.get(variable, result[begin:end])
        done = end
    return b"\0" + _INT.pack(len(kept) + 5) + kept  # as long as that, as SUMO does


def _places(result: bytes, at: int) -> dict[int, tuple[int, int]]:
    """Begin and end of each variable's value with its type; ``at``: where their number is."""
    found, left = {}, result[at]
    at += 1
    while left:
        end = _end_of_value(result, at + 2)  # behind the variable and whether it has a value
        found[result[at]] = (at + 2, end)
        at, left = end, left - 1
    return found


_SIZES: Final = {0x01: 16, 0x03: 24, 0x07: 1, 0x08: 1, 0x09: 4, 0x0B: 8, 0x11: 4}
"""Bytes of values by their type: positions, numbers, colours."""


def _end_of_value(data: bytes, at: int) -> int:
    """Where a value ends, whose type is at ``at``; variables of the simulation have no others."""
    kind, at = data[at], at + 1
    if kind in _SIZES:
        return at + _SIZES[kind]
    count, at = int(_INT.unpack_from(data, at)[0]), at + 4
    if kind == _STRING:
        return at + count
    for _ in range(count):  # of a list of strings, or of a compound
        at = _end_of_value(data, at) if kind != _STRINGS else at + 4 + _INT.unpack_from(data, at)[0]
    return at


def _object(data: bytes, at: int) -> bytes:
    """What a subscription's result is of."""
    start = at + (1 if data[at] else 5) + 1
    length = _INT.unpack_from(data, start)[0]
    return data[start + 4 : start + 4 + length]
