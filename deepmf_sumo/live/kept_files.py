"""Files that a client of `serve` has SUMO write are in one folder, and it can load them from there.

Commands that name a file are changed; those of which the file cannot be read are refused. All else
passes. SUMO's outputs are kept by its options, see `sumo.simulation.sumo_outputs`.

Source of the protocol: SUMO's documentation, TraCI/Protocol. A set command has its variable, the
name of an object and a typed value.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final

SET_SIMULATION, SET_GUI = 0xCB, 0xCC
_SAVE, _LOAD, _PICTURE = 0x95, 0x96, 0xA5
_NAMES: Final = {
    (SET_SIMULATION, _SAVE): "simulation.saveState",
    (SET_SIMULATION, _LOAD): "simulation.loadState",
    (SET_GUI, _PICTURE): "gui.screenshot",
}
_STRING, _COMPOUND = 0x0C, 0x0F
_INT: Final = struct.Struct("!i")
_LONGEST: Final = 255
"""Bytes of a command whose length is one byte."""
_STATE: Final = "--load-state"


class RefusedError(Exception):
    """A command that does not reach SUMO; the message is for the client."""


class KeptFiles:
    """Where files are that a client has named. ``folder``: which has nothing but them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: dict[Path, Path] = {}

    def concerns(self, command: bytes) -> bool:
        """Whether a command names a file that SUMO writes, or reads again."""
        return _kind(command) in _NAMES

    def moved(self, command: bytes) -> bytes:
        """The command with the file in the folder. Raises RefusedError."""
        kind = _kind(command)
        name = _NAMES[kind]
        begin, end = _string(command, name)
        try:
            given = command[begin + 4 : end].decode()
        except UnicodeDecodeError:
            raise RefusedError(f"{name}: the name of the file is not UTF-8") from None
        if "\0" in given:
            raise RefusedError(f"{name}: the name of the file has a zero byte")
        place = self.found(given) if kind[1] == _LOAD else self._place(given, name)
        told = str(place).encode()
        head = 1 if command[0] else 5
        content = command[head:begin] + _INT.pack(len(told)) + told + command[end:]
        return framed(content)

    def of_load(self, arguments: Sequence[str]) -> list[str]:
        """SUMO's arguments, with the state that the client has saved."""
        found: list[str] = []
        for word in arguments:
            name, equals, value = word.partition("=")
            if name == _STATE and equals:
                found.append(f"{_STATE}={self.found(value)}")
            else:
                found.append(self.found(word) if found[-1:] == [_STATE] else word)
        return found

    def found(self, given: str) -> str:
        """Where a file is that the client names; SUMO's options may have written it, too."""
        place = self._kept.get(Path(given).resolve())
        if place is None and not Path(given).exists():
            written = self._folder / Path(given).name
            place = written if written.is_file() else None
        return given if place is None else str(place)

    def _place(self, given: str, name: str) -> Path:
        """Where it is written; files of the same name in two folders are two files."""
        plain = given.replace("\\", "/").rpartition("/")[2]
        if not plain.strip("."):
            raise RefusedError(f"{name}: '{given}' names no file")
        key = Path(given).resolve()
        if key not in self._kept:
            number, place = 1, self._folder / plain
            while place in self._kept.values():
                number += 1
                place = self._folder / f"{number}-{plain}"
            self._kept[key] = place
        return self._kept[key]


def framed(content: bytes) -> bytes:
    """A command or a response with its length before it."""
    if len(content) + 1 <= _LONGEST:
        return bytes((len(content) + 1,)) + content
    return b"\0" + _INT.pack(len(content) + 5) + content


def _kind(command: bytes) -> tuple[int, int]:
    """Number and variable."""
    at = 1 if command[0] else 5
    return (command[at], command[at + 1]) if len(command) > at + 1 else (command[at], -1)


def _string(command: bytes, name: str) -> tuple[int, int]:
    """Begin and end of the first string of a value, with its length. Raises RefusedError."""
    try:
        at = (1 if command[0] else 5) + 2
        at += 4 + _size(command, at)
        if command[at] == _COMPOUND:
            at += 5
        if command[at] != _STRING:
            raise RefusedError(f"{name}: its first value is not a string")
        end = at + 5 + _size(command, at + 1)
    except (struct.error, IndexError):
        end = len(command) + 1
    if end > len(command):
        raise RefusedError(f"{name}: the command is cut off")
    return at + 1, end


def _size(command: bytes, at: int) -> int:
    (size,) = _INT.unpack_from(command, at)
    if size < 0:
        raise IndexError
    return int(size)
