"""SUMO configurations, and a SUMO held shortly before a start.

The runs of an attack on a network share the traffic, and start at different times. If they are
ordered by start time, SUMO simulates that traffic once: it is held shortly before each start, a
copy of this process (`os.fork`) goes on from there, and here SUMO waits for the next start. A copy
has all of SUMO's state, so nothing differs from a SUMO that was started for the run alone.
"""

import math
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import AgentId, TrafficCase, VehicleModel
from deepmf_sumo.sumo.network.sumo_net import truth
from deepmf_sumo.sumo.network.sumo_road import road_once
from deepmf_sumo.sumo.simulation import sumo_options, sumo_words
from deepmf_sumo.sumo.simulation.sumo_api import (
    STEP_OPTIONS,
    Backend,
    SumoApi,
    running,
    sumo_seed,
    write_types,
)
from deepmf_sumo.sumo.simulation.sumo_outputs import confined

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


def read_configuration(
    file: Path, beside: Sequence[str] = (), *, simulated: bool = True
) -> Configuration:
    """Read a .sumocfg, with SUMO's options ``beside`` it.

    Of one that is not ``simulated`` here, the mesoscopic model does not matter.

    Raises SimulationError if the file is missing, is not XML, names no network, a file that does
    not exist or a path with a comma, or asks for the mesoscopic model; UsageError for options that
    cannot be given.
    """
    if not file.is_file():
        raise SimulationError(f"There is no SUMO configuration '{file}'.")
    _check_name(file.absolute())
    options = sumo_options.of_configuration(file)
    given = sumo_options.parse(beside)
    options |= given
    if "net-file" not in options:
        raise SimulationError(f"'{file}' names no network: it needs <net-file value=\"...\"/>.")
    net, *others = _inputs(file, options["net-file"], "network") or [None]
    if net is None or others:
        raise SimulationError(
            f"'{file}' names {1 + len(others) if net else 0} networks; name one in <net-file>."
        )
    if simulated and truth(options.get("mesosim", "false")):
        raise SimulationError(
            f"'{file}' asks for SUMO's mesoscopic model (mesosim), which has no positions of"
            " vehicles, so that none can be hit; run it without, e.g. '-- --mesosim false', or"
            " set it to false in the file."
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
    """Paths of a list of files. Raises SimulationError for one that cannot be given to SUMO."""
    found = sumo_options.paths(names, file.parent)
    for path in found:
        _check_name(path)
        if not path.is_file():
            raise SimulationError(f"'{file}' names the {kind} '{path}', which does not exist.")
    return found


def _check_name(path: Path) -> None:
    if "," in str(path):
        raise SimulationError(
            f"'{path}' has a comma in its path, at which SUMO separates the names of files; rename"
            " the folder."
        )


def _end(file: Path, text: str | None) -> float | None:
    seconds = _seconds(file, "end", text) if text is not None else -1.0
    return seconds if seconds >= 0 else None


def _seconds(file: Path, name: str, text: str) -> float:
    """Seconds of a time, which SUMO writes as such or as [days:]hours:minutes:seconds."""
    parts = text.split(":")
    try:
        if len(parts) not in {1, 3, 4}:
            raise ValueError
        numbers = [float(part) for part in parts]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError
    except ValueError:
        raise SimulationError(
            f"'{file}' has {name} '{text}', which is not a time: write seconds, or"
            " [days:]hours:minutes:seconds."
        ) from None
    scales = (86400.0, 3600.0, 60.0, 1.0)[-len(numbers) :]
    return sum(number * scale for number, scale in zip(numbers, scales, strict=True))


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
    folder: Path
    api: SumoApi
    ending: ExitStack
    process: int


_held: _Held | None = None  # libsumo is one simulation a process


@contextmanager
def begun(
    traffic: Traffic,
    backend: Backend = "libsumo",
    warned: list[str] | None = None,
    *,
    any_model: bool = False,
) -> Iterator[SumoApi]:
    """SUMO with the traffic: the one that is held, if it has the same, else started anew.

    ``any_model``: whatever the type for the AV is, which is not used. ``warned`` gets the warnings
    of a SUMO that was started anew, when it has ended.
    """
    global _held  # noqa: PLW0603
    held = _held
    same = held and (replace(held.traffic, model=traffic.model) if any_model else held.traffic)
    if held and same == traffic and backend == "libsumo":
        _held = None
        with (
            _messages(held) as folder,
            running(held.arguments, folder=folder, runs_already=True) as api,
        ):
            yield api
        return
    release()
    with command_line(traffic) as (arguments, folder):
        with running(arguments, backend, folder=folder) as api:
            yield api
        if warned is not None:
            warned += sumo_words.warnings_in(folder)


@contextmanager
def _messages(held: _Held) -> Iterator[Path]:
    """Where a SUMO that was held writes its messages: copies of it do not share a file."""
    if held.process == os.getpid():
        yield held.folder
        return
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        sumo_words.divert(held.folder, Path(folder))
        yield Path(folder)


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
            arguments, folder = ending.enter_context(command_line(traffic))
            api = ending.enter_context(running(arguments, folder=folder))
            _held = _Held(
                traffic=traffic, arguments=arguments, folder=folder, api=api,
                ending=ending.pop_all(), process=os.getpid(),
            )  # fmt: skip
    api = _held.api
    try:
        if api.simulation.getTime() < until_s:
            api.simulationStep(until_s)
    except (api.TraCIException, api.FatalTraCIError) as error:
        with suppress(api.TraCIException, api.FatalTraCIError):
            api.close()  # only then is all that it said in its file
        reason = sumo_words.before(str(error), _held.folder)
        release()
        raise SimulationError(f"SUMO does not come to {until_s:.12g} s: {reason}") from error


def release() -> None:
    """End the SUMO that is held, if one is."""
    global _held
    held, _held = _held, None
    if held and held.process == os.getpid():
        held.ending.close()
    elif held:
        held.api.close()


@contextmanager
def command_line(traffic: Traffic, more: str = "") -> Iterator[tuple[list[str], Path]]:
    """Arguments for SUMO: the traffic up to the start does not depend on the purpose of the run.

    Outputs of the configuration go to a temporary folder, which is given, too: else parallel runs
    would write into one another's files, and over the user's. ``more``: elements of an additional
    file.
    """
    configuration = traffic.configuration
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        types = write_types(Path(folder) / "types.add.xml", traffic.model)
        added = [types]
        if more:
            added.append(Path(folder) / "more.add.xml")
            added[-1].write_text(f"<additional>{more}</additional>", "utf-8")
        additional = ",".join(str(path) for path in (*configuration.additional, *added))
        heard = sumo_words.OPTION in configuration.options  # the user's own goes there, too
        arguments = [
            *("-c", str(configuration.file)),
            *configuration.options,
            *("--additional-files", additional),
            *("--seed", str(sumo_seed(traffic.seed))),
            *("--random", "false"),
            *(() if heard else sumo_words.to_file(Path(folder))),
            *STEP_OPTIONS,
        ]
        yield confined(arguments, Path(folder)), Path(folder)


def network_case(
    config: Path,
    start_s: float,
    av: AgentId,
    duration_steps: int = 80,
    seed: int = 0,
    sumo_options: tuple[str, ...] = (),
) -> TrafficCase:
    """The case of a .sumocfg whose vehicle ``av`` the planner drives from ``start_s`` on.

    ``sumo_options``: beside the configuration, as on SUMO's command line.

    Raises SimulationError if the configuration or its network is missing. Whether the vehicle is
    present at the start is known only in the simulation.
    """
    configuration = read_configuration(config, sumo_options)
    return TrafficCase(
        name=f"{config.stem}-{av}-{start_s:.12g}s",
        road=road_once(configuration.net, configuration.additional),
        av_id=av,
        duration_steps=duration_steps,
        seed=seed,
        config=config,
        start_s=start_s,
        net_file=configuration.net,
        sumo_options=sumo_options,
    )
