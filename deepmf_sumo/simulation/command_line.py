"""Options of SUMO that a user gives beside the configuration, as on SUMO's own command line."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from deepmf_sumo.errors import UsageError

_SHORT: Final = {
    "a": "additional-files",
    "b": "begin",
    "c": "configuration-file",
    "e": "end",
    "n": "net-file",
    "r": "route-files",
}
_SYNONYMS: Final = {
    "additional": "additional-files",
    "net": "net-file",
    "routes": "route-files",
    "config": "configuration-file",
    "srand": "seed",
}
_OURS: Final = {
    "step-length": "every run steps by 0.1 s",
    "seed": "give --seed before the --",
    "random": "runs can be repeated",
    "configuration-file": "give the .sumocfg before the --",
    "remote-port": "the simulation is not shared",
    "num-clients": "the simulation is not shared",
    "collision.action": "contacts are judged by the boxes of the vehicles",
    "output-prefix": "outputs of attacked traffic are thrown away",
    "no-step-log": "nothing is printed",
    "duration-log.disable": "nothing is printed",
    "no-warnings": "nothing is printed",
    "xml-validation": "it is off",
}
"""Options that are set for every run, and why."""
_VALUE: Final = re.compile(r"^(?!-)|^-[\d.]")  # -1 is a value, -b is not
_FILES: Final = re.compile(r"files?$|^load-state$")


def parse(options: Sequence[str]) -> dict[str, str]:
    """Names, in SUMO's long spelling, and values; files are absolute, a switch is ``true``.

    Raises UsageError for what is no option, stands twice, or is not the user's to choose.
    """
    found: dict[str, str] = {}
    for name, value in _pairs(options):
        if name in _OURS:
            raise UsageError(f"SUMO's option --{name} cannot be given: {_OURS[name]}.")
        if name in found:
            raise UsageError(f"SUMO's option --{name} is given twice.")
        found[name] = _absolute(value) if _FILES.search(name) else value
    return found


def _pairs(options: Sequence[str]) -> Iterator[tuple[str, str]]:
    left = list(options)
    while left:
        word = left.pop(0)
        long = word.startswith("--")
        if not word.startswith("-") or word in {"-", "--"} or _VALUE.match(word):
            raise UsageError(f"'{word}' is no option of SUMO: after -- they begin with a dash.")
        name, equals, value = word.lstrip("-").partition("=")
        if not long and name not in _SHORT:
            raise UsageError(f"SUMO's option -{name} is not understood here: write it out, --NAME.")
        name = _SYNONYMS.get(name, name) if long else _SHORT[name]
        if not equals:
            value = left.pop(0) if left and _VALUE.match(left[0]) else "true"
        yield name, value


def _absolute(files: str) -> str:
    return ",".join(str(Path(file.strip()).absolute()) for file in files.split(","))
