"""SUMO with a port that any TraCI client takes for SUMO's own, and attacks behind it.

SUMO inside has two clients, `attach` and the one that connects here. TraCI needs a number for each
of several clients (``setOrder``); the `SumoServer` gives it for its client, which needs no change.
The `relay` passes its messages on, in a process of its own: `attach` computes in this one.
"""

import json
import multiprocessing
import socket
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from deepmf_sumo import system
from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.live.relay import Said, relay
from deepmf_sumo.live.session import parts_of_a_step
from deepmf_sumo.scene import DT_S
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.simulation.sumo_outputs import confined, options_of

_END_S: Final = 3.0
_OUTPUT_S: Final = 60.0
"""Until SUMO has written its output after its clients have left."""
_LOOK_S: Final = 0.2
_STEP_LENGTH: Final = "step-length"
_SUMO_STEP_S: Final = 1.0
_EQUAL_S: Final = 1e-9


class SumoServer:
    """SUMO with a port for `attach`, and a port that looks like SUMO's own.

    Attacks need steps of 0.1 s. Where the client asks SUMO for longer ones, SUMO makes several of
    0.1 s in each of them (`client_step_s`).

    Args:
        config: a .sumocfg; None: the options say what SUMO simulates.
        port: for the client; 0 takes a free one.
        options: of SUMO, beside the configuration.
        folder: an empty one, into which SUMO writes; its outputs go nowhere else.
        gui: start sumo-gui.

    Attributes:
        port: as given, or the one that was free. inner: the port for `attach`.
        client_step_s: of the client's steps without an end of their own; None: they are SUMO's.

    Raises UsageError for a port that is in use, an option of SUMO that writes elsewhere, or steps
    of which 0.1 s is neither a part nor a multiple;
    SimulationError for a configuration that does, and where SUMO does not start.
    """

    def __init__(
        self,
        config: Path | None,
        port: int,
        folder: Path,
        options: Sequence[str] = (),
        *,
        gui: bool = False,
    ) -> None:
        self._folder = folder
        named = [] if config is None else ["-c", str(config)]
        arguments, self.client_step_s = _finer(confined([*named, *options], folder))
        self._said: set[str] = set()
        self._complaints: list[str] = []
        self._wanted: list[str] | None = None
        self._gui = gui
        self._listener = _listening(port)
        self.port = int(self._listener.getsockname()[1])
        self._start(arguments)
        spawn = multiprocessing.get_context("spawn")  # this process may have threads
        self._hears, says = spawn.Pipe()
        self._relay = spawn.Process(
            target=relay,
            args=(self._listener, self.inner, says, self._sumo.pid, folder),
            kwargs={"gui": gui, "step_s": self.client_step_s},
            name="traci relay",
            daemon=True,
        )
        resource_tracker.ensure_running()  # starting it would let interrupts through
        with system.interrupts_held_back():
            self._relay.start()
        says.close()
        self._listener.close()  # it is the relay's now

    @property
    def joined(self) -> bool:
        """Whether the client has connected."""
        return self._heard("joined")

    def _start(self, arguments: Sequence[str]) -> None:
        """Start SUMO for two clients, on a free port."""
        self.inner = _free_port()
        program = sumo_tools.program("sumo-gui" if self._gui else "sumo")
        ports = ["--remote-port", str(self.inner), "--num-clients", "2"]
        start = ["--start", "--quit-on-end"] if self._gui else []
        self._sumo = subprocess.Popen(
            [str(program), *arguments, *ports, *start],
            env=sumo_tools.environment(),
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C in a terminal is for this process alone
        )

    @property
    def loads(self) -> bool:
        """Whether the client waits for another simulation: see `load`."""
        self._heard("load")
        return self._wanted is not None

    def load(self) -> bool:
        """Start the simulation that the client waits for, once SUMO has ended; False: it does not.

        `attach` has to join it, as the first one.
        """
        if not self.loads:
            return False
        assert self._wanted is not None
        killed = not self._ended_sumo(_OUTPUT_S)
        if killed or self._sumo.returncode:
            how = "was killed after 60 s" if killed else f"ended with {self._sumo.returncode}"
            self._complaints.append(f"SUMO {how} at the client's load; its output may be cut off")
        arguments = _without_ports(self._wanted, gui=self._gui)
        arguments, self.client_step_s = _finer(confined(arguments, self._folder))
        self._start(arguments)
        self._wanted = None
        self._hears.send((self.inner, self._sumo.pid, self.client_step_s))
        return True

    @property
    def left(self) -> bool:
        """Whether it has left this simulation, as of what SUMO has been told by now."""
        return self._heard("left") or self._wanted is not None

    @property
    def unused(self) -> bool:
        """Whether it has left without a step."""
        return self._heard("unused")

    @property
    def complaints(self) -> list[str]:
        """Sentences on clients that were refused or broke off."""
        self._heard("complaint")
        return self._complaints

    @property
    def ended(self) -> bool:
        """Whether SUMO has."""
        return self._sumo.poll() is not None

    def check(self, wait_s: float = 0.0) -> None:
        """Raise SimulationError where SUMO has ended by an error, or does so within a time.

        Not where it was ended here, since it did not answer: that is a complaint.
        """
        if self._heard("stuck"):
            return
        with suppress(subprocess.TimeoutExpired):
            self._sumo.wait(wait_s)
        if code := self._sumo.poll():
            raise SimulationError(f"SUMO ended with exit code {code}; see what it printed.")

    def await_client(self, stopped: Callable[[], bool]) -> None:
        """Until a client has connected, SUMO has ended, or until ``stopped``.

        Raises SimulationError where nothing listens any more.
        """
        while not (self.joined or stopped() or self.ended):
            if not self._relay.is_alive():
                raise SimulationError("the process that listens on the port has ended.")
            with suppress(OSError):
                self._hears.poll(_LOOK_S)

    def stay(self, stopped: Callable[[], bool]) -> None:
        """Until the client has left and SUMO has ended, or until it `loads`, or ``stopped``."""
        while not (stopped() or self.loads) and (self._relay.is_alive() or not self.ended):
            self._relay.join(_LOOK_S)
            with suppress(subprocess.TimeoutExpired):
                self._sumo.wait(_LOOK_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._relay.terminate()
        self._relay.join()
        self._hears.close()
        self._sumo.terminate()
        self._ended_sumo(_END_S)

    def _ended_sumo(self, patience_s: float) -> bool:
        """Wait for the end of SUMO; False: it took longer, and was killed."""
        try:
            self._sumo.wait(patience_s)
        except subprocess.TimeoutExpired:  # it does not listen while it waits for clients
            self._sumo.kill()
            self._sumo.wait()
            return False
        return True

    def _heard(self, kind: str) -> bool:
        """Whether the relay has ever said that."""
        try:
            while self._hears.poll():
                said: Said = self._hears.recv()
                self._said.add(said[0])
                if said[0] == "complaint":
                    self._complaints.append(said[1])
                if said[0] == "load":
                    self._wanted = json.loads(said[1])
        except (EOFError, OSError):  # it has ended: no client is connected any more
            self._said.add("left")
        return kind in self._said


def _finer(arguments: Sequence[str]) -> tuple[list[str], float | None]:
    """SUMO's arguments with steps of at most 0.1 s, and how long its steps would have been.

    None: as they are. Raises UsageError where 0.1 s is neither a part nor a multiple of them.
    """
    options = options_of(arguments)
    lengths = [one for one in options if one.name == _STEP_LENGTH]
    try:
        step_s = float(lengths[0].value) if lengths else _SUMO_STEP_S
    except ValueError:
        return list(arguments), None  # SUMO says so
    parts = round(step_s / DT_S)
    if parts <= 1 or abs(parts * DT_S - step_s) > _EQUAL_S:
        parts_of_a_step(step_s)
        return list(arguments), None
    others = [word for one in options if one.name != _STEP_LENGTH for word in one.words]
    return [*others, f"--{_STEP_LENGTH}", f"{DT_S:g}"], step_s


def _without_ports(arguments: Sequence[str], *, gui: bool) -> list[str]:
    """What a client loads, without what is given to SUMO here; SUMO's own load ignores it."""
    kept: list[str] = []
    words = iter(arguments)
    for word in words:
        name, equals, _ = word.partition("=")
        if name in {"--remote-port", "--num-clients"}:
            if not equals:
                next(words, None)
        elif not (gui and name in {"-S", "--start", "-Q", "--quit-on-end"}):
            kept.append(word)
    return kept


def _listening(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(system.REUSES_PORTS))
    try:
        listener.bind(("localhost", port))
    except OSError as error:
        listener.close()
        raise UsageError(f"--port {port} cannot be used: {error.strerror}.") from None
    listener.listen()
    return listener


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return int(probe.getsockname()[1])
