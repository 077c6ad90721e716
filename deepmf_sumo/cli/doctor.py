"""``deepmf-sumo doctor``: whether everything that a run needs is installed and fits together."""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Final, Literal, NamedTuple

import click

from deepmf_sumo import system
from deepmf_sumo.errors import DeepmfError, exit_code
from deepmf_sumo.sumo import installed

_MARKS: Final = {"ok": ("ok", "green"), "warning": ("warn", "yellow"), "broken": ("BAD", "red")}


@click.command(name="doctor", short_help="Check that everything a run needs works.")
@click.option(
    "--weights", metavar="NAME", multiple=True, default=("open",), show_default=True,
    help="Check these weights.",
)  # fmt: skip
@click.pass_context
def command(ctx: click.Context, weights: tuple[str, ...]) -> None:
    """Check Python, SUMO, libraries, machine, weights and cache: one line each.

    \b
    Exit codes: 0 runs will work (a warning is about what few users need); 1 they will not.
    """
    from concurrent.futures import ThreadPoolExecutor

    import deepmf_sumo

    click.echo(f"deepmf-sumo {deepmf_sumo.__version__}")
    checks: dict[str, Callable[[], CheckResult]] = {
        "Python": python,
        "system": system_calls,
        "SUMO packages": sumo_versions,
        "libsumo": libsumo,
        "netconvert": netconvert,
        "sumo-gui": sumo_gui,
        "SUMO_HOME": sumo_home,
        "networks": networks,
        "libraries": libraries,
        "cores": cores,
        "memory": memory,
        **{f"weights {name}": partial(weights_of_set, name) for name in weights},
        "cache": cache,
    }
    states = []
    with ThreadPoolExecutor(max_workers=4) as pool:  # most of them wait for a process
        for name, (state, text) in zip(checks, pool.map(look, checks.values()), strict=True):
            states.append(state)
            mark, colour = _MARKS[state]
            line = " ".join(text.split())
            click.echo(f"{click.style(f'{mark:4}', fg=colour)} {name:14} {line}")
    ctx.exit(exit_code("broken") if "broken" in states else 0)


State = Literal["ok", "warning", "broken"]
PROBE_S: Final = 120.0
"""The first import of torch from a slow disk takes a minute."""


class CheckResult(NamedTuple):
    """What a check found; ``warning``: something that few users need does not work."""

    state: State
    text: str


def look(check: Callable[[], CheckResult]) -> CheckResult:
    """The finding of a check; one that fails itself is a finding too."""
    try:
        return check()
    except Exception as error:  # noqa: BLE001 - whatever is broken here is what is looked for
        return CheckResult("broken", f"{type(error).__name__}: {error}")


def probe(code: str) -> tuple[bool, str]:
    """Run Python code in a separate process; whether it succeeded, and its last line.

    A wheel that does not fit ends its process, often by a signal and without a traceback.
    """
    return ended([sys.executable, "-c", code], PROBE_S)


def ended(command: list[str], timeout_s: float) -> tuple[bool, str]:
    """Run a program; whether it succeeded, and its last line, or how it ended."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=timeout_s,
            check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return False, f"did not end within {timeout_s:g} s"
    except OSError as error:
        return False, f"{command[0]} cannot be started: {error.strerror}"
    if done.returncode == 0:
        return True, _last(done.stdout)
    if done.returncode < 0:
        return False, f"its process was ended by signal {-done.returncode}"
    return False, _last(done.stderr) or f"exit code {done.returncode}"


def _last(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


_MB: Final = 2**20
_RUN_MB: Final = 1000
"""A run with DeepMF's networks, and the process that leads it."""
_CGROUP: Final = Path("/sys/fs/cgroup/memory.max")


def cores() -> CheckResult:
    """Cores that this process may use, for --jobs."""
    usable = system.cores()
    return CheckResult("ok", f"{usable}: --jobs {usable}")


