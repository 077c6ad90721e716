"""SUMO with a configuration's traffic: from its begin, or held at a moment of it.

The runs of an attack on a network begin with the same traffic, each at a moment of its own. Who
does several of them in the order of their moments lets SUMO pass through the traffic once: it is
held shortly before each moment, a copy of this process (`os.fork`) goes on from there, and here
SUMO waits to go on to the next. A copy has all of SUMO's state: nothing differs from a SUMO that
was started for the run alone.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.datatypes import Case, VehicleModel
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.simulation.configuration import Configuration, read_configuration
from deepmf_sumo.simulation.sumo_api import STEP_OPTIONS, Backend, SumoApi, running
from deepmf_sumo.simulation.vehicle_types import write_types

_TO_ROOT = "../" * 64
"""SUMO puts its prefix between an output's folder and its name; there are no folders above /."""
_BEFORE_S = 2.0
"""So long before a start SUMO is held: before the history that a run looks back at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """What SUMO's state at a time depends on; ``model`` is the AV's type, where it gets one."""

    configuration: Configuration
    seed: int
    model: VehicleModel | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    """``process``: whose SUMO it is; in a copy of it, what is on the disk is not its own."""

    traffic: Traffic
    arguments: list[str]
    api: SumoApi
    ending: ExitStack
    process: int


_held: _Held | None = None  # libsumo is one simulation a process


@contextmanager
def begun(traffic: Traffic, backend: Backend = "libsumo") -> Iterator[SumoApi]:
    """SUMO with the traffic, at its begin or, where it is held, later; once."""
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


def hold(case: Case, model: VehicleModel | None) -> None:
    """Let SUMO pass through a network's traffic and stop shortly before the case's start.

    ``model`` is what the planner of the coming run asks for: SUMO that is held with another one
    is of no use to it, see `begun`. Raises SimulationError, and holds nothing then.
    """
    global _held  # noqa: PLW0603
    assert case.network is not None
    source = case.network
    configuration = read_configuration(source.config, source.sumo_options)
    traffic = Traffic(configuration=configuration, seed=case.seed, model=model)
    until_s = source.start_s - _BEFORE_S
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
    """Arguments for SUMO: the same traffic up to the start, whoever looks at it and why.

    What the configuration wants to have written goes to a temporary folder: parallel runs would
    write into one another's files, and over the user's.
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
