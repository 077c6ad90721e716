"""All files that SUMO reads for a configuration, those included that its files name in turn."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from html import unescape
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.sumo.simulation import sumo_options

SHOWN: Final = {"gui-settings-file", "edgedata-files", "alternative-net-file", "selection-file"}
"""Options whose files sumo-gui alone reads."""

_LARGEST: Final = 2**34
NAMING: Final = ("include", "rerouter", "variableSpeedSign", "calibrator")
"""Elements of SUMO's files that name another file to read; detectors name files to write."""
_NAMING: Final = re.compile(rf"<({'|'.join(NAMING)})\b([^<>]*)".encode())
_ATTRIBUTE: Final = re.compile(r"""\b(?:file|href)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_TAIL: Final = 4096


def files_read(config: Path, beside: Mapping[str, str]) -> list[Path]:
    """The configuration and all files that SUMO reads for it, each once.

    Args:
        config: a .sumocfg file.
        beside: options given beside it, by long name, with absolute paths (`sumo_options.parse`).

    So also what these files name in turn: included files, and those of rerouters, speed signs and
    calibrators. What does not exist is left out.
    """
    found = dict.fromkeys(path for path in [config] if path.is_file())
    with suppress(SimulationError):
        options = sumo_options.of_configuration(config) | dict(beside)
        for name, value in options.items():
            if is_read(name):
                paths = sumo_options.paths(value, config.parent)
                found |= dict.fromkeys(path for path in paths if path.exists())
    return with_named([*found], begun=1)


def with_named(paths: Sequence[Path], begun: int = 0) -> list[Path]:
    """Files of SUMO, and all that they name in turn, each once; the ``begun`` first name none."""
    found, left = dict.fromkeys(paths), list(paths)[begun:]
    seen = {path.resolve() for path in found}
    while left:
        for path in _named_in(left.pop()):
            if path.is_file() and path.resolve() not in seen:
                seen.add(path.resolve())
                found[path] = None
                left.append(path)
    return list(found)


def is_read(option: str) -> bool:
    """Whether SUMO, not only sumo-gui, reads what an option names."""
    return option not in SHOWN and sumo_options.names_files(option)


def _named_in(path: Path) -> Iterator[Path]:
    """Files that a file of SUMO names to be read beside itself."""
    if path.is_dir():
        return
    with suppress(OSError):
        for piece in pieces(path):
            for match in _NAMING.finditer(piece):
                for name in _ATTRIBUTE.findall(match[2].decode("utf-8", "replace")):
                    yield from sumo_options.paths(unescape(name[0] or name[1]), path.parent)


def pieces(path: Path) -> Iterator[bytes]:
    """The content, unpacked; each piece begins with the end of the one before."""
    tail = b""
    with files.unpacked(path, _LARGEST) as stream:
        while piece := stream.read(2**20):
            yield tail + piece
            tail = piece[-_TAIL:]
