"""SUMO configurations: reading them, their command line, and a SUMO held shortly before a start.

The runs of an attack on a network share the traffic, and start at different times. If they are
ordered by start time, SUMO simulates that traffic once: it is held shortly before each start, a
copy of this process (`os.fork`) goes on from there, and here SUMO waits for the next start. A copy
has all of SUMO's state, so nothing differs from a SUMO that was started for the run alone.
"""

import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax import SAXException

from deepmf_sumo.datatypes import TrafficCase, VehicleModel
from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.simulation.sumo_api import STEP_OPTIONS, Backend, SumoApi, running, write_types

_SHORT: Final = {
    "a": "additional-files",
    "b": "begin",
    "c": "configuration-file",
    "e": "end",
    "n": "net-file",
    "r": "route-files",
}
_SYNONYMS: Final = _SHORT | {
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
    "output-prefix": "outputs of attacked traffic are discarded",
    "no-step-log": "nothing is printed",
    "duration-log.disable": "nothing is printed",
    "no-warnings": "nothing is printed",
    "xml-validation": "it is off",
}
"""Options that a user cannot give, and why."""
_VALUE: Final = re.compile(r"^(?!-)|^-[\d.]")  # -1 is a value, -b is not
_FILES: Final = re.compile(r"files?$|^load-state$")


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
        found[name] = _absolute(value) if _FILES.search(name) else value
    return found


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


def _absolute(files: str) -> str:
    return ",".join(str(Path(file.strip()).absolute()) for file in files.split(","))


SUMO_SEED: Final = 23423
"""SUMO's default."""
_SEED: Final = re.compile(r"\+?[0-9]+")
"""Numbers of zero or more that SUMO reads: also ``+5`` and ``007``, but not 0x10 or 1e3."""
_LARGEST_SEED: Final = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """A configuration file with the options that are given beside it; paths are absolute.

    Attributes:
        seed_text: the seed that it names, as written; None if it names none.
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
        """The seed with which SUMO would run the configuration by itself.

        Raises SimulationError for a seed that SUMO does not read, or that a spec cannot hold.
        Checked only here, for a run with a seed of its own does not need it.
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


_MORE_DEMAND = {"load-state", "device.fcd-replay.files"}
_NO = {"false", "0", "no", "off", "f", "-"}


def read_configuration(file: Path, beside: Sequence[str] = ()) -> Configuration:
    """Read a .sumocfg, with SUMO's options ``beside`` it.

    Raises SimulationError if the file is missing, is not XML, names no network or a file that does
    not exist, or asks for the mesoscopic model; UsageError for options that cannot be given.
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
    given = parse(beside)
    options |= given
    if "net-file" not in options:
        raise SimulationError(f"'{file}' names no network: it needs <net-file value=\"...\"/>.")
    net = _beside(file, options["net-file"])
    if not net.is_file():
        raise SimulationError(f"'{file}' names the network '{net}', which does not exist.")
    if options.get("mesosim", "false").lower() not in _NO:
        raise SimulationError(
            f"'{file}' asks for SUMO's mesoscopic model (mesosim), which has no positions of"
            " vehicles, so that none can be hit; run it without, e.g. '-- --mesosim false'."
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
    path = Path(os.path.expandvars(name))  # SUMO expands ${VARIABLES}, too
    return path if path.is_absolute() else (file.parent / path).resolve()


def _end(file: Path, text: str | None) -> float | None:
    seconds = _seconds(file, "end", text) if text is not None else -1.0
    return seconds if seconds >= 0 else None


def _seconds(file: Path, name: str, text: str) -> float:
    """Seconds of a time, which SUMO writes as such or as [days:]hours:minutes:seconds."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        raise SimulationError(f"'{file}' has {name} '{text}', which is not a time.") from None
    total = 0.0
    for part, scale in zip(reversed(parts), (1.0, 60.0, 3600.0, 86400.0), strict=False):
        total += part * scale
    return total


_TO_ROOT = "../" * 64
"""SUMO puts its prefix between an output's folder and its name; there are no folders above /."""
_BEFORE_S = 2.0
"""Time before a start at which SUMO is held: before the history that a run needs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """All that SUMO's state at a time depends on; ``model``: of the type for the AV, if any."""

    configuration: Configuration
    seed: int
    model: VehicleModel | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    """``process``: owner of SUMO; a copy of it does not own the files on the disk."""

    traffic: Traffic
    arguments: list[str]
    api: SumoApi
    ending: ExitStack
    process: int


_held: _Held | None = None  # libsumo is one simulation a process


@contextmanager
def begun(traffic: Traffic, backend: Backend = "libsumo") -> Iterator[SumoApi]:
    """SUMO with the traffic: the one that is held, if it has the same, else started anew."""
    global _held  # noqa: PLW0603
    held = _held
    if held and held.traffic == traffic and backend == "libsumo":
        _held = None
        with running(held.arguments, runs_already=True) as api:
            yield api
        return
    release()
    with _arguments(traffic) as arguments, running(arguments, backend) as api:
        yield api


def hold(case: TrafficCase, model: VehicleModel | None) -> None:
    """Let SUMO simulate the traffic of a network and stop shortly before the case's start.

    ``model`` is that of the coming run's planner: a run cannot use a SUMO that is held with another
    one, see `begun`. Raises SimulationError, and holds nothing then.
    """
    global _held  # noqa: PLW0603
    configuration = read_configuration(case.config, case.sumo_options)
    traffic = Traffic(configuration=configuration, seed=case.seed, model=model)
    until_s = case.start_s - _BEFORE_S
    if not (_held and _held.traffic == traffic and _held.api.simulation.getTime() <= until_s):
        release()
        with ExitStack() as ending:
            arguments = ending.enter_context(_arguments(traffic))
            api = ending.enter_context(running(arguments))
            _held = _Held(
                traffic=traffic, arguments=arguments, api=api, ending=ending.pop_all(),
                process=os.getpid(),
            )  # fmt: skip
    api = _held.api
    try:
        if api.simulation.getTime() < until_s:
            api.simulationStep(until_s)
    except (api.TraCIException, api.FatalTraCIError) as error:
        release()
        raise SimulationError(f"SUMO does not come to {until_s:g} s: {error}") from error


def release() -> None:
    """End the SUMO that is held, if one is."""
    global _held
    held, _held = _held, None
    if held and held.process == os.getpid():
        held.ending.close()
    elif held:
        held.api.close()


@contextmanager
def _arguments(traffic: Traffic) -> Iterator[list[str]]:
    """Arguments for SUMO: the traffic up to the start does not depend on the purpose of the run.

    Outputs of the configuration go to a temporary folder: else parallel runs would write into one
    another's files, and over the user's.
    """
    configuration = traffic.configuration
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        types = write_types(Path(folder) / "types.add.xml", traffic.model)
        additional = ",".join(str(path) for path in (*configuration.additional, types))
        yield [
            *("-c", str(configuration.file)),
            *configuration.options,
            *("--additional-files", additional),
            *("--seed", str(traffic.seed)),
            *("--random", "false"),
            *("--output-prefix", f"{_TO_ROOT}{folder.lstrip('/')}/"),
            *STEP_OPTIONS,
        ]
