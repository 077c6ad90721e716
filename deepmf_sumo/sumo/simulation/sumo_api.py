"""SUMO: how it is started and always closed, its errors, and the vehicle types of the runs.

libsumo runs SUMO inside this process (one simulation a process); traci talks to a SUMO process,
which is slower, and needed for sumo-gui. Both satisfy `SumoApi`.
"""

import os
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, Protocol, cast

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene.car_following import TREIBER, VehicleModel
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.sumo import installed
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.simulation import sumo_words

Backend = Literal["libsumo", "traci", "gui"]

STEP_OPTIONS = (
    *("--step-length", "0.1"),
    *("--collision.action", "none"),  # contacts are judged by boxes; SUMO must not move vehicles
    *("--no-step-log", "true"),
    *("--duration-log.disable", "true"),
    *("--no-warnings", "true"),
    *("--xml-validation", "never"),
)
"""Options of every simulation."""

_SEEDS: Final = 2**31
"""SUMO reads seeds below."""
MATCH_M: Final = 5.0
"""Largest distance of a moving road user from the lane on which SUMO still takes it."""
_NO_PORT: Final = ("--remote-port", "0")
"""A configuration may ask for a port, on which SUMO would wait for a client."""


def sumo_seed(seed: int) -> int:
    """SUMO's seed for that of a run: the same one, or one below 2**31 for those that are larger."""
    return seed % _SEEDS


class SumoApi(Protocol):
    """The used domains of TraCI, under TraCI's own names.

    Positions are front bumpers, angles degrees clockwise from north (`scene.geometry.frames`). Most
    calls on a vehicle that is not inserted yet end the process: check ``vehicle.getIDList`` first.
    """

    vehicle: Any
    person: Any
    edge: Any
    lane: Any
    route: Any
    simulation: Any
    trafficlight: Any
    vehicletype: Any
    busstop: Any
    gui: Any  # only with sumo-gui
    TraCIException: type[Exception]
    FatalTraCIError: type[Exception]

    def start(self, cmd: list[str]) -> Any:
        """Start SUMO with a command line."""
        ...

    def simulationStep(self, time: float = 0.0) -> Any:  # noqa: N802
        """One step, or all steps up to a time."""
        ...

    def close(self) -> None:
        """End the simulation."""
        ...


class Asking(NamedTuple):
    """Questions of one domain that are asked of each road user at each step, by SUMO's id.

    ``rides_in``: the vehicle of a person, empty on foot; of vehicles it means nothing.
    """

    position: Callable[[str], tuple[float, float, float]]
    angle: Callable[[str], float]
    speed: Callable[[str], float]
    rides_in: Callable[[str], str]


def asking(api: SumoApi, domain: Literal["vehicle", "person"]) -> Asking:
    """The questions of a domain.

    Of libsumo the functions below its Python layer, where it has them: with 200 persons that layer
    takes a third of the time. Subscriptions of libsumo take longer than either.
    """
    below = getattr(api, "_libsumo", None)

    def question(name: str) -> Any:
        public = getattr(getattr(api, domain), name, None)
        return getattr(below, f"{domain}_{name}", public)

    return Asking(
        position=question("getPosition3D"),
        angle=question("getAngle"),
        speed=question("getSpeed"),
        rides_in=question("getVehicle"),
    )


@contextmanager
def running(
    arguments: Sequence[str],
    backend: Backend = "libsumo",
    *,
    folder: Path | None = None,
    runs_already: bool = False,
) -> Iterator[SumoApi]:
    """SUMO from start to end; its errors inside the context are raised as SimulationError.

    Args:
        arguments: of the command line.
        backend: how it is run.
        folder: where the arguments let it write its messages (`sumo_words`).
        runs_already: it was started with these arguments, and is at the wanted time.
    """
    api = _api(backend)
    refusals = (api.TraCIException, api.FatalTraCIError)
    command = [_binary(backend), *arguments, *_of_backend(backend)]
    started = runs_already
    try:
        if not runs_already:
            api.start(command)
        started = True
        yield api
    except refusals as error:
        # repr() of libsumo's errors is the name of a wrapper object; str() is the message
        reason = str(error).strip() if started else _why_not(arguments, str(error).strip())
        with suppress(*refusals):
            api.close()  # only then is all that it said in its file
        words = reason if folder is None else sumo_words.before(reason, folder)
        raise SimulationError(f"SUMO refused{_what(arguments)}: {words}") from error
    finally:
        with suppress(*refusals):
            api.close()


