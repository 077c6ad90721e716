"""What SUMO writes, kept in one folder, whatever its options and files name.

SUMO puts its output prefix between an output's folder and its name: one that leads up to / and down
to a folder collects all outputs there, also those of additional files and of vehicles. Few options
do not obey it. They are replaced, or refused by name.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.sumo.simulation import sumo_options

_TO_ROOT: Final = "../" * 64
"""There are no folders above /."""
_LARGEST: Final = 2**24
"""Bytes of a configuration."""
_PREFIX, _SUFFIX, _VTK, _VIEW = "output-prefix", "output-suffix", "vtk-output", "gui-settings-file"
_META: Final = re.compile(r"save-(conf|temp|schema)|^C$")
"""Options that write a file of their own and end SUMO; SUMO knows synonyms of them."""
_SHORT_CONFIG, _SHORT_META, _SHORT_VIEW = "c", "C", "g"
_VALUED: Final = frozenset("cCnrawxbelXgmNdDsB")
"""Letters of SUMO's short options that have a value; others are switches, and may be joined."""


_ENCODED: Final = re.compile("[%$]")
"""In file names: SUMO decodes %20, and puts in variables."""


@dataclass(frozen=True, slots=True)
class Option:
    """An option and its value, if it has one; ``words``: as given. Of a file: without words."""

    name: str
    value: str
    words: tuple[str, ...] = ()


def confined(arguments: Sequence[str], folder: Path) -> list[str]:
    """SUMO's arguments, with which it writes into a folder alone.

    A prefix and a suffix for the names of outputs stay, without their folders.

    Raises UsageError for options that write elsewhere, SimulationError for a configuration that
    does, or cannot be read.
    """
    given = list(_options(arguments))
    listed = [*given, *_of_configurations(given)]
    names = {one.name for one in listed}
    for one in listed:
        if reason := _elsewhere(one):
            raise (UsageError if one.words else SimulationError)(reason)
    own = {_PREFIX, _SUFFIX, _VTK}
    kept = [word for one in given if one.name not in own for word in one.words]
    named = {one.name: one.value for one in given}
    prefix = _plain(named.get(_PREFIX, ""))
    return [
        *kept,
        *(f"--{_PREFIX}", f"{from_anywhere(folder.absolute())}/{prefix}"),
        # named by others alone: SUMO before 1.25 does not know it
        *((f"--{_SUFFIX}", _plain(named.get(_SUFFIX, ""))) if _SUFFIX in names else ()),
        *((f"--{_VTK}", str(folder.absolute() / "vtk")) if _VTK in names else ()),
    ]


def options_of(arguments: Sequence[str]) -> list[Option]:
    """The options of a command line, then those of its configurations: the first of a name holds.

    Raises SimulationError for a configuration that cannot be read.
    """
    given = list(_options(arguments))
    return [*given, *_of_configurations(given)]


def from_anywhere(folder: PurePath) -> str:
    """The way to a folder from any other one; on Windows from those of its drive.

    On another drive SUMO finds no such folder, and ends with an error.
    """
    return _TO_ROOT + folder.relative_to(folder.anchor).as_posix()


def _elsewhere(one: Option) -> str:
    """Why an option writes where no prefix leads; empty where it does not."""
    if _META.search(one.name):
        return f"SUMO's option --{one.name} writes '{one.value}' and ends SUMO; remove it."
    if one.name == _VIEW and _takes_pictures(Path(one.value)):
        return f"The view settings '{one.value}' save pictures (<snapshot>); remove that."
    return ""


def _plain(name: str) -> str:
    """The last part of a path: SUMO takes a backslash for a slash, too."""
    return re.split(r"[\\/]", name)[-1]


def _options(words: Sequence[str]) -> Iterator[Option]:
    """The options of a command line, read as SUMO reads them."""
    if len(words) == 1 and not words[0].startswith("-"):
        yield Option("configuration-file", words[0], tuple(words))
        return
    left = list(words)
    while left:
        word = left.pop(0)
        if not word.startswith("-") or word == "-":
            yield Option("", "", (word,))
            continue
        name, value, complete = _long(word) if word.startswith("--") else _short(word)
        own = [word]
        if not complete and left and not left[0].startswith("-"):
            own.append(value := left.pop(0))
        yield Option(name, value, tuple(own))


def _long(word: str) -> tuple[str, str, bool]:
    name, equals, value = word.removeprefix("--").partition("=")
    return name, value, bool(equals)


def _short(word: str) -> tuple[str, str, bool]:
    """The option with a value among those that are joined, its value, and whether it has it."""
    for place, letter in enumerate(word[1:], start=1):
        if letter in _VALUED:
            value = word[place + 1 :].removeprefix("=")
            name = {_SHORT_CONFIG: "configuration-file", _SHORT_VIEW: _VIEW}.get(letter, letter)
            return name, value, bool(value)
    return word[1:], "", False


def _of_configurations(given: Sequence[Option]) -> Iterator[Option]:
    for one in given:
        if one.name.startswith("config"):
            yield from _of_file(Path(one.value))


def _of_file(file: Path) -> Iterator[Option]:
    """The options of a configuration; none of a file that is missing, which SUMO then says.

    Raises SimulationError for a file that cannot be read.
    """
    if not (file.exists() or _ENCODED.search(str(file))):
        return
    for name, value in sumo_options.of_configuration(file).items():
        named = sumo_options.paths(value, file.parent) if name == _VIEW else ()
        yield Option(name, sumo_options.listed(named) or value)


def _takes_pictures(view: Path) -> bool:
    try:
        return b"<snapshot" in files.content(view, _LARGEST)
    except OSError:  # SUMO says that it is missing
        return False
