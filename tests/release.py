"""``python -m tests.release``: what a release consists of, made in ``dist/`` and tried.

The wheel, the source archive, the wheel without torch (``light/``), and a list of all packages of
an installation (CycloneDX). `twine` checks them. Each wheel is installed into an empty environment
of each Python from 3.11 to 3.14 that is found; there `doctor` and a first attack on a network of
the package run, and all is timed.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MINORS = range(11, 15)
NETWORK = "start/suite/four_way.sumocfg"
FIRST = ("attack", NETWORK, "--moments", "1", "--no-pictures", "--out", "results")


def run(*command: object, cwd: Path = ROOT, env: dict[str, str] | None = None) -> float:
    """Run a program that must succeed; its time in s. Raises SystemExit with what it said."""
    begin = time.monotonic()
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=env, check=False, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}{done.stderr}")
    return time.monotonic() - begin


def built(dist: Path) -> list[Path]:
    """Build wheels and source archive; they are checked."""
    dist = dist.resolve()  # one folder, wherever the builder runs
    shutil.rmtree(dist, ignore_errors=True)
    hatch = (sys.executable, "-m", "hatchling", "build", "--directory", dist)
    run(*hatch)
    run(*hatch, "--target", "wheel", cwd=ROOT / "light")
    made = sorted(dist.iterdir())
    run(sys.executable, "-m", "twine", "check", "--strict", *made)
    return made


def pythons() -> Iterator[str]:
    """The interpreters that are installed."""
    for minor in MINORS:
        name = f"python3.{minor}"
        found = shutil.which(name)
        if (
            found
            and subprocess.run([found, "-V"], capture_output=True, check=False).returncode == 0
        ):
            yield found
        else:
            print(f"{name}: not found, not tried")


def tried(wheel: Path, python: str, folder: Path) -> Path:
    """Install a wheel into an empty environment and attack; prints a line. Returns the Python."""
    run(python, "-m", "venv", folder / "env")
    own = folder / "env" / "bin" / "python"
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "DEEPMF", "SUMO", "VIRTUAL_ENV"))
    } | {"DEEPMF_SUMO_HOME": str(folder / "home")}
    install = run(own, "-m", "pip", "install", "-c", ROOT / "constraints.txt", wheel, env=clean)
    program = folder / "env" / "bin" / "deepmf-sumo"
    took = {
        what: run(program, *arguments, cwd=folder, env=clean)
        for what, arguments in {
            "doctor": ("doctor",),
            "init": ("init", "start"),
            "first attack": FIRST,
            "second attack": (*FIRST, "--overwrite"),
        }.items()
    }
    (row,) = (folder / "results" / "runs").iterdir()
    assert json.loads((row / "result.json").read_text())["status"] == "ok"
    times = ", ".join(f"{what} {seconds:.1f} s" for what, seconds in took.items())
    packages = size_mb((folder / "env").rglob("*"))
    print(
        f"{wheel.name.partition('-')[0]} on {Path(python).name}: {packages:.0f} MB installed in"
        f" {install:.0f} s; {times}",
        flush=True,
    )
    return own


def size_mb(paths: Iterator[Path]) -> float:
    """Of files together; links count nothing."""
    return (
        sum(path.stat().st_size for path in paths if path.is_file() and not path.is_symlink()) / 1e6
    )


def listed(python: Path, file: Path) -> None:
    """Write the packages of an environment as CycloneDX; the same packages give the same bytes."""
    program = Path(sys.executable).with_name("cyclonedx-py")
    project = ROOT / "pyproject.toml"
    run(
        program, "environment", python, "--pyproject", project, "--output-reproducible",
        "--output-format", "JSON", "--output-file", file,
    )  # fmt: skip
    print(f"{file.name}: {len(json.loads(file.read_text())['components'])} packages")


def main(arguments: Sequence[str] | None = None) -> None:
    """Make and try the release; ends with 1 and what was said where something fails."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--dist", type=Path, default=ROOT / "dist")
    parser.add_argument("--only", choices=["deepmf_sumo", "deepmf_sumo_light"], help="this wheel")
    options = parser.parse_args(arguments)
    made = built(options.dist)
    for file in made:
        print(f"{file.name}: {file.stat().st_size / 1e6:.1f} MB")
    found = list(pythons())
    for wheel in (one for one in made if one.suffix == ".whl"):
        name = wheel.name.partition("-")[0]
        if options.only not in {None, name}:
            continue
        for number, python in enumerate(found):
            with tempfile.TemporaryDirectory(prefix="release-") as folder:
                own = tried(wheel, python, Path(folder))
                if number == 0:
                    listed(own, options.dist / f"{name}.cdx.json")


if __name__ == "__main__":
    main()
