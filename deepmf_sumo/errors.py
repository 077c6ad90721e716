"""All errors that users can meet, and all exit codes of the command line.

::

    DeepmfError                 exit code
    +-- UsageError              2   the command line or a spec is wrong
    |   +-- SpecError           2
    |   +-- PluginError         2   unknown plug-in, or settings that it refuses
    |   +-- WeightsError        2   weights missing, corrupt, or of another shape
    |   +-- OutputError         2   the output folder cannot be written
    +-- RunError                3   one run failed; the others continue
        +-- ReaderError         3   a recorded file or record that cannot be used
        +-- ConversionError     3   a scene whose network cannot be built
        +-- SimulationError     3   SUMO refused, or the AV never appeared
        +-- PlannerError        3   the planner under test raised, was late, or gave a wrong answer
        +-- RunTimeoutError     3

A message is one sentence that names the file, the field and the value, and says what to do.
"""

import difflib
from collections.abc import Iterable
from typing import Final, Literal

PlannerFault = Literal["crashed", "hung", "nonsense"]
Ending = Literal["interrupted", "wrong", "failed", "broken", "fine"]

EXIT_CODES: Final[dict[Ending, int]] = {
    "interrupted": 130,  # runs are missing, or a signal ended the command
    "wrong": 2,  # the command, a spec or the weights that it names
    "failed": 3,  # a run failed, or the results do not allow a verdict
    "broken": 1,  # an expectation or a threshold
    "fine": 0,
}
"""By the ending of a command. Where several apply, the first one in this order counts."""


def exit_code(*endings: Ending) -> int:
    """The exit code of a command that ended in all these ways; 0 without any."""
    return next((code for ending, code in EXIT_CODES.items() if ending in endings), 0)


def worst(*codes: int) -> int:
    """The exit code that counts of several commands', see `EXIT_CODES`; 0 without any."""
    return next((code for code in EXIT_CODES.values() if code in codes), max(codes, default=0))


class DeepmfError(Exception):
    """Base of all errors that are reported to the user as one line."""

    exit_code = EXIT_CODES["failed"]


class UsageError(DeepmfError):
    """The command or a spec is wrong; nothing was run."""

    exit_code = EXIT_CODES["wrong"]


class SpecError(UsageError):
    """A spec file is wrong: unknown, duplicate or mistyped keys, or values out of range."""


class PluginError(UsageError):
    """There is no plug-in of that name, or it refuses its settings."""


class WeightsError(UsageError):
    """A weights folder is missing, corrupt, or has tensors of another shape."""


class OutputError(UsageError):
    """The output folder cannot be created or written."""


class RunError(DeepmfError):
    """One run failed; the other runs of the batch continue."""


class ReaderError(RunError):
    """A recorded file, or one record in it, cannot be used."""


class ConversionError(RunError):
    """No SUMO network can be built from this scene."""


class SimulationError(RunError):
    """SUMO refused something, or the AV never appeared."""


class PlannerError(RunError):
    """The planner under test raised, ended, was late, or gave a command that cannot be driven.

    Attributes:
        kind: which of these: it raised or ended (``crashed``), was late (``hung``), or answered
            what cannot be understood or driven (``nonsense``).
    """

    def __init__(self, message: str, *, kind: PlannerFault = "nonsense") -> None:
        super().__init__(message)
        self.kind: PlannerFault = kind

    def __str__(self) -> str:
        return f"planner_error: {super().__str__()}"


class RunTimeoutError(RunError):
    """A run took longer than its time limit."""


def nearest(name: str, known: Iterable[str]) -> str:
    """``" Did you mean 'X'?"`` for the known name most similar to ``name``, or an empty text."""
    found = difflib.get_close_matches(name, list(known), n=1)
    return f" Did you mean '{found[0]}'?" if found else ""


__all__ = [
    "EXIT_CODES",
    "ConversionError",
    "DeepmfError",
    "Ending",
    "OutputError",
    "PlannerError",
    "PlannerFault",
    "PluginError",
    "ReaderError",
    "RunError",
    "RunTimeoutError",
    "SimulationError",
    "SpecError",
    "UsageError",
    "WeightsError",
    "exit_code",
    "nearest",
    "worst",
]
