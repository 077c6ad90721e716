"""Planners that are classes and misbehave: a row each, and nothing is left of them."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deepmf_sumo import spec, system
from deepmf_sumo.results import stored
from deepmf_sumo.study.sweep import batch

from tests.support import tiny_network

PLANNERS = """
import multiprocessing, os, signal, sys, time
from deepmf_sumo import plugins
from deepmf_sumo.scene import Command
from deepmf_sumo.planners import _checked

class Odd(BaseException): pass

class _Planner:
    class Settings(plugins.Settings): pass
    model = None
    @classmethod
    def build(cls, settings): return cls()
    def reset(self, case, rng): self.steps = 0
    def act(self, view):
        self.steps += 1
        if self.steps == 3: self.go_wrong()
        return Command(kind="sumo")

def stay(twice=False):
    if os.fork() == 0:
        os.setsid()
        if twice and os.fork():
            os._exit(0)
        os.execv(sys.executable, [sys.executable, "-c", "import time; time.sleep(600)", TAG])

class Forks(_Planner):
    def go_wrong(self):
        for twice in (False, True): stay(twice)

class ForksAndHangs(_Planner):
    def go_wrong(self):
        for twice in (False, True): stay(twice)
        time.sleep(600)

class ForksAndEnds(_Planner):
    def go_wrong(self):
        stay(True)
        os.kill(os.getpid(), signal.SIGKILL)

class Base(_Planner):
    def go_wrong(self): raise Odd("odd")

class Interrupt(_Planner):
    def go_wrong(self): raise KeyboardInterrupt

class Unspeakable(_Planner):
    def go_wrong(self): raise Odd("no file " + os.fsdecode(bytes([255])))

class Silent(Exception):
    def __str__(self): raise RuntimeError("no text")

class Mute(_Planner):
    def go_wrong(self): raise Silent

class Generator(_Planner):
    def go_wrong(self): raise GeneratorExit

class Leave(_Planner):
    def go_wrong(self): os._exit(0)

class Crash(_Planner):
    def go_wrong(self): os.kill(os.getpid(), signal.SIGSEGV)

class CrashAtOnce(_Planner):
    @classmethod
    def build(cls, settings): os._exit(7)

class BuildRaises(_Planner):
    @classmethod
    def build(cls, settings): raise Odd("built")

class Leaves(_Planner):
    def go_wrong(self):
        os.chdir("/")
        os.environ["LEFT_BEHIND"] = "1"
        _checked.patched = True
        _Planner.left = True

class Starts(_Planner):
    def go_wrong(self):
        with multiprocessing.Pool(1) as pool: assert pool.map(abs, [-1]) == [1]
        multiprocessing.Process(target=stay).start()

class Talks(_Planner):
    def go_wrong(self): print("first" + "x" * 3_000_000 + "last", flush=True)

class Quiet(_Planner):
    def go_wrong(self): pass

class Sets(_Planner):
    def go_wrong(self):
        import warnings, numpy, torch
        numpy.seterr(all="raise")
        warnings.simplefilter("error")
        torch.set_default_dtype(torch.float64)
        torch.set_default_device("meta")

class Looks(_Planner):
    def go_wrong(self):
        left = [os.getcwd() == "/", "LEFT_BEHIND" in os.environ, hasattr(_checked, "patched")]
        left.append(hasattr(_Planner, "left"))
        if any(left): raise RuntimeError(f"the run before left something: {left}")
"""

BLAMED = {
    "Base": "planner_error: Odd: odd (see log.txt)",
    "Interrupt": "planner_error: KeyboardInterrupt: (see log.txt)",
    "Unspeakable": r"planner_error: Odd: no file \udcff (see log.txt)",
    "Mute": "planner_error: Silent: its text cannot be read (see log.txt)",
    "Generator": "planner_error: GeneratorExit: (see log.txt)",
    "Leave": "planner_error: the planner ended its process (exit code 0; see log.txt).",
    "Crash": "planner_error: the planner ended its process (SIGSEGV; see log.txt).",
    "CrashAtOnce": "planner_error: the planner ended its process (exit code 7; see log.txt).",
    "BuildRaises": "planner_error: Odd: built (see log.txt)",
    "ForksAndEnds": "planner_error: the planner ended its process (SIGKILL; see log.txt).",
    "ForksAndHangs": "longer than 8 s",
}
FINE = ("Forks", "Starts", "Leaves", "Looks", "Talks")
TAG = f"left-by-a-planner-{os.getpid()}"

pytestmark = [
    pytest.mark.sumo,
    pytest.mark.skipif(sys.platform != "linux", reason="copies of processes are Linux's"),
]


def specs(tiny, names):
    (tiny / "hostile_classes.py").write_text(f"TAG = {TAG!r}\n{PLANNERS}")
    return [
        tiny_network.spec(tiny, f"class {name}", planner=f"{{name: 'hostile_classes:{name}'}}")
        for name in names
    ]


def left():
    """Processes that planners of this test have started and that are there."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                found += [folder.name] * (TAG.encode() in (folder / "cmdline").read_bytes())
            except OSError:
                continue
    return found


