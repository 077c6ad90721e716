"""SUMO's programs: where they are, and running them."""

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

from deepmf_sumo import system
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.sumo import installed


def home() -> Path:
    """SUMO's root folder: the user's own one (`installed`), else that of ``eclipse-sumo``.

    Raises ConversionError where that package is missing.
    """
    found = installed.own() or installed.package()
    if found is None:
        raise ConversionError(
            "SUMO's programs are missing: install the package 'eclipse-sumo' "
            "in the version of 'libsumo'."
        )
    return found


def program(name: str) -> Path:
    """Path of a SUMO program, e.g. ``netconvert``. Raises ConversionError if it is missing."""
    file = home() / "bin" / f"{name}{system.PROGRAM_SUFFIX}"
    if file.is_file():
        return file
    if installed.own() and (found := shutil.which(name)):  # Debian's package has them there
        return Path(found)
    raise ConversionError(f"SUMO's program '{name}' is missing in {home() / 'bin'}.")


def environment() -> dict[str, str]:
    """The process environment with SUMO_HOME set to the SUMO that is used."""
    return {**os.environ, "SUMO_HOME": str(home())}


def run(name: str, *arguments: str, timeout_s: float = 120.0) -> str:
    """Run a SUMO program to its end and return what it wrote to stderr.

    Raises ConversionError with its first error message if it fails or takes too long.
    """
    command = [str(program(name)), *arguments]
    try:
        done = subprocess.run(
            command,
            env=environment(),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ConversionError(f"{name} did not end within {timeout_s:g} s.") from None
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        reason = lines[0] if lines else f"exit code {done.returncode}"
        raise ConversionError(f"{name} failed: {reason}")
    return done.stderr


@cache
def version() -> str:
    """Version of the SUMO that is used, e.g. ``1.28.0``."""
    if installed.own():
        import libsumo

        return installed.version_of(libsumo)
    import importlib.metadata

    return importlib.metadata.version("eclipse-sumo")
