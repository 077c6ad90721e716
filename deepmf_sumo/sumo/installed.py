"""Which SUMO is used: the installed packages, or the user's own one, which SUMO_HOME names.

A SUMO of its own has programs in ``bin`` (Debian: on the path), and Python's libsumo, traci and
sumolib in ``tools``, or beside it where it is the package ``eclipse-sumo`` of another environment.
Without a libsumo it is not used: `reason` says so, which `doctor` shows, and ``--sumo-home``
refuses. Workers find it by the same variable.
"""

import importlib.util
import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Final

from deepmf_sumo.errors import SimulationError

VARIABLE: Final = "SUMO_HOME"
OLDEST: Final = (1, 20)
"""Tried: 1.20, 1.22, 1.24, 1.26 and 1.28, see ``tests/sumo/test_versions.py``."""
_MODULES: Final = frozenset({"libsumo", "traci", "sumolib"})


@cache
def package() -> Path | None:
    """SUMO's root folder in the package ``eclipse-sumo``; None without it."""
    found = importlib.util.find_spec("sumo")
    return Path(found.origin).parent if found and found.origin else None


def own() -> Path | None:
    """The user's own SUMO, if one is used."""
    named = os.environ.get(VARIABLE)
    home = Path(named) if named else None
    return home if home and not _is_package(home) and not reason(home) else None


def _is_package(home: Path) -> bool:
    """Whether a folder is of the installed packages: libsumo names ``sumo_data`` of its own."""
    installed = package()
    return installed is not None and installed.resolve().parent == home.resolve().parent


def reason(home: Path) -> str:
    """Why a folder is not used as SUMO, as the end of a sentence; empty where it is."""
    if not home.is_dir():
        return "is not a folder"
    if not any((home / place).is_dir() for place in ("bin", "tools")):
        return "has neither 'bin' nor 'tools' in it"
    if not any(any(one.glob("_libsumo*")) for one in _places(home, "libsumo")):
        return "has no libsumo in its folder 'tools'"
    return ""


def _places(home: Path, module: str) -> list[Path]:
    return [path for path in (home / "tools" / module, home.parent / module) if path.is_dir()]


class _Finder:
    """Finds SUMO's modules in the user's own SUMO."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """As `importlib` asks for a module; None: another finder does so."""
        home = own() if name in _MODULES and path is None else None
        if home is None:
            return None
        places = [str(place.parent) for place in _places(home, name)]
        return PathFinder.find_spec(name, places, target)


def follow() -> None:
    """Let SUMO's modules that are not loaded yet come from the user's own SUMO, if one is used."""
    if _Finder not in sys.meta_path:
        sys.meta_path.insert(0, _Finder)


def check(libsumo: ModuleType) -> None:
    """Raise SimulationError where a loaded libsumo is older than what this program knows."""
    version = version_of(libsumo)
    numbers = tuple(int(one) for one in version.split(".")[:2] if one.isdigit())
    if numbers and numbers < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise SimulationError(
            f"SUMO {version} ({os.environ.get(VARIABLE)}) is too old: {oldest} or newer is needed;"
            f" unset {VARIABLE} to use the installed package."
        )


def version_of(libsumo: ModuleType) -> str:
    """``1.28.0``; of a version between two releases what SUMO says (``v1_28_0+0123``)."""
    return str(libsumo.getVersion()[1]).removeprefix("SUMO ")
