"""The reproducer as a file, and what was made smaller in words."""

import os
from pathlib import Path
from typing import Any

import yaml

from deepmf_sumo import __version__, files
from deepmf_sumo import spec as spec_module
from deepmf_sumo.errors import OutputError, RunError
from deepmf_sumo.results.findings import said
from deepmf_sumo.scene import DT_S
from deepmf_sumo.spec import Spec
from deepmf_sumo.study.shrink.search import Shrunk


def check(file: Path) -> None:
    """Raise OutputError for a file that is there or cannot be written, before any simulation."""
    if file.exists():
        raise OutputError(f"{file} exists; move it away, or give another --out.")
    if not file.absolute().parent.is_dir():
        raise OutputError(f"{file.parent} is not a folder; make it first, or give another --out.")
    files.check_writable(file.parent)


def write(found: Shrunk, file: Path) -> None:
    """Write the spec. Raises OutputError where the file cannot be written.

    The network or the recording is named relative to the file where both lie in the working folder,
    so that they can be kept together.
    """
    values = found.best.values
    source = {key: _placed(value, file) for key, value in values["source"].items()}
    body = yaml.safe_dump(
        values | {"source": source}, sort_keys=False, allow_unicode=True, default_flow_style=None
    )
    with files.writing(file):
        files.write(file, _head(found) + body)
    wanted = Spec.model_validate(values).resolved()
    if spec_module.load(file).resolved() != wanted:
        raise RunError(f"{file}: what was read back is not what was checked; report this.")


def summary(found: Shrunk) -> str:
    """What was made smaller, in one line."""
    failure, first, best = found.failure, found.first, found.best
    before, after = found.changes()
    users = f"{2 + len(failure.others)} road users -> {best.road_users}"
    time = f"hit after {failure.contact * DT_S:.1f} s -> {best.steps * DT_S:.1f} s"
    plans = f"changes of plan {before} -> {after}"
    motion = f"hardest acceleration {first.hardest_mps2:.1f} -> {best.hardest_mps2:.1f} m/s2"
    speed = f"contact at {first.contact_mps:.1f} -> {best.contact_mps:.1f} m/s"
    return f"{users}, {time}, {plans}, {motion}, {speed}; the hit is {said(best.worth)}"


def _head(found: Shrunk) -> str:
    lines = [
        f"Shrunk from the run {found.failure.run_id} by deepmf-sumo {__version__}:",
        summary(found) + ".",
        f"Planner '{found.failure.planner}' is hit by '{found.failure.opponent}', which breaks",
        "the expectation below (exit code 1). Another planner: run FILE --set planner=NAME",
    ]
    return "".join(f"# {line}\n" for line in lines)


def _placed(value: Any, file: Path) -> Any:
    """A path, relative to the file where both are in the working folder; all else as it is."""
    here = Path.cwd().resolve()
    folder = file.absolute().parent.resolve()
    if not (isinstance(value, str) and Path(value).is_absolute()):
        return value
    inside = Path(value).is_relative_to(here) and folder.is_relative_to(here)
    return os.path.relpath(value, folder) if inside else value
