"""SUMO's programs: where they are, and running them."""

import os
import subprocess
from functools import cache
from pathlib import Path

from deepmf_sumo.errors import ConversionError


@cache
def home() -> Path:
    """SUMO's root folder, as the ``eclipse-sumo`` package installed it.

    Raises ConversionError where that package is missing.
    """
    try:
        import sumo
    except ImportError:
        raise ConversionError(
            "SUMO's programs are missing: install the package 'eclipse-sumo' "
            "in the version of 'libsumo'."
        ) from None
    return Path(sumo.SUMO_HOME)


def program(name: str) -> Path:
    """Path of a SUMO program, e.g. ``netconvert``. Raises ConversionError if it is missing."""
    for file in (home() / "bin" / name, home() / "bin" / f"{name}.exe"):
        if file.is_file():
            return file
    raise ConversionError(f"SUMO's program '{name}' is missing in {home() / 'bin'}.")


def environment() -> dict[str, str]:
    """The process environment with SUMO_HOME set to the installed package."""
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
    """Version of the installed SUMO, e.g. ``1.28.0``."""
    import importlib.metadata

    return importlib.metadata.version("eclipse-sumo")
