"""SUMO's options: the words of a command line, and what a configuration file says.

A configuration is read as SUMO reads it (its ``OptionsLoader``, tried with SUMO 1.28): an option is
an element at any depth with its value in ``value``, in ``v`` or as text, under any of its names;
``${NAME}`` is a variable of the environment; in names of files ``%20`` stands for a space, as
netedit writes it, and ``~`` for the home folder; lists are separated by commas.
"""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import unquote
from xml.etree import ElementTree as ET

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError, UsageError

_SHORT: Final = {
    "a": "additional-files",
    "b": "begin",
    "c": "configuration-file",
    "e": "end",
    "m": "edgedata-files",
    "n": "net-file",
    "r": "route-files",
    "w": "weight-files",
}
_SYNONYMS: Final = _SHORT | {
    "additional": "additional-files",
    "configuration": "configuration-file",
    "data-files": "edgedata-files",
    "device.fcd-replay.file": "device.fcd-replay.files",
    "net": "net-file",
    "routes": "route-files",
    "srand": "seed",
    "weights": "weight-files",
}
"""Other names of options that are understood here; SUMO has more for outputs."""
_OURS: Final = {
    "step-length": "every run steps by 0.1 s",
    "seed": "give --seed before the --",
    "random": "runs can be repeated",
    "configuration-file": "give the .sumocfg before the --",
    "remote-port": "the simulation is not shared",
    "num-clients": "the simulation is not shared",
    "collision.action": "contacts are judged by the boxes of the vehicles",
    "output-prefix": "outputs of attacked traffic are discarded",
    "output-suffix": "outputs of attacked traffic are discarded",
    "no-step-log": "nothing is printed",
    "duration-log.disable": "nothing is printed",
    "no-warnings": "nothing is printed",
    "xml-validation": "it is off",
}
"""Options that a user cannot give, and why."""
_VALUE: Final = re.compile(r"^(?!-)|^-[\d.]")  # -1 is a value, -b is not
_READ: Final = re.compile(
    r"(^|[.-])files?$|^load-state$|^phemlight-path$"
    r"|^astar\.(all|landmark)-distances$"
)
_WRITTEN: Final = {"log-file", "save-state.files", "device.ssm.file", "device.toc.file"}
"""What SUMO writes, though its name looks otherwise."""
_LARGEST: Final = 2**24
_OTHER_FILES: Final = {
    "net": "a network", "routes": "demand", "additional": "an additional file",
}  # fmt: skip
_VARIABLE: Final = re.compile(r"\$\{(\w+)\}")


def parse(options: Sequence[str]) -> dict[str, str]:
    """Names, in SUMO's long spelling, and values; files are absolute, a switch is ``true``.

    Raises UsageError for a word that is not an option, an option that is given twice, or one of
    those that are set for every run.
    """
    found: dict[str, str] = {}
    for name, value in _pairs(options):
        if name in _OURS:
            raise UsageError(f"SUMO's option --{name} cannot be given: {_OURS[name]}.")
        if name in found:
            raise UsageError(f"SUMO's option --{name} is given twice.")
        meant = _with_variables(value)
        found[name] = listed(paths(meant, Path.cwd())) if names_files(name) else meant
    return found


def long_name(option: str) -> str:
    """SUMO's long spelling of an option."""
    return _SYNONYMS.get(option, option)


def names_files(option: str) -> bool:
    """Whether SUMO reads the files that an option names."""
    return option not in _WRITTEN and bool(_READ.search(option))


def paths(value: str, folder: Path) -> tuple[Path, ...]:
    """The files of a value that names some, as seen from a folder."""
    names = (_file(name.strip()) for name in value.split(",") if name.strip())
    return tuple(one if one.is_absolute() else (folder / one).resolve() for one in names)


def listed(names: Iterable[Path]) -> str:
    """Files as a value on SUMO's command line."""
    return ",".join(map(str, names))


def in_configuration(names: Iterable[Path]) -> str:
    """Files as a value in a configuration file, where SUMO decodes ``%20``."""
    return listed(names).replace("%", "%25")


def of_configuration(file: Path) -> dict[str, str]:
    """Names, in SUMO's long spelling, and values of the options in a configuration file.

    Names of files are as written: beside the file (`paths`), without ``%20`` and variables.
    Raises SimulationError for a file that is not XML.
    """
    try:
        with files.unpacked(file, _LARGEST) as stream:
            reading = ET.iterparse(stream, events=("start",))  # noqa: S314 - SUMO reads it, too
            root = next(reading)[1]
            if root.tag in _OTHER_FILES:
                raise SimulationError(
                    f"'{file}' contains <{root.tag}>, which is {_OTHER_FILES[root.tag]}; name a"
                    ' .sumocfg, which names it: <configuration><net-file value="..."/>'
                    '<route-files value="..."/></configuration>.'
                )
            for _ in reading:
                pass
    except (ET.ParseError, EOFError, OSError, ValueError, LookupError) as error:
        why = files.reason(error) if isinstance(error, OSError) else str(error)
        raise SimulationError(f"'{file}' cannot be read as a SUMO configuration: {why}.") from None
    found: dict[str, str] = {}
    for element in root.iter():
        text = value_of(element)
        if text is not None and isinstance(element.tag, str):
            name, value = long_name(element.tag), _with_variables(text)
            found[name] = unquote(value) if names_files(name) else value
    return found


def value_of(option: ET.Element) -> str | None:
    """The value of an element of a configuration; None for a section."""
    text = option.get("value", option.get("v"))
    if text is None and not len(option):
        text = (option.text or "").strip() or None
    return text


def _with_variables(value: str) -> str:
    """SUMO takes a variable that is not set for an empty one, and ``$NAME`` for a name."""
    return _VARIABLE.sub(lambda found: os.environ.get(found[1], ""), value)


def _file(name: str) -> Path:
    return Path(name).expanduser() if name.startswith("~/") else Path(name)


def _pairs(options: Sequence[str]) -> Iterator[tuple[str, str]]:
    left = list(options)
    while left:
        word = left.pop(0)
        long = word.startswith("--")
        if not word.startswith("-") or word in {"-", "--"} or _VALUE.match(word):
            raise UsageError(
                f"'{word}' is not a SUMO option: after -- each must begin with a dash."
            )
        name, equals, value = word.lstrip("-").partition("=")
        if not long and name not in _SHORT:
            raise UsageError(f"SUMO's option -{name} is not understood here: write it out, --NAME.")
        name = _SYNONYMS.get(name, name) if long else _SHORT[name]
        if not equals:
            value = left.pop(0) if left and _VALUE.match(left[0]) else "true"
        yield name, value
