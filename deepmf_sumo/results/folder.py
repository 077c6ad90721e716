"""A result folder that is written: its lock, its manifest, its tables.

One sweep writes into a folder at a time. The lock is the operating system's and ends with its
process: a ``kill -9`` leaves no folder locked, and a second sweep is refused.
"""

import os
import platform
import re
import shutil
import socket
import sys
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo import files, system, tables
from deepmf_sumo.deepmf.networks.weights import runtime_and_device
from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.results import findings, junit, result, statistics, stored, turns
from deepmf_sumo.results.quantities import unit, worth
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec.profiles import headline
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.sumo import installed
from deepmf_sumo.sumo.network import sumo_tools

FILE: Final = ".lock"


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Lock a folder, which exists, for this process.

    Where the file system has no locks, nothing is locked, see `known`.

    Raises OutputError where another process has it, or the file cannot be written.
    """
    number = _locked(folder / FILE)
    try:
        yield
    finally:
        # removed while it is held: a process that has opened it meanwhile sees that it is gone
        if system.REMOVES_OPEN_FILES:
            (folder / FILE).unlink(missing_ok=True)
        os.close(number)
        if not system.REMOVES_OPEN_FILES:
            with suppress(PermissionError):  # another sweep has opened it
                (folder / FILE).unlink(missing_ok=True)


def known(folder: Path) -> bool:
    """Whether the file system of a folder has locks."""
    probe = folder / f"{FILE}.{os.getpid()}"
    number = os.open(probe, os.O_RDWR | os.O_CREAT)
    try:
        return system.lock(number)
    finally:
        os.close(number)
        probe.unlink(missing_ok=True)


def _locked(file: Path) -> int:
    """The open file, locked where that is possible."""
    while True:
        number = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            system.lock(number)
            if _is(file, number):
                break
        except BlockingIOError:
            holder = os.read(number, 200).decode("utf-8", "replace").strip() or "another process"
            os.close(number)
            raise OutputError(
                f"{file.parent} is being written by {holder}: wait until that has ended, or choose"
                " another folder for --out."
            ) from None
        os.close(number)  # the previous holder removed it between our opening and locking it
    try:
        os.ftruncate(number, 0)
        os.write(number, f"process {os.getpid()} of {socket.gethostname()}\n".encode())
    except OSError:  # the disk is full: the lock would stay as long as this process
        os.close(number)
        raise
    return number


def _is(file: Path, number: int) -> bool:
    """Whether an open file is still the file of that name."""
    try:
        return os.path.samestat(file.stat(), os.fstat(number))
    except FileNotFoundError:
        return False


MADE: Final = (
    "runs", "runs.csv", "summary.json", "junit.xml", "report.html", "study.json", "table.csv",
    "table.md", "table.tex", "differences.csv", "equal_seconds.csv", "curves.csv", "accidents.csv",
    "figures", "moments.csv", "shard.json", "turns.csv", "risk",
    "attacks.jsonl", "session.json", "sumo",
)  # fmt: skip
"""What an earlier batch, benchmark or live session leaves in its folder beside the manifest."""
WAYS: Final = (
    "--resume goes on with them, --overwrite deletes them, another folder for --out keeps them"
)
"""What the user can do about earlier results, for commands with these options."""
RISK, PAGE = "risk", "report.html"
"""What is made of all runs, only on demand."""
RISK_FILES: Final = {
    "risk.csv", "risk.html", "edges.xml", "movements.xml", "polygons.add.xml", "risk.sumocfg",
    "conflicts.csv", "types.csv", "coverage.csv", "attacks.csv", "net.net.xml", "net.net.xml.gz",
    "places.geojson", "attacks.geojson", "risk.gpkg",
}  # fmt: skip
"""All files of a risk map: whatever else lies beside them is the user's."""
_OF_NETWORK: Final = re.compile(r"[1-9][0-9]*-.+")
"""Folders in a risk map of several networks."""
_NUMBERED: Final = {"accident_type", "avoidance_grade", "rung"}
"""Metrics whose values are numbers of names: counted, since their mean says nothing."""
_DIRECTIONS: Final = {"pdof"}
"""Directions: a mean across the jump from -pi to pi is not a direction between them."""
_PACKAGES: Final = (
    "libsumo", "eclipse-sumo", "torch", "onnxruntime", "numpy", "pydantic", "shapely",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Store:
    """A result folder that is being filled."""

    out: Path

    @property
    def runs(self) -> Path:
        """The folder of all runs."""
        return self.out / "runs"

    def earlier(self, task: Task) -> Result | None:
        """The result of a successful run of this name that is already there.

        It belongs to an equal run where its ``key`` is the task's.
        """
        try:
            found = self.read_run(task.run_id)
        except UsageError:  # none, or damaged: the run is repeated
            return None
        return found if found["status"] == "ok" else None

    def read_run(self, run_id: str) -> Result:
        """The result of a run that is there. Raises UsageError where it cannot be read."""
        file = stored.run_folder(self.out, run_id, stored.RUNS) / stored.RESULT
        return stored.result_of(file, whole=True)

    def manifest(
        self,
        keys: Mapping[str, str],
        machine: Mapping[str, Any],
        planned: Mapping[str, Mapping[str, Any]] | None = None,
        undecided: int = 0,
    ) -> None:
        """Write the manifest of runs, given by id and `Task.key`.

        ``machine`` is what may differ between equal batches; ``planned`` is the `result.identity`
        of each run, so that one without a result belongs to its spec; ``undecided`` is the number
        of runs to come whose moments depend on the results of these.
        """
        manifest = {
            "format_version": stored.FORMAT_VERSION,
            "tool": "deepmf-sumo",
            "version": deepmf_sumo.__version__,
            "packages": {name: _installed(name) for name in _PACKAGES} | _own_sumo(),
            "networks": runtime_and_device(),
            "runs": dict(keys),
            "planned": dict(planned or {}),
            **({"undecided": undecided} if undecided else {}),
            "machine": {
                "command": sys.argv,
                "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
                "python": platform.python_version(),
                "platform": platform.platform(),
                "cores": os.cpu_count(),
                **machine,
            },
        }
        files.write_json(self.out / stored.MANIFEST, manifest)

    def forget_begun(self) -> None:
        """Remove what runs have left that were ended before they were complete."""
        for left in self.runs.glob(".*.partial"):
            remove(left)

    def forget_views(self) -> None:
        """Remove the map and the page of earlier runs: they would not show the new ones."""
        forget_map(self.out / RISK)
        remove(self.out / PAGE)

    def finish(self, results: Sequence[Result], *, junit_too: bool, interrupted: bool) -> None:
        """Write the tables of all runs, in the order of the tasks."""
        table = tables.to_csv(map(result.row, results), result.COLUMNS, cell=str)
        files.write(self.out / stored.RUNS, table)
        by_turn = turns.table(results)
        if by_turn is not None:
            files.write(self.out / turns.TABLE, by_turn)
        files.write_json(self.out / stored.SUMMARY, summary(results, interrupted=interrupted))
        if junit_too:
            junit.write(self.out / junit.FILE, results)


@contextmanager
def opened(
    out: Path, *, resume: bool, overwrite: bool = False, ways: str = WAYS
) -> Iterator[Store]:
    """A result folder that no other process fills at the same time.

    It is empty. With ``resume`` earlier results stay; with ``overwrite`` they are deleted. ``ways``
    is the part of the message that says what the user can do about earlier results.

    Raises OutputError where the folder cannot be written, holds something else, is being filled by
    another process, or holds results and neither option is given; then nothing in it is changed.
    """
    with ExitStack() as until_done:
        with files.writing(out):
            until_done.enter_context(_claimed(out, keep=resume or overwrite, ways=ways))
            files.remove_parts(out)
            _emptied(out, resume=resume)
        yield Store(out)


def check(out: Path, *, resume: bool, overwrite: bool = False, ways: str = WAYS) -> None:
    """Raise what `opened` would raise, before any work is done; the folder stays as it is."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        with files.writing(out), _claimed(out, keep=resume or overwrite, ways=ways):
            pass
    finally:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def _claimed(out: Path, *, keep: bool, ways: str) -> Iterator[None]:
    """The folder, which is made where it is missing, locked; ``keep``: it may hold results."""
    out.mkdir(parents=True, exist_ok=True)
    if not (_is_ours(out / stored.MANIFEST) or _is_empty(out)):
        raise OutputError(f"{out} holds other files; choose an empty folder for --out.")
    with held(out):
        if not keep and holds_results(out):
            raise OutputError(f"{out} holds the results of an earlier command: {ways}.")
        yield


def holds_results(out: Path) -> bool:
    """Whether overwriting a folder of ours would lose anything: a run, or a table of runs."""
    runs = out / "runs"
    if runs.is_dir() and any(not run.name.startswith(".") for run in runs.iterdir()):
        return True
    try:
        none_planned = not stored.keys_of(out)
    except UsageError:
        none_planned = False
    return not none_planned and any((out / name).exists() for name in MADE if name != "runs")


def _emptied(out: Path, *, resume: bool) -> None:
    """Remove earlier results unless ``resume``, and check that the folder can be written."""
    if not resume:
        for name in MADE:
            forget_map(out / name) if name == RISK else remove(out / name)
    (out / "runs").mkdir(exist_ok=True)
    Store(out).forget_begun()
    files.write(out / "runs" / ".writable", "")
    (out / "runs" / ".writable").unlink()


def summary(results: Sequence[Result], *, interrupted: bool = False) -> dict[str, Any]:
    """Counts, also of hits by their worth, the rate of hits with its 95 % interval, and metrics.

    The rate is of the attacked runs: without an opponent there is no attempt. Runs of one spec and
    scene count as one in the interval.
    """
    done = [one for one in results if one["status"] == "ok"]
    attacked = [one for one in done if result.attacked(one)]
    hits = [one for one in done if one["outcome"] == "av_opponent"]
    speeds = [one["relative_mps"] for one in map(result.first_contact, hits) if one]
    touched = [(unit(one), float(one["outcome"] == "av_opponent")) for one in attacked]
    rate = statistics.rate(statistics.by_unit(touched)) if attacked else None
    return {
        "runs": len(results),
        "attacked": len(attacked),
        "hits": len(hits),
        "findings": asdict(findings.count(map(worth, hits))),
        "interrupted": interrupted,
        "out_of_time": sum(bool(one.get("search", {}).get("out_of_time")) for one in done),
        "unrepeated": len(moved := result.unrepeated(done)),
        "unrepeated_m": max(moved, default=None),
        "status": dict(Counter(one["status"] for one in results)),
        "outcome": dict(Counter(one["outcome"] for one in done)),
        "profile": headline(map(result.profile, results)),
        "expectations_broken": {
            one["run_id"]: one["expectations_broken"]
            for one in results
            if one["expectations_broken"]
        },
        "collision_rate": rate._asdict() if rate else None,
        "contact_speed_mps_mean": fmean(speeds) if speeds else None,
        "metrics": _over_runs(done),
        "timings": {
            name: median(values) if (values := _timings(done, name)) else None
            for name in (*result.TIMINGS, "wall_s")
        },
    }


def _over_runs(done: Sequence[Result]) -> dict[str, Any]:
    names = sorted({name for one in done for name in one["metrics"]})
    table = {}
    for name in names:
        found = [one["metrics"][name] for one in done if name in one["metrics"]]
        values = [value["value"] for value in found if value["value"] is not None]
        averaged = values if name not in _NUMBERED | _DIRECTIONS else []
        table[name] = {
            "unit": found[0]["unit"],
            "better": found[0]["better"],
            "runs": len(values),
            "mean": fmean(averaged) if averaged else None,
            "median": median(averaged) if averaged else None,
        }
        if name in _NUMBERED:
            counts = Counter(f"{value:g}" for value in values)
            table[name]["counts"] = dict(sorted(counts.items()))
    return table


def _timings(done: Sequence[Result], name: str) -> list[float]:
    return [one["timings"][name] for one in done if one["timings"].get(name) is not None]


def _is_empty(out: Path) -> bool:
    """Whether a folder is empty, apart from what a batch leaves that is killed at its start."""
    left = {"runs", ".writable", FILE}
    return all(path.name in left or path.match(".*.part") for path in out.rglob("*"))


def _is_ours(manifest: Path) -> bool:
    try:
        return bool(stored.mapping(manifest).get("tool") == "deepmf-sumo")
    except UsageError:
        return False


def map_folders(folder: Path) -> list[Path]:
    """A risk map's folder, and those in it of its networks where it has several."""
    inside = sorted(folder.iterdir()) if folder.is_dir() else []
    return [one for one in inside if one.is_dir() and _OF_NETWORK.fullmatch(one.name)] + [folder]


def forget_map(folder: Path, keep: Collection[Path] = ()) -> None:
    """Remove the files of a risk map, and folders that are then empty; the user's files stay."""
    for one in map_folders(folder):
        if one.is_symlink() or not one.is_dir():
            continue
        for path in (one / name for name in RISK_FILES):
            if path not in keep:
                path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty
            one.rmdir()


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _own_sumo() -> dict[str, str]:
    """The version of the user's own SUMO, where that is used instead of the packages."""
    if not installed.own():
        return {}
    return dict.fromkeys(("libsumo", "eclipse-sumo"), sumo_tools.version())


def _installed(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
