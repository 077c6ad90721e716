"""``python -m tests.fuzz.signals``: sweeps ended by signals at random moments, and resumed.

SIGKILL, SIGTERM and SIGINT, each COUNT times; all choices come from the seed, but how far a sweep
gets by then does not. What must hold after each: no finished run is lost or done again, there is no
process of the sweep left after 10 s, nothing was written that looks like a traceback; and of each
folder when it is complete: it is equal to that of a sweep that was let alone.
"""

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.support import same_bytes, tiny_network

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
RUNS = 16
LEAVE_S = 10.0


@dataclass
class Sweep:
    """Sweeps of the same runs into one folder after another.

    Attributes:
        finished: runs of the folder that went through, with the times at which they did.
        whole_s: seconds of a sweep that is let alone.
        wrong: what did not hold, a sentence each.
    """

    folder: Path
    command: list[str]
    number: int = 0
    whole_s: float = 0.0
    finished: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    @property
    def out(self) -> Path:
        return self.folder / f"out {self.number}"

    @property
    def whole(self) -> Path:
        return self.folder / "whole"

    def begin(self, out: Path) -> subprocess.Popen[str]:
        """A sweep in a session of its own, by which all its processes are known."""
        return subprocess.Popen(
            [*self.command, str(out)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def end(self, rng: random.Random, number: signal.Signals) -> str:
        """Signal a sweep at a moment; what it was doing.

        ``ended`` is before the signal; ``went on`` had all its runs in spite of it.
        """
        process = self.begin(self.out)
        time.sleep(rng.uniform(0.0, self.whole_s))
        everybody = rng.random() < 0.5  # as Ctrl-C does; workers are in groups of their own
        ended = process.poll() is not None
        if not ended:
            (os.killpg if everybody else os.kill)(process.pid, number)
        self._look(process, f"{number.name} {self.out.name}")
        now = finished(self.out)
        state = "ended" if ended else "running" if now else "starting"
        if not ended and process.returncode == 0:  # it had no run left to do, or took no notice
            state = "went on"
        if not self.finished.items() <= now.items():
            self.wrong.append(f"{number.name}: a finished run of {self.out.name} is lost or again")
        self.finished = now
        if ended or len(now) == RUNS:
            self.complete()
        return state

    def complete(self) -> None:
        """Let the folder's sweep go to its end, and compare it with the whole one."""
        process = self.begin(self.out)
        self._look(process, f"the end of {self.out.name}", None)
        if process.returncode != 0:
            self.wrong.append(f"{self.out.name}: ended with {process.returncode}")
            return
        self.wrong += [f"{self.out.name}: {one}" for one in self._differences()]
        self.number, self.finished = self.number + 1, {}

    def _differences(self) -> Iterator[str]:
        yield from map(str, same_bytes.differences(self.whole, self.out))
        with (self.out / "runs.csv").open(newline="") as table:
            ids = [row["run_id"] for row in csv.DictReader(table)]
        there = {path.name for path in (self.out / "runs").iterdir()}
        if len(ids) != RUNS or set(ids) != there or len(there) != RUNS:
            yield f"{len(ids)} rows, {len(set(ids))} different, {len(there)} folders"

    def _look(
        self, process: subprocess.Popen[str], what: str, limit_s: float | None = LEAVE_S
    ) -> None:
        """Wait for the process, and for all of its session to be gone."""
        end = time.monotonic() + (limit_s or 600.0)
        try:
            _, said = process.communicate(timeout=limit_s or 600.0)
        except subprocess.TimeoutExpired:
            self.wrong.append(f"{what}: the sweep is still there after {limit_s:g} s")
            process.kill()
            _, said = process.communicate()
        while (left := session(process.pid)) and time.monotonic() < end:
            time.sleep(0.1)
        if left:
            self.wrong.append(f"{what}: processes are left: {left}")
        if "Traceback" in said or "unexpected" in said:
            self.wrong.append(f"{what}: {said[-300:]!r}")


def run(folder: Path, count: int, seed: int, minutes: float | None = None) -> tuple[Counter, list]:
    """How many signals of each kind came when, and what did not hold."""
    rng = random.Random(seed)
    # a shell's background job ignores SIGINT, and so would all that it starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sweep = Sweep(folder, command(folder))
    begin = time.monotonic()
    process = sweep.begin(sweep.whole)
    _, said = process.communicate()
    assert process.returncode == 0, said
    sweep.whole_s = time.monotonic() - begin
    sent: Counter[str] = Counter()
    for number in [one for _ in range(count) for one in SIGNALS]:
        if minutes is not None and time.monotonic() - begin > 60 * minutes:
            break
        sent[f"{number.name} {sweep.end(rng, number)}"] += 1
    sweep.complete()
    return sent, sweep.wrong


def command(folder: Path) -> list[str]:
    """Of a sweep; the folder for its results is what is missing."""
    tiny_network.build(folder)
    source = "{{network: tiny.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
    specs = [
        tiny_network.spec(
            folder, f"{planner} {start}", planner=planner, source=source.format(start)
        )
        for planner in ("idm", "sumo")
        for start in range(1, RUNS // 2 + 1)
    ]
    os.environ["DEEPMF_SUMO_HOME"] = str(folder / "home")
    main = [sys.executable, "-m", "deepmf_sumo.cli.main", "run", *map(str, specs)]
    return [*main, "--jobs", "2", "--no-pictures", "--resume", "--out"]


def finished(out: Path) -> dict[str, int]:
    """Run id -> when it was finished, of those that went through."""
    found = {}
    for file in out.glob("runs/[!.]*/result.json"):
        if json.loads(file.read_text())["status"] == "ok":
            found[file.parent.name] = file.stat().st_mtime_ns
    return found


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
    parser.add_argument("--count", type=int, default=50, help="signals of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, help="no signal is sent after so many")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="signals-") as folder:
        sent, wrong = run(Path(folder), options.count, options.seed, options.minutes)
    for what, times in sorted(sent.items()):
        print(f"{what:20}{times:5}")
    print("\n".join(wrong) or "nothing lost, nothing doubled, no process left")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