def system_calls() -> CheckResult:
    """What the operating system can do, and what is done where it cannot."""
    lacking = [f"no {one.name}: {one.instead}" for one in system.abilities() if not one.there]
    name = f"{platform.system()} {platform.machine()}"
    if not lacking:
        return CheckResult("ok", f"{name}: all that runs can use")
    return CheckResult("warning", f"{name}: {'; '.join(lacking)} (results are the same)")


def memory() -> CheckResult:
    """Memory that is free, within the container's limit."""
    free, limit = _free_mb(), _limit_mb()
    if free is None:
        return CheckResult("ok", "not known on this system")
    usable = min(free, limit) if limit is not None else free
    enough = usable >= _RUN_MB
    told = f"{free:.0f} MB free" + (f", limit {limit:.0f} MB" if limit is not None else "")
    need = f"; a run needs about {_RUN_MB} MB" if not enough else ""
    return CheckResult("ok" if enough else "warning", told + need)


def weights_of_set(name: str) -> CheckResult:
    """Whether a set of weights is there and fits the networks; which others there are."""
    good, text = probe(
        "import sys; from deepmf_sumo.errors import DeepmfError\n"
        "from deepmf_sumo.deepmf.networks import weights\n"
        f"try: folder = weights.load({name!r}).folder; lacking = weights.unchecked(folder);"
        " people = weights.without_people(folder)\n"
        "except DeepmfError as error: sys.exit(' '.join(str(error).split()))\n"
        "print(folder, *([f'({len(lacking)} cards without a digest of their tensors)']"
        " if lacking else []), *([f'({people})'] if people else []))"
    )
    there = {file.parent.name for home in _homes() for file in home.glob("*/opponent.json")}
    also = f"; also there: {', '.join(sorted(there - {name}))}" if there - {name} else ""
    return CheckResult("ok" if good else "broken", text + also)


def cache() -> CheckResult:
    """Whether converted networks can be kept, how much is, and how much space is left."""
    from deepmf_sumo.files import cache_folder

    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        hint = "set DEEPMF_SUMO_HOME to a folder that can"
        return CheckResult("broken", f"{folder} cannot be written ({error.strerror}); {hint}")
    held = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / _MB
    free = shutil.disk_usage(folder).free / _MB
    text = f"{folder}, {held:.0f} MB in it, {free:.0f} MB left"
    return CheckResult("ok" if free >= 100 else "warning", text)


def _homes() -> list[Path]:
    """Where sets of weights are looked up by name."""
    root = os.environ.get("DEEPMF_SUMO_HOME")
    return [Path(".weights"), *([Path(root) / "weights"] if root else [])]


def _free_mb() -> float | None:
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return None
    sizes = {line.partition(":")[0]: line.split()[1] for line in lines if line.endswith("kB")}
    return float(sizes["MemAvailable"]) / 1024 if "MemAvailable" in sizes else None


def _limit_mb() -> float | None:
    """Of the container; None without one."""
    try:
        text = _CGROUP.read_text("ascii").strip()
    except OSError:
        return None
    return None if text == "max" else int(text) / _MB


OLDEST_PYTHON: Final = (3, 11)
NEWEST_SUMO: Final = "1.28.0"
"""The newest that was tried."""
SUMO: Final = ("libsumo", "eclipse-sumo", "sumolib", "traci")
"""They share file formats and a protocol: one version for all."""
_LIBRARIES: Final = ("numpy", "pandas", "shapely", "pydantic", "matplotlib.pyplot")
PROGRAM_S: Final = 60.0


def python() -> CheckResult:
    """The interpreter."""
    version = ".".join(map(str, sys.version_info[:3]))
    fits = sys.version_info[:2] >= OLDEST_PYTHON
    oldest = ".".join(map(str, OLDEST_PYTHON))
    text = f"{version}, {sys.executable}" + ("" if fits else f"; {oldest} or newer is needed")
    return CheckResult("ok" if fits else "broken", text)


