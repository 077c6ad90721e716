"""Gives programs of ours inputs that were changed at random, each in a process of its own.

A `Kind` of input makes a valid one, changes it, and uses it as a command would. Refusing an input
is right (DeepmfError, or the exit code and the sentence of a command); these are not:

- traceback: another exception, or one that the command line calls unexpected;
- killed: the process was ended by a signal, e.g. a segmentation fault;
- hang: more than `CPU_S` of CPU time, with that of its child processes;
- memory: more than `MEMORY_MB` at once in one process, beside what it begins with;
- outside: a file was written elsewhere than in the folder for results.
"""

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.errors import DeepmfError

CPU_S = 5.0
MEMORY_MB = 500
WALL_S = 60.0
_CPU_LIMIT_S = 15
_MEMORY_LIMIT = 6 * 2**30
_REFUSED, _TRACEBACK = 10, 11
_UNEXPECTED = re.compile(r"unexpected\s+[A-Za-z.]+:\s")
GOOD = ("accepted", "refused")
BAD = ("traceback", "killed", "hang", "memory", "outside")


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    Attributes:
        make: writes a valid input into an empty folder and returns its path (a file or folder).
        change: changes the input at a path, in place; all its choices come from the generator.
        use: uses the input at the first path, writes below the second one at most. Raises
            DeepmfError to refuse; `command` runs a command line.
    """

    name: str
    make: Callable[[Path], Path]
    change: Callable[[random.Random, Path], None]
    use: Callable[[Path, Path], object]


@dataclass(frozen=True)
class Outcome:
    """What became of one input; ``said`` is what was printed or raised."""

    kind: str
    number: int
    result: str
    cpu_s: float
    peak_mb: float
    said: str


def command(*arguments: object) -> None:
    """Run a command line of deepmf-sumo. Raises DeepmfError where it ends with 2 or 3."""
    from deepmf_sumo.cli import main

    code = main.run([str(one) for one in arguments])
    if code not in {0, 1}:
        raise DeepmfError(f"ended with {code}")


def run(kind: Kind, count: int, seed: int, keep: Path | None = None) -> Iterator[Outcome]:
    """The outcomes of inputs 0 to count - 1; number n is the same whatever the count.

    Inputs that are not handled well are copied into ``keep``.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        world = Path(folder)
        seed_folder = world / "seed"
        seed_folder.mkdir()
        valid = kind.make(seed_folder)
        for number in range(count):
            # As deep as a path that leads out of the folder for results would climb.
            place = world / "w" / "x" / "y" / "z"
            shutil.copytree(seed_folder, place / "given", symlinks=True)
            given = place / "given" / valid.relative_to(seed_folder)
            kind.change(random.Random(f"{kind.name} {seed} {number}"), given)
            outcome = _outcome(kind, number, given, place, world)
            if keep and outcome.result in BAD:
                with contextlib.suppress(shutil.Error):  # pipes are left out
                    shutil.copytree(place / "given", keep / kind.name / str(number), symlinks=True)
            yield outcome
            for left in world.iterdir():
                if left != seed_folder:
                    shutil.rmtree(left) if left.is_dir() else left.unlink()


def table(outcomes: list[Outcome]) -> str:
    """A line for each kind, and one for each input that was not handled well."""
    lines = [f"{'kind':14}" + "".join(f"{one:>10}" for one in (*GOOD, *BAD, "cpu s", "MB"))]
    for name in dict.fromkeys(one.kind for one in outcomes):
        own = [one for one in outcomes if one.kind == name]
        counts = Counter(one.result for one in own)
        figures = "".join(f"{counts[result]:10}" for result in (*GOOD, *BAD))
        slowest, largest = max(one.cpu_s for one in own), max(one.peak_mb for one in own)
        lines.append(f"{name:14}{figures}{slowest:10.2f}{largest:10.0f}")
    lines += [
        f"{one.kind} {one.number}: {one.result}, {one.cpu_s:.1f} CPU s, {one.peak_mb:.0f} MB: "
        f"{one.said[-300:]!r}"
        for one in outcomes
        if one.result in BAD
    ]
    return "\n".join(lines)


def _outcome(kind: Kind, number: int, given: Path, place: Path, world: Path) -> Outcome:
    out, log = place / "out", world / "log"
    out.mkdir()
    (place / "home").mkdir()
    before = _files(world)
    begun, begins = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.write(begins, str(_resident_mb()).encode())
        _child(kind, given, out, place, log)
    watch = threading.Timer(WALL_S, os.killpg, (pid, signal.SIGKILL))
    watch.start()
    _, status, used = os.wait4(pid, 0)
    watch.cancel()
    said = log.read_text("utf-8", errors="replace") if log.exists() else ""
    strange = [path for path in _files(world) ^ before if not path.is_relative_to(out)]
    # a copy begins with what this process holds, which is a lot in a run of all tests
    begun_mb = float(os.read(begun, 100))
    os.close(begun)
    os.close(begins)
    cpu_s, peak_mb = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024 - begun_mb
    result = _result(os.waitstatus_to_exitcode(status), said, cpu_s, peak_mb)
    if result in GOOD and strange:
        result, said = "outside", " ".join(map(str, strange))
    return Outcome(kind.name, number, result, cpu_s, peak_mb, said)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def _result(code: int, said: str, cpu_s: float, peak_mb: float) -> str:
    if cpu_s > CPU_S or code in {-signal.SIGXCPU, -signal.SIGKILL}:
        return "hang"
    if code < 0:
        return "killed"
    if code == _TRACEBACK or "Traceback (" in said or _UNEXPECTED.search(said):
        return "traceback"
    if peak_mb > MEMORY_MB:
        return "memory"
    return "refused" if code == _REFUSED else "accepted"


def _child(kind: Kind, given: Path, out: Path, place: Path, log: Path) -> None:
    os.setpgid(0, 0)
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_LIMIT_S, _CPU_LIMIT_S + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_LIMIT, _MEMORY_LIMIT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    stream = os.open(log, os.O_WRONLY | os.O_CREAT)
    for number in (1, 2):
        os.dup2(stream, number)
    # pytest keeps what is printed to these; the child prints to the log alone.
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    os.environ |= {"DEEPMF_SUMO_HOME": str(out / "home"), "TMPDIR": str(out), "HOME": str(out)}
    tempfile.tempdir = str(out)
    os.chdir(out)
    code = _TRACEBACK
    try:
        kind.use(given, out)
        code = 0
    except DeepmfError as error:
        print(error)
        code = _REFUSED
    except BaseException:  # noqa: BLE001 - told from a refusal
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _files(world: Path) -> set[Path]:
    return {path for path in world.rglob("*") if path != world / "log"}
