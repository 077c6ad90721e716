"""Python, SUMO's packages and the other libraries."""

import os
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Final

from deepmf_sumo.cli.health.finding import Finding, State, ended, probe

OLDEST_PYTHON: Final = (3, 11)
SUMO: Final = ("libsumo", "eclipse-sumo", "sumolib", "traci")
"""They share file formats and a protocol: one version for all."""
_LIBRARIES: Final = ("numpy", "pandas", "shapely", "pydantic", "safetensors", "matplotlib.pyplot")
PROGRAM_S: Final = 60.0
_PROGRAMS: Final = "import pathlib, sumo; print(pathlib.Path(sumo.SUMO_HOME))"


def python() -> Finding:
    """The interpreter."""
    version = ".".join(map(str, sys.version_info[:3]))
    fits = sys.version_info[:2] >= OLDEST_PYTHON
    oldest = ".".join(map(str, OLDEST_PYTHON))
    text = f"{version}, {sys.executable}" + ("" if fits else f"; {oldest} or newer is needed")
    return Finding(name="Python", state="ok" if fits else "broken", text=text)


def sumo_versions() -> Finding:
    """Whether SUMO's four packages are there, in the one version that is asked for."""
    found = {name: _installed(name) for name in SUMO}
    wanted = _wanted()
    told = ", ".join(f"{name} {version or 'missing'}" for name, version in found.items())
    wrong = [name for name, version in found.items() if version is None or version != wanted[name]]
    if not wrong:
        return Finding(name="SUMO packages", state="ok", text=told)
    asked = " ".join(f"{name}=={wanted[name]}" for name in wrong)
    return Finding(
        name="SUMO packages", state="broken", text=f"{told}; install them as: pip install {asked}"
    )


def libsumo() -> Finding:
    """Whether SUMO's library can be loaded into Python."""
    good, text = probe("import libsumo; print(libsumo.getVersion()[1])")
    return Finding(name="libsumo", state="ok" if good else "broken", text=_tell(good, text))


def netconvert() -> Finding:
    """Whether SUMO's programs start; networks are built by one of them."""
    return _program("netconvert", "broken", "networks cannot be built")


def sumo_gui() -> Finding:
    """Whether `--gui` can work: a program and a display."""
    found = _program("sumo-gui", "warning", "--gui does not work")
    if found.state != "ok" or sys.platform in {"win32", "darwin"}:
        return found
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if display:
        return Finding(name="sumo-gui", state="ok", text=f"{found.text}, display {display}")
    text = "no display (DISPLAY is not set): --gui does not work, all else does"
    return Finding(name="sumo-gui", state="warning", text=text)


def sumo_home() -> Finding:
    """Whether SUMO_HOME, which is not needed here, points to another SUMO."""
    name = "SUMO_HOME"
    named = os.environ.get(name)
    if not named:
        return Finding(name=name, state="ok", text="not set; the installed package is used")
    good, own = probe(_PROGRAMS)
    if good and Path(named).resolve() == Path(own).resolve():
        return Finding(name=name, state="ok", text=named)
    what = "another SUMO" if Path(named).is_dir() else "no folder"
    return Finding(name=name, state="warning", text=f"{named} is {what}; here {own} is used")


def torch() -> Finding:
    """Whether the networks can be computed."""
    good, text = probe(
        "import torch; torch.ones(8, 8) @ torch.ones(8, 8);"
        " there = torch.cuda.is_available();"
        " gpu = torch.cuda.get_device_name() if there else 'no GPU (none needed)';"
        " print(f'{torch.__version__}, {torch.get_num_threads()} threads, {gpu}')"
    )
    return Finding(name="torch", state="ok" if good else "broken", text=_tell(good, text))


def libraries() -> Finding:
    """Whether the other libraries can be loaded."""
    good, text = probe(f"import {', '.join(_LIBRARIES)}")
    if good:
        names = [name.partition(".")[0] for name in _LIBRARIES]
        text = ", ".join(f"{name} {_installed(name) or '?'}" for name in names)
    return Finding(name="libraries", state="ok" if good else "broken", text=_tell(good, text))


def _program(name: str, failed: State, consequence: str) -> Finding:
    good, text = probe(_PROGRAMS)
    if good:
        file = f"{name}.exe" if sys.platform == "win32" else name
        good, text = ended([str(Path(text) / "bin" / file), "--version"], PROGRAM_S)
    if good:
        return Finding(name=name, state="ok", text="starts")
    return Finding(name=name, state=failed, text=f"{consequence}: {text}")


def _tell(good: bool, text: str) -> str:
    return text if good else f"cannot be loaded: {text}"


def _wanted() -> dict[str, str]:
    """The version of each of SUMO's packages that this program asks for; else libsumo's."""
    try:
        lines = metadata.requires("deepmf-sumo") or []
    except metadata.PackageNotFoundError:  # run from its sources
        lines = []
    matches = [re.match(r"([\w.-]+)\s*==\s*([\w.]+)", line) for line in lines]
    pinned = {match[1]: match[2] for match in matches if match}
    return {name: pinned.get(name, _installed("libsumo") or "") for name in SUMO}


def _installed(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
