"""What SUMO itself says of its inputs: the errors before it gives up, and its warnings.

libsumo's exception has the last line alone ("vehicle cannot be created"); the line before says
which vehicle, and why. Warnings tell of demand that SUMO drops or changes. Both go to a file: the
streams of a worker are closed, and what several SUMOs print at a time cannot be told apart.
"""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from deepmf_sumo import files

OPTION: Final = "--error-log"
MESSAGES: Final = "sumo-messages.log"
_LARGEST: Final = 2**24
_MOST: Final = 5
_PARTICULARS: Final = re.compile(r"'[^']*'|\d+(\.\d+)?")
_DETOUR: Final = re.compile(r"(?:\.\./){16,}(?:[^/']+/)*")
"""In names of outputs: up to / and down to the folder where they are kept (`sumo_outputs`)."""


def to_file(folder: Path) -> tuple[str, str]:
    """Options that write SUMO's messages into a folder."""
    return OPTION, str(folder / MESSAGES)


def divert(folder: Path, into: Path) -> None:
    """Let the SUMO of this process write its further messages into another folder.

    For a copy of a process (`os.fork`), which else writes into the file of its parent.
    """
    with (into / MESSAGES).open("wb") as file, suppress(OSError):
        for each in Path("/proc/self/fd").iterdir():
            if each.resolve() == (folder / MESSAGES).resolve():
                os.dup2(file.fileno(), int(each.name))


def before(reason: str, folder: Path) -> str:
    """Why SUMO gave up: the errors that it wrote, and the reason that it gave at last."""
    found = [text for kind, text in _messages(folder) if kind == "Error"]
    said = [text for text in dict.fromkeys(found) if not text.startswith("Quitting")]
    words = [text for text in said if text not in reason]
    last = [] if any(reason in text for text in words) else [reason]
    whole = " ".join(one if one.endswith((".", "!")) else f"{one}." for one in [*words, *last])
    return _DETOUR.sub("", whole)


def warnings_in(folder: Path) -> tuple[str, ...]:
    """SUMO's warnings: the first of each kind, and how many more there are."""
    kinds: dict[str, list[str]] = {}
    for kind, text in _messages(folder):
        if kind == "Warning":
            kinds.setdefault(_PARTICULARS.sub("*", text), []).append(text)
    lines = [_counted(texts) for texts in kinds.values()]
    if len(lines) > _MOST:
        lines[_MOST:] = [f"SUMO gives warnings of {len(lines) - _MOST} more kinds"]
    return tuple(lines)


def _counted(texts: Sequence[str]) -> str:
    more = f" ({len(texts) - 1} more like it)" if len(texts) > 1 else ""
    return f"SUMO warns: {texts[0]}{more}"


def _messages(folder: Path) -> Iterator[tuple[str, str]]:
    """Kind and text of each message; lines that begin with a space belong to the one before."""
    try:
        lines = files.text(folder / MESSAGES, _LARGEST, "utf-8").splitlines()
    except (OSError, UnicodeDecodeError):  # nothing was said, or more than a person reads
        return
    whole: list[str] = []
    for line in lines:
        if line.startswith(" ") and whole:
            whole[-1] += f" {line.strip()}"
        elif line.strip():
            whole.append(line)
    for line in whole:
        kind, _, text = line.partition(": ")
        yield kind, text.strip()
