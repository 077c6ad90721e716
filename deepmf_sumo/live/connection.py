"""Connections to a running SUMO: by its port, or the one of the user's script."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, cast

from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_AGAIN_S: Final = 0.2
"""Pause between two tries to connect."""
_CONNECTIONS: Final = Path("/proc/net/tcp")
_ESTABLISHED: Final = "01"
_EXCEPTIONS: Final = ("TraCIException", "FatalTraCIError")


class LiveApi(SumoApi, Protocol):
    """What a live attack uses beside `SumoApi`."""

    poi: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """Where SUMO listens. ``order``: number of this client. ``wait_s``: for SUMO to listen."""

    number: int
    host: str = "localhost"
    order: int = 2
    wait_s: float = 10.0


class _Shared:
    """A connection that has the exceptions of its module, as a module has.

    They are those that the code of the connection raises: importing libsumo puts another class in
    ``traci.exceptions``, and a script may use a traci of its own.
    """

    def __init__(self, connection: Any) -> None:
        import traci

        self._connection = connection
        raised = getattr(type(connection).simulationStep, "__globals__", {})
        for name in _EXCEPTIONS:
            setattr(self, name, raised.get(name, getattr(traci.exceptions, name)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)


def shared(connection: Any) -> LiveApi:
    """The script's own ``libsumo``, ``traci`` or ``traci.connect(...)``.

    Raises UsageError for anything else.
    """
    if not all(hasattr(connection, name) for name in ("vehicle", "poi", "simulationStep")):
        raise UsageError(
            f"A {type(connection).__name__} is not a simulation; give the module libsumo or traci, "
            "or what traci.connect returned."
        )
    if hasattr(connection, "TraCIException"):
        return cast("LiveApi", connection)
    return cast("LiveApi", _Shared(connection))


def connect(port: Port, stopped: Callable[[], bool] = lambda: False) -> LiveApi:
    """Join the SUMO that listens on a port.

    SUMO does not step before all of its ``--num-clients`` have connected, and accepts none later.

    Raises SimulationError if no SUMO listens in time, or the number of the client is taken, and
    KeyboardInterrupt if it is ``stopped`` before SUMO listens.
    """
    import traci

    until = time.monotonic() + port.wait_s
    while True:
        try:
            # without retries: it would print a line for each
            connection = traci.connect(port.number, numRetries=0, host=port.host)
            break
        except (traci.exceptions.FatalTraCIError, OSError, OverflowError):
            if time.monotonic() >= until:
                raise SimulationError(_nobody(port)) from None
            if stopped():
                raise KeyboardInterrupt from None
            time.sleep(min(_AGAIN_S, max(0.0, until - time.monotonic())))
    try:
        connection.setOrder(port.order)
        connection.getVersion()  # answered when all clients have connected
    except Exception as error:
        if not of_sumo(error):
            raise
        # SUMO ends, for it refuses the other client, too; it answers nothing before that one steps
        abandon(connection)
        raise SimulationError(_refused(port, error)) from None
    return shared(connection)


def others(api: LiveApi) -> int | None:
    """Number of other clients of SUMO; None if it cannot be found out.

    SUMO itself does not state it. Linux lists the connections of this machine, if SUMO runs on it.
    """
    connection = getattr(api, "_socket", None)
    if connection is None:
        return None
    try:
        own, server = connection.getsockname()[1], connection.getpeername()[1]
        rows = [line.split()[1:4] for line in _CONNECTIONS.read_text().splitlines()[1:]]
    except OSError:
        return None
    clients = [
        remote
        for local, remote, state in rows
        if state == _ESTABLISHED and local.endswith(f":{server:04X}")
    ]
    seen = any(remote.endswith(f":{own:04X}") for remote in clients)
    return len(clients) - 1 if seen else None


def abandon(api: LiveApi) -> None:
    """Close a connection on which an answer is still due: SUMO reads nothing before, and ends."""
    connection = getattr(api, "_socket", None)
    if connection is not None:
        connection.close()


def of_sumo(error: BaseException) -> bool:
    """Whether SUMO or its connection raised it: libsumo and traci have classes of their own."""
    return type(error).__name__ in _EXCEPTIONS


def lost(error: BaseException) -> bool:
    """Whether the error means that the connection is gone."""
    return type(error).__name__ == "FatalTraCIError"


def _refused(port: Port, error: Exception) -> str:
    where = f"{port.host}:{port.number}"
    if lost(error):
        return (
            f"SUMO at {where} closed the connection before its first step. Either it ended by an "
            f"error, which it has printed, or it refused client {port.order}: every client needs a "
            "number of its own, live.order, and SUMO one --num-clients for all of them."
        )
    return (
        f"SUMO at {where} refused client {port.order} ({str(error).strip()}); every client needs "
        "a number of its own, live.order, and SUMO one --num-clients for all of them."
    )


def _nobody(port: Port) -> str:
    return (
        f"No SUMO listens on {port.host}:{port.number} (waited {port.wait_s:g} s). Start SUMO with "
        f"--remote-port {port.number} --num-clients 2 and join before its first step: once all its "
        "clients have come, SUMO takes no more."
    )


def road_files(api: SumoApi, folder: Path) -> tuple[Path, tuple[Path, ...]]:
    """The network and the additional files that a running SUMO was started with.

    SUMO names them as they were given to it; ``folder``: to which relative paths are relative.

    Raises UsageError if the network is missing.
    """
    named = str(api.simulation.getOption("net-file"))
    net = folder / named
    if not named or not net.is_file():
        raise UsageError(
            f"SUMO's network '{named}' is not in {folder.absolute()}; name it with"
            " --set live.net=FILE, or run in the folder in which SUMO was started."
        )
    more = str(api.simulation.getOption("additional-files")).replace(",", " ").split()
    return net, tuple(path for path in (folder / one for one in more) if path.is_file())
