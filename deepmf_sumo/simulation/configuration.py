"""A user's .sumocfg: what has to be known of it before SUMO is started with it."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax import SAXException

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.simulation import command_line

SUMO_SEED: Final = 23423
"""SUMO's own where nobody names one."""
_SEED: Final = re.compile(r"\+?[0-9]+")
"""What SUMO reads as a number of zero or more: also ``+5`` and ``007``, but not 0x10 or 1e3."""
_LARGEST_SEED: Final = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """A configuration file with the options that are given beside it; paths are absolute.

    Attributes:
        seed_text: the seed that it names, as written; None where it names none.
        options: those beside it, as SUMO takes them, without additional files.
        more_demand: vehicles also come from files of other kinds, e.g. a saved state.
    """

    file: Path
    net: Path
    additional: tuple[Path, ...]
    routes: tuple[Path, ...] = ()
    more_demand: bool = False
    step_s: float
    begin_s: float
    end_s: float | None
    seed_text: str | None = None
    options: tuple[str, ...] = ()

    @property
    def seed(self) -> int:
        """What SUMO would run the configuration with by itself.

        Raises SimulationError for a seed that SUMO does not read, or that a spec cannot hold.
        Only who asks for it is refused: a run has a seed of its own.
        """
        text = self.seed_text
        if text is None:
            return SUMO_SEED
        if not _SEED.fullmatch(text) or int(text) > _LARGEST_SEED:
            raise SimulationError(
                f"'{self.file}' has seed '{text}', which is not a whole number from 0 to"
                f" {_LARGEST_SEED} in plain decimals; correct it, or give --seed."
            )
        return int(text)


_SYNONYMS = {"net": "net-file", "n": "net-file", "additional": "additional-files"} | {
    "a": "additional-files",
    "routes": "route-files",
    "r": "route-files",
    "b": "begin",
    "e": "end",
    "srand": "seed",
}
_MORE_DEMAND = {"load-state", "device.fcd-replay.files"}
_NO = {"false", "0", "no", "off", "f", "-"}


def read_configuration(file: Path, beside: Sequence[str] = ()) -> Configuration:
    """Read a .sumocfg, with SUMO's options ``beside`` it.

    Raises SimulationError where the file is missing, is not XML, names no network or a file that
    does not exist, or asks for the mesoscopic model; UsageError for options that cannot be given.
    """
    import sumolib

    if not file.is_file():
        raise SimulationError(f"There is no SUMO configuration '{file}'.")
    try:
        options = {
            _SYNONYMS.get(option.name, option.name): str(option.value)
            for option in sumolib.options.readOptions(str(file))
        }
    except (SAXException, OSError, UnicodeError) as error:
        raise SimulationError(f"'{file}' cannot be read as a SUMO configuration: {error}") from None
    given = command_line.parse(beside)
    options |= given
    if "net-file" not in options:
        raise SimulationError(f"'{file}' names no network: it needs <net-file value=\"...\"/>.")
    net = _beside(file, options["net-file"])
    if not net.is_file():
        raise SimulationError(f"'{file}' names the network '{net}', which does not exist.")
    if options.get("mesosim", "false").lower() not in _NO:
        raise SimulationError(
            f"'{file}' asks for SUMO's mesoscopic model (mesosim), in which vehicles have no place"
            " on the road that somebody could hit; run it without, e.g. '-- --mesosim false'."
        )
    return Configuration(
        file=file,
        net=net,
        additional=_inputs(file, options.get("additional-files", ""), "additional file"),
        routes=_inputs(file, options.get("route-files", ""), "route file"),
        more_demand=not _MORE_DEMAND.isdisjoint(options),
        step_s=_seconds(file, "step-length", options.get("step-length", "1")),
        begin_s=_seconds(file, "begin", options.get("begin", "0")),
        end_s=_end(file, options.get("end")),
        seed_text=options.get("seed"),
        options=tuple(
            word
            for name, value in given.items()
            if name != "additional-files"
            for word in (f"--{name}", value)
        ),
    )


def _inputs(file: Path, names: str, kind: str) -> tuple[Path, ...]:
    """Paths of a list of files. Raises SimulationError for one that does not exist."""
    paths = tuple(_beside(file, name.strip()) for name in names.split(",") if name.strip())
    for path in paths:
        if not path.is_file():
            raise SimulationError(f"'{file}' names the {kind} '{path}', which does not exist.")
    return paths


def _beside(file: Path, name: str) -> Path:
    path = Path(os.path.expandvars(name))  # SUMO knows ${VARIABLES}, too
    return path if path.is_absolute() else (file.parent / path).resolve()


def _end(file: Path, text: str | None) -> float | None:
    seconds = _seconds(file, "end", text) if text is not None else -1.0
    return seconds if seconds >= 0 else None


def _seconds(file: Path, name: str, text: str) -> float:
    """SUMO writes times as seconds or as [days:]hours:minutes:seconds."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        raise SimulationError(f"'{file}' has {name} '{text}', which is not a time.") from None
    total = 0.0
    for part, scale in zip(reversed(parts), (1.0, 60.0, 3600.0, 86400.0), strict=False):
        total += part * scale
    return total