def test_each_is_a_row_that_blames_the_planner_and_nothing_is_left(tiny, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tiny)
    paths = specs(tiny, [*BLAMED, *FINE])
    options = batch.Options(out=tmp_path / "out", jobs=1, timeout_s=8.0)
    results = {one["spec"]: one for one in batch.run([spec.load(path) for path in paths], options)}
    assert {name: results[f"class {name}"]["error"] for name in BLAMED} == BLAMED
    assert {name: results[f"class {name}"]["error"] for name in FINE} == dict.fromkeys(FINE, "")
    assert left() == []
    log = options.out / "runs" / results["class Talks"]["run_id"] / stored.LOG
    said = log.read_text()
    assert len(said) < 1_000_100
    assert said.startswith("first")
    assert "bytes are left out]" in said
    assert said.rstrip().endswith("last")


def test_what_a_planner_sets_in_libraries_changes_no_attack(tiny, tmp_path, monkeypatch):
    """Of a planner that sets nothing the same attack is made."""
    monkeypatch.syspath_prepend(tiny)
    (tiny / "hostile_classes.py").write_text(f"TAG = {TAG!r}\n{PLANNERS}")
    paths = [
        tiny_network.spec(
            tiny,
            f"attacked {name}",
            planner=f"{{name: 'hostile_classes:{name}'}}",
            adversary="{name: deepmf, opponent: leader}",
            duration_s="2.0",
        )
        for name in ("Quiet", "Sets")
    ]
    options = batch.Options(out=tmp_path / "out")
    quiet, sets = batch.run([spec.load(path) for path in paths], options)
    assert (quiet["error"], sets["error"]) == ("", "")
    assert quiet["plans"] > 1
    assert sets["metrics"] == quiet["metrics"]
    drives = [options.out / "runs" / one["run_id"] / "tracks.csv.gz" for one in (quiet, sets)]
    assert drives[0].read_bytes() == drives[1].read_bytes()


def test_results_lie_in_a_relative_folder_though_a_planner_goes_elsewhere(
    tiny, tmp_path, monkeypatch
):
    monkeypatch.syspath_prepend(tiny)
    monkeypatch.chdir(tmp_path)
    options = batch.Options(out=Path("out"), jobs=1)
    [result] = batch.run([spec.load(path) for path in specs(tiny, ["Leaves"])], options)
    assert result["status"] == "ok"
    assert (tmp_path / "out/runs" / result["run_id"] / "tracks.csv.gz").is_file()


def test_nothing_is_left_where_the_sweep_is_killed(tiny, tmp_path):
    [path] = specs(tiny, ["ForksAndHangs"])
    sweep = subprocess.Popen(
        [sys.executable, "-m", "deepmf_sumo.cli.main", "run", path, "--out", tmp_path / "out"],
        env={**os.environ, "PYTHONPATH": f"{tiny}:{os.environ.get('PYTHONPATH', '')}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_until(lambda: len(left()) == 2)
    family = list(system._family(sweep.pid))
    sweep.send_signal(signal.SIGKILL)
    sweep.wait()
    wait_until(lambda: not left() and not any(Path(f"/proc/{pid}").exists() for pid in family))


def test_folder_and_environment_are_as_before_where_a_planner_has_threads(tiny, tmp_path):
    """In such a process no copy can be made."""
    paths = specs(tiny, ["Leaves", "Leaves"])
    program = (
        "import os, sys, threading, time\n"
        "from pathlib import Path\n"
        "from deepmf_sumo import spec\nfrom deepmf_sumo.spec import tasks\n"
        "from deepmf_sumo.study.sweep import episode\n"
        "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
        "runs = Path(sys.argv[1])\n"
        "[task] = tasks.plan([spec.load(Path(sys.argv[2]))], runs)\n"
        "before = os.getcwd(), dict(os.environ)\n"
        "episode.TaskRunner(runs=runs, cache=runs / 'cache')(task)\n"
        "assert (os.getcwd(), dict(os.environ)) == before\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path), str(paths[0])],
        env={**os.environ, "PYTHONPATH": f"{tiny}:{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    [result] = tmp_path.glob("*/result.json")
    assert json.loads(result.read_text())["status"] == "ok"


def wait_until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)
