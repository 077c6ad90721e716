"""`kill -9` of a sweep's workers and of the sweep itself, at random moments, then `--resume`.

The figures of studies/notebook/sweeps.md:
`pytest -m slow -s tests/study/sweep/test_kills_of_a_sweep.py`.
"""

import csv
import json
import math
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support import same_bytes, tiny_plan

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("DEEPMF_SUMO_TEST_KILLS", "50"))
RUNS = 8 * math.ceil(KILLS / 2)
MOST_RUNS = 7  # between two kills, so that some are left for the last sweep
SEEDS = list(range(RUNS // 8))  # of two moments, two planners and two methods each


@pytest.fixture(scope="module")
def command(tiny, tmp_path_factory):
    """Writes the folder that is named after it."""
    os.environ["DEEPMF_SUMO_HOME"] = str(tmp_path_factory.mktemp("home"))
    plan = tiny_plan.write(tiny, f"{tiny_plan.PLAN}seeds: {SEEDS}\n", "kills.yaml")
    return [
        sys.executable, "-m", "deepmf_sumo.cli.main", "run", plan, "--set", "sweep.figures=false",
        "--jobs", "2", "--resume", "--out",
    ]  # fmt: skip


@pytest.mark.timeout(3600)
def test_nothing_is_lost_or_doubled(command, tmp_path):
    whole, rng = tmp_path / "whole", random.Random(9)
    assert subprocess.run([*command, whole], check=False, capture_output=True).returncode == 0
    out, finished, sweeps = tmp_path / "killed 1", {}, 1
    killed = {"the sweep": 0, "a worker, then the sweep": 0}
    while sum(killed.values()) < KILLS:
        process = subprocess.Popen([*command, out], stdout=-3, stderr=-3, start_new_session=True)
        target = rng.choice(list(killed))
        _wait(process, out, len(finished) + rng.randint(-1, MOST_RUNS), rng)
        if _kill(process, target, rng):
            killed[target] += 1
            now = _finished(out)
            assert finished.items() <= now.items(), "a finished run is lost, or done again"
            finished = now
        else:  # it has come to its end between the kills: another one
            _assert_equal(whole, out)
            sweeps += 1
            out, finished = tmp_path / f"killed {sweeps}", {}
    ended = subprocess.run([*command, out], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    print(f"\nkills: {killed}; sweeps: {sweeps}; {len(finished)} of {RUNS} runs finished by kills")
    _assert_equal(whole, out)


def _wait(process, out, count, rng):
    """Until so many runs are finished, and a random time of half a run or so."""
    time.sleep(rng.uniform(0.0, 1.0))
    while len(_finished(out)) < count and process.poll() is None:
        time.sleep(0.05)
    time.sleep(rng.uniform(0.0, 0.3))


def _assert_equal(whole, out):
    assert same_bytes.differences(whole, out) == []
    with (out / "runs.csv").open(newline="") as table:
        ids = [row["run_id"] for row in csv.DictReader(table)]
    assert len(ids) == len(set(ids)) == RUNS
    assert {path.name for path in (out / "runs").iterdir()} == set(ids)


def _kill(process, target, rng):
    """Kill it; whether it had not ended by itself."""
    if process.poll() is not None:
        return False
    try:
        if target != "the sweep":
            os.kill(rng.choice(_workers(process.pid)), signal.SIGKILL)
            time.sleep(0.5)
    except (OSError, IndexError):
        pass  # it has no workers yet, or has just ended one
    process.kill()
    process.wait()
    return True


def _workers(parent):
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [
        int(pid) for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


def _finished(out):
    """Run id -> when it was finished, of those that went through."""
    found = {}
    for file in out.glob("runs/[!.]*/result.json"):
        if json.loads(file.read_text())["status"] == "ok":
            found[file.parent.name] = file.stat().st_mtime_ns
    return found
