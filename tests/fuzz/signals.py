"""``python -m tests.fuzz.signals``: long commands ended by signals at random moments, and resumed.

SIGKILL, SIGTERM and SIGINT, each COUNT times for each command; all choices come from the seed, but
how far a command gets by then does not. A signal comes once the command handles signals: before,
Python itself is loading. What must hold after each: no finished run is lost or done again, there is
no process of the command left after 10 s, its exit code is 130 (or that of its end), nothing was
written that looks like a traceback, and after SIGTERM and SIGINT no part of a file or folder is
left. Then the same command goes on to its end, and what it made is equal to what it makes if it is
let alone.
"""

import argparse
import csv
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz import signalled
from tests.fuzz.signalled import LongCommand
from tests.support import same_bytes

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LEAVE_S = 10.0
WHOLE_S = 900.0
KEPT = {".record.json", ".lock"}
"""Hidden files that are no parts: whose a folder is, and a lock, which only a process holds."""
INTERRUPTED = 130


@dataclass
class Disturbed:
    """A command that is ended and resumed, into one place after another.

    Attributes:
        folder: what it works on, and its working folder.
        runs: number of its runs.
        finished: runs of the place that went through, with the times at which they did.
        whole_s, code: seconds and exit code of the command that is let alone.
        wrong: what did not hold, a sentence each.
    """

    folder: Path
    name: str
    command: LongCommand
    number: int = 0
    runs: int = 0
    whole_s: float = 0.0
    code: int = 0
    finished: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    @property
    def out(self) -> Path:
        """The same each time: paths are in results."""
        return self.folder / "out" / self.name

    @property
    def whole(self) -> Path:
        """What the command makes that is let alone."""
        return self.folder / "whole" / self.name

    def begin(self, port: int = 0) -> subprocess.Popen[str]:
        """The command in a session of its own, by which all its processes are known."""
        given = [
            str(one).replace("OUT", str(self.out)).replace("PORT", str(port))
            for one in self.command.arguments
        ]
        return subprocess.Popen(
            [*signalled.PROGRAM, *given],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def let_alone(self) -> None:
        """Learn how long it takes, and what it makes."""
        self.out.parent.mkdir(exist_ok=True)
        self.whole.parent.mkdir(exist_ok=True)
        with self._running() as process:
            begin = time.monotonic()
            _, said = process.communicate(timeout=WHOLE_S)
        self.whole_s, self.code = time.monotonic() - begin, process.returncode
        assert self.code in self.command.codes, said
        if self.out.exists():
            self.out.rename(self.whole)
        self.runs = len(ids(self.whole)) if self.command.runs else 0

    @contextmanager
    def _running(self) -> Iterator[subprocess.Popen[str]]:
        """The command, once it handles signals, with a client where it wants any."""
        port = free_port()
        process = self.begin(port)
        with signalled.stepped(port, "PORT" in self.command.arguments):
            handles_signals(process)
            yield process

    def end(self, rng: random.Random, number: signal.Signals) -> str:
        """Signal the command at a moment; what it was doing.

        ``ended`` is before the signal; ``went on`` came to its end in spite of it.
        """
        what = f"{self.name} {number.name} ({self.number})"
        before = set(
            parts(self.out)
        )  # of a SIGKILL: a command that ends early leaves them to others
        with self._running() as process:
            try:
                process.wait(rng.uniform(0.0, self.whole_s))
                ended = True
            except subprocess.TimeoutExpired:
                ended = False
                everybody = rng.random() < 0.5  # as Ctrl-C does; workers are in groups of their own
                (os.killpg if everybody else os.kill)(process.pid, number)
            said = self._look(process, what)
        now = finished(self.out)
        state = "ended" if ended else "running" if now else "starting"
        if not ended and process.returncode in self.command.codes:
            state = "went on"
        self._judge(process.returncode, what, said, number, state)
        if number != signal.SIGKILL and (left := set(parts(self.out)) - before):
            self.wrong.append(f"{what}: parts are left: {sorted(left)}")
        if not self.finished.items() <= now.items():
            self.wrong.append(f"{what}: a finished run is lost or done again")
        self.finished = now
        if ended or (self.runs and len(now) == self.runs) or not self.command.resumes:
            self.complete()
        return state

    def _judge(self, code: int, what: str, said: str, number: signal.Signals, state: str) -> None:
        allowed = {INTERRUPTED, *self.command.codes}
        if number == signal.SIGKILL and state != "ended":
            allowed.add(-signal.SIGKILL)
        for file in self.out.rglob("*.json"):
            json.loads(file.read_text("utf-8"))
        if code not in allowed:
            self.wrong.append(f"{what}: ended with {code}: {said}")

    def complete(self) -> None:
        """Let the command go to its end in this place, and compare it with the whole one."""
        if self.out.is_file() and not self.command.resumes:
            self.out.unlink()
        if self.command.compares:
            process = self.begin()
            what = f"{self.name}, the end ({self.number})"
            said = self._look(process, what, WHOLE_S)
            if process.returncode != self.code:
                self.wrong.append(f"{what}: ended with {process.returncode}: {said}")
            self.wrong += [f"{what}: {one}" for one in self._differences()]
        if self.out.is_dir():
            shutil.rmtree(self.out)
        self.out.unlink(missing_ok=True)
        self.number, self.finished = self.number + 1, {}

    def _differences(self) -> Iterator[str]:
        if left := parts(self.out):
            yield f"parts are left: {left}"
        if self.whole.is_file():
            if self.whole.read_bytes() != self.out.read_bytes():
                yield "another content"
            return
        found = same_bytes.differences(self.whole, self.out)
        yield from (one for one in found if Path(one).name not in self.command.timed)
        if self.command.runs:
            there = sorted(path.name for path in (self.out / "runs").iterdir())
            if sorted(ids(self.out)) != there:
                yield f"{ids(self.out)} in the table, {there} in the folder"

    def _look(self, process: subprocess.Popen[str], what: str, limit_s: float = LEAVE_S) -> str:
        """Wait for the process, and for all of its session to be gone; the end of what it said."""
        end = time.monotonic() + limit_s
        try:
            _, said = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            self.wrong.append(f"{what}: it is still there after {limit_s:g} s")
            process.kill()
            _, said = process.communicate()
        while (left := session(process.pid)) and time.monotonic() < end:
            time.sleep(0.1)
        if left:
            self.wrong.append(f"{what}: processes are left: {left}")
        if "Traceback" in said or "unexpected" in said:
            self.wrong.append(f"{what}: {said[-2000:]}")
        return said[-300:].strip()


def run(
    folder: Path,
    count: int,
    seed: int,
    names: tuple[str, ...] = (),
    minutes: float | None = None,
) -> tuple[Counter[str], list[str]]:
    """How many signals of each kind came when, and what did not hold; no name: all commands."""
    rng = random.Random(seed)
    # a shell's background job ignores SIGINT, and so would all that it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["DEEPMF_SUMO_HOME"] = str(folder / "home")
    sent: Counter[str] = Counter()
    wrong: list[str] = []
    begin = time.monotonic()
    signalled.prepare(folder)
    for name, command in signalled.commands(folder).items():
        if names and name not in names:
            continue
        one = Disturbed(folder, name, command)
        one.let_alone()
        for number in SIGNALS * count:
            if minutes is not None and time.monotonic() - begin > 60 * minutes:
                break
            sent[f"{name} {number.name} {one.end(rng, number)}"] += 1
        one.complete()
        print("\n".join(one.wrong) or f"{name}: all held", file=sys.stderr, flush=True)
        wrong += one.wrong
    return sent, wrong


def finished(out: Path) -> dict[str, int]:
    """Run id -> when it was finished, of those that went through."""
    found = {}
    for file in out.rglob("runs/[!.]*/result.json"):
        if json.loads(file.read_text())["status"] == "ok":
            found[str(file.parent.relative_to(out))] = file.stat().st_mtime_ns
    return found


def parts(out: Path) -> list[str]:
    """Files and folders that are no results: hidden ones, but for what says whose a folder is."""
    found = [path for path in out.rglob(".*") if path.name not in KEPT]
    return sorted(str(path.relative_to(out)) for path in found)


def ids(out: Path) -> list[str]:
    """Of the runs in a folder's table."""
    with (out / "runs.csv").open(newline="") as table:
        return [row["run_id"] for row in csv.DictReader(table)]


def free_port() -> int:
    """One that nobody listens on."""
    with socket.create_server(("localhost", 0)) as server:
        return int(server.getsockname()[1])


def handles_signals(process: subprocess.Popen[str]) -> None:
    """Wait until a process has a handler of SIGTERM, or has ended."""
    bit = 1 << (signal.SIGTERM - 1)
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        if int(status.partition("SigCgt:")[2].split(maxsplit=1)[0], 16) & bit:
            return
        time.sleep(0.01)


def session(leader: int) -> list[str]:
    """The processes of a session that run, with their command lines."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            state, _, _, its = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if folder.name.isdigit() and int(its) == leader and state != "Z":
                found.append((folder / "cmdline").read_text().replace("\0", " ")[:80])
        except (OSError, ValueError):
            continue
    return found


def main() -> None:
    """Count of signals and what did not hold; ends with 1 where there is any."""
    parser = argparse.ArgumentParser()
    parser.add_argument("commands", nargs="*", help="of these; all without any")
    parser.add_argument("--count", type=int, default=10, help="signals of each kind to each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, help="no signal is sent after so many")
    options = parser.parse_args()
    names = tuple(options.commands)
    with tempfile.TemporaryDirectory(prefix="signals-") as folder:
        sent, wrong = run(Path(folder), options.count, options.seed, names, options.minutes)
    for what, times in sorted(sent.items()):
        print(f"{what:30}{times:5}")
    print("\n".join(wrong) or "nothing lost, nothing doubled, no process and no part left")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