def sumo_versions() -> CheckResult:
    """Whether SUMO's four packages are there, in one version."""
    found = {name: _installed(name) for name in SUMO}
    wanted = next((version for version in found.values() if version), NEWEST_SUMO)
    told = ", ".join(f"{name} {version or 'missing'}" for name, version in found.items())
    wrong = [name for name, version in found.items() if version != wanted]
    if not wrong:
        return CheckResult("ok", told)
    asked = " ".join(f"{name}=={wanted}" for name in wrong)
    return CheckResult("broken", f"{told}; install them as: pip install {asked}")


def libsumo() -> CheckResult:
    """Whether SUMO's library can be loaded into Python."""
    good, text = probe(
        "import sys; from deepmf_sumo.errors import DeepmfError\n"
        "from deepmf_sumo.sumo.simulation import sumo_api\n"
        "try: sumo_api.load()\n"
        "except DeepmfError as error: sys.exit(str(error))\n"
        "import libsumo; print(libsumo.getVersion()[1])"
    )
    return _loaded(good, text)


def netconvert() -> CheckResult:
    """Whether SUMO's programs start; networks are built by one of them."""
    return _program("netconvert", "broken", "networks cannot be built")


def sumo_gui() -> CheckResult:
    """Whether `sweep.gui` can work: a program and a display."""
    found = _program("sumo-gui", "warning", "sweep.gui does not work")
    if found.state != "ok" or not system.NEEDS_DISPLAY:
        return found
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if display:
        return CheckResult("ok", f"{found.text}, display {display}")
    return CheckResult(
        "warning", "no display (DISPLAY is not set): sweep.gui does not work, all else does"
    )


def sumo_home() -> CheckResult:
    """Whether SUMO_HOME, which is not needed here, names a SUMO that is used."""
    named = os.environ.get(installed.VARIABLE)
    if not named:
        return CheckResult("ok", "not set; the installed package is used")
    if installed.own():
        return CheckResult("ok", f"{named} is used instead of the installed package")
    if why := installed.reason(Path(named)):
        return CheckResult("warning", f"{named} {why}; {installed.package()} is used")
    return CheckResult("ok", named)


def networks() -> CheckResult:
    """Whether the networks can be computed, and by what."""
    good, text = probe(
        "import sys; from deepmf_sumo.errors import DeepmfError\n"
        "from deepmf_sumo.deepmf.networks.weights import runtime_name\n"
        "try: name = runtime_name()\n"
        "except DeepmfError as error: sys.exit(str(error))\n"
        "if name == 'onnx':\n"
        " import onnxruntime; print(f'ONNX Runtime {onnxruntime.__version__}'); sys.exit()\n"
        "import torch; torch.ones(8, 8) @ torch.ones(8, 8);"
        " there = torch.cuda.is_available();"
        " gpu = torch.cuda.get_device_name() if there else 'no GPU (none needed)';"
        " print(f'torch {torch.__version__}, {torch.get_num_threads()} threads, {gpu}')"
    )
    return _loaded(good, text)


def libraries() -> CheckResult:
    """Whether the other libraries can be loaded."""
    good, text = probe(f"import {', '.join(_LIBRARIES)}")
    if good:
        names = [name.partition(".")[0] for name in _LIBRARIES]
        text = ", ".join(f"{name} {_installed(name) or '?'}" for name in names)
    return _loaded(good, text)


def _program(name: str, failed: State, consequence: str) -> CheckResult:
    from deepmf_sumo.sumo.network import sumo_tools

    try:
        good, text = ended([str(sumo_tools.program(name)), "--version"], PROGRAM_S)
    except DeepmfError as error:
        good, text = False, str(error)
    return CheckResult("ok", "starts") if good else CheckResult(failed, f"{consequence}: {text}")


def _loaded(good: bool, text: str) -> CheckResult:
    return CheckResult("ok", text) if good else CheckResult("broken", f"cannot be loaded: {text}")


def _installed(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