def _what(arguments: Sequence[str]) -> str:
    """The configuration of a started SUMO, for the message."""
    return f" '{arguments[1]}'" if arguments[:1] == ["-c"] else ""


def _why_not(arguments: Sequence[str], error: str) -> str:
    """Why SUMO did not start: libsumo says `Process Error`, the program says more."""
    program = [_binary("libsumo"), *arguments, *_NO_PORT]
    for option in ("--begin", "--end"):
        if option in program:
            program[program.index(option) + 1] = "0"
        else:
            program += [option, "0"]
    try:
        run = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return error
    lines = [line.removeprefix("Error: ").strip() for line in run.stderr.splitlines()]
    return " ".join(line for line in lines if not line.startswith("Quitting")) or error


def load() -> None:
    """Load libsumo into this process, whose copies share it then."""
    _api("libsumo")


def _api(backend: Backend) -> SumoApi:
    if backend == "libsumo":
        try:
            import libsumo
        except ImportError as error:
            if not (home := installed.own()):
                raise
            raise SimulationError(
                f"{installed.VARIABLE} is {home}, whose libsumo this Python cannot load ({error});"
                f" unset {installed.VARIABLE} to use the installed package."
            ) from None
        installed.check(libsumo)
        return cast("SumoApi", libsumo)
    import traci

    return cast("SumoApi", traci)


def _binary(backend: Backend) -> str:
    os.environ.setdefault(installed.VARIABLE, str(sumo_tools.home()))
    return str(sumo_tools.program("sumo-gui" if backend == "gui" else "sumo"))


def _of_backend(backend: Backend) -> tuple[str, ...]:
    if backend == "libsumo":
        return _NO_PORT
    if backend == "traci":
        return ()
    # no delay on the way to the start; from there on `GuiWindow` keeps time
    shown = ("--window-size", "1200,800", "--start", "true", "--quit-on-end", "true")
    return (*shown, "--delay", "0")


AV_TYPE = "deepmf_av"
PLACED_TYPE = "deepmf_placed"
TRAFFIC_TYPE = "deepmf_traffic"
MADE_TYPE = "deepmf_made_"
"""Beginning of the types of made people; the class of road users follows."""
ANY_ROUTE = "deepmf_any"
"""Route of vehicles without a route of their own."""

# A placed vehicle must be able to have any speed of the log, else SUMO clamps the speed that
# followers see; apparentDecel is the braking that they expect of it. It may use all lanes.
_PLACED = (
    f'<vType id="{PLACED_TYPE}" vClass="ignoring" speedFactor="10" speedDev="0" maxSpeed="100" '
    'accel="1000" decel="1000" emergencyDecel="1000" apparentDecel="4.5"/>'
)
# SUMO's cars stop close behind made people. IDM draws no random numbers,
# so that they change nothing for those who do not meet them; and they have no devices.
_MADE = (
    '<vType id="{id}" vClass="passenger" carFollowModel="IDM" length="{length:g}" '
    'width="{width:g}" height="{height:g}" minGap="0.25" speedFactor="1" speedDev="0" '
    'maxSpeed="{fastest:g}">'
    '<param key="has.rerouting.device" value="false"/></vType>'
)


def _made_types() -> Iterator[str]:
    for name, one in ROAD_USERS.items():
        if one.person:
            length, width, height = one.size_m
            yield _MADE.format(
                id=MADE_TYPE + name, length=length, width=width, height=height,
                fastest=one.motion.fastest_mps,
            )  # fmt: skip


def write_types(path: Path, model: VehicleModel | None) -> Path:
    """Write an additional file with the types; without a model there is no AV type."""
    lines = [_PLACED, _driver_type(TRAFFIC_TYPE, TREIBER), *_made_types()]
    if model is not None:
        lines.append(_driver_type(AV_TYPE, model))
    path.write_text("<additional>\n    " + "\n    ".join(lines) + "\n</additional>\n", "utf-8")
    return path


def _driver_type(name: str, model: VehicleModel) -> str:
    fastest = "" if model.desired_mps is None else f'maxSpeed="{model.desired_mps:g}" '
    return (
        f'<vType id="{name}" carFollowModel="IDM" accel="{model.accel_mps2:g}" '
        f'decel="{model.decel_mps2:g}" emergencyDecel="{model.emergency_mps2:g}" '
        f'tau="{model.headway_s:g}" minGap="{model.gap_m:g}" delta="{model.exponent:g}" '
        f'{fastest}speedFactor="1" speedDev="0"/>'
    )
