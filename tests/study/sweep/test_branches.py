"""Runs that a worker does in copies of itself, SUMO standing at their moments."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deepmf_sumo import spec, system
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep import batch, fork

from tests.support import forked_workers, same_bytes, tiny_network

pytestmark = pytest.mark.sumo

PLANNERS = """
import os, signal, sys, threading, time
from deepmf_sumo.planners.idm import Settings, build as build_idm

class _Planner:
    Settings = Settings
    def __init__(self, settings): self.idm = build_idm(settings)
    model = property(lambda self: self.idm.model)
    @classmethod
    def build(cls, settings): return cls(settings)
    def reset(self, case, rng):
        self.idm.reset(case, rng)
        self.start_s = case.start_s
    def act(self, view):
        if self.start_s == 3.0: self.go_wrong()
        return self.idm.act(view)

class Fine(_Planner):
    def go_wrong(self): pass

class Crash(_Planner):
    def go_wrong(self): os.kill(os.getpid(), signal.SIGSEGV)

class Leave(_Planner):
    def go_wrong(self): os._exit(0)

class Hang(_Planner):
    def go_wrong(self): time.sleep(600)

class Hungry(_Planner):
    def go_wrong(self):
        self.much = bytearray(2_000_000_000)
        self.much[::4096] = b"x" * len(self.much[::4096])
        time.sleep(600)
"""

COUNTED = """
import sys
from pathlib import Path
from deepmf_sumo import spec
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep import episode, fork

def count(word):  # by whichever process
    with (runs.parent / "noted.txt").open("a") as file: file.write(word + " ")

runs, copied, held = Path(sys.argv[1]), fork._copied, fork._held
runs.parent.mkdir(exist_ok=True)
fork._copied = lambda *of: (len(of) == 1 and count("copy"), copied(*of))[1]  # runs, not episodes
many = "many threads" in sys.argv  # as if SUMO had brought them
if many: sys.argv.remove("many threads")
in_passage = lambda: sys._getframe(2).f_code.co_name == "_in_passage"
fork._held = lambda *of: (in_passage() and count("hold"), held(*of))[1] and not many
planned = tasks.plan([spec.load(Path(name)) for name in sys.argv[2:]], runs)
work = episode.TaskRunner(runs=runs, cache=runs / "cache")
for task in planned:
    work(task)
"""

STARTS = (2.0, 3.0, 4.5)


@pytest.fixture
def paths(tiny):
    """Specs of three moments, in order."""

    def write(planner="idm", adversary="{name: rule, opponent: leader}"):
        (tiny / "late_planners.py").write_text(PLANNERS)
        source = "{{network: tiny.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
        return [
            tiny_network.spec(
                tiny, f"at {start}", source=source.format(start), planner=planner,
                adversary=adversary,
            )
            for start in STARTS
        ]  # fmt: skip

    return write


def done(runs, paths, folder):
    """Numbers of runs in copies, and of SUMO held for one, in a process of its own."""
    forked_workers.program(COUNTED, [str(runs), *map(str, paths)], folder)
    noted = runs.parent / "noted.txt"
    words = noted.read_text().split() if noted.exists() else []
    return words.count("copy"), words.count("hold")


def test_copies_do_what_a_simulation_of_ones_own_does(tiny, paths, tmp_path):
    forward, backward = tmp_path / "forward" / "runs", tmp_path / "backward" / "runs"
    with_networks = paths(adversary="rule")  # which choose the opponent
    assert done(forward, with_networks, tiny) == (3, 2)
    assert done(backward, with_networks[::-1], tiny) == (3, 0)
    assert len(list(forward.glob("at-*"))) == 3
    assert same_bytes.same(forward, backward)


def test_sumo_is_held_with_the_vehicle_model_of_the_coming_run(tiny, paths, tmp_path):
    """Also where the run before, in the same process, was of another planner."""
    sumo, idm = (
        [
            tiny_network.spec(
                tiny, f"{planner} {start}", planner=planner, adversary="none", duration_s="0.5",
                source=f"{{network: tiny.sumocfg, start_s: {start}, av: {{vehicle: av}}}}",
            )
            for start in STARTS
        ]
        for planner in ("sumo", "idm")
    )  # fmt: skip
    failing = tiny_network.spec(
        tiny, "fails", planner="idm", adversary="none",
        source="{network: tiny.sumocfg, start_s: 1.0, av: {vehicle: nobody}}",
    )  # fmt: skip
    used = tmp_path / "used"
    watched = COUNTED.replace(
        "planned =",
        "from deepmf_sumo.sumo.simulation import sumo_config\n"
        "taken, begun = [], sumo_config.running\n"
        "def noted(arguments, backend='libsumo', *, runs_already=False, **more):\n"
        f"    open({str(used)!r}, 'a').write('held ' if runs_already else 'anew ')\n"
        "    return begun(arguments, backend, runs_already=runs_already, **more)\n"
        "sumo_config.running = noted\nplanned =",
    )
    specs = [*sumo, failing, *idm]
    forked_workers.program(watched, [str(tmp_path / "runs"), *map(str, specs)], tiny)
    # the first of a passage runs by itself, the others from SUMO as it is held
    assert used.read_text().split() == [
        "anew",
        "anew",
        "held",
        "held",
        "anew",
        "anew",
        "anew",
        "held",
        "held",
    ]


def test_somebody_elses_planner_drives_in_copies_alone(tiny, paths, tmp_path):
    assert done(tmp_path / "fine" / "runs", paths("late_planners:Fine"), tiny) == (3, 2)


def test_a_planner_with_threads_is_not_copied(tiny, paths, tmp_path):
    thread = "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()"
    (tiny / "threaded_planners.py").write_text(f"{PLANNERS}\n{thread}\n")
    assert done(tmp_path / "threads" / "runs", paths("threaded_planners:Fine"), tiny) == (0, 0)


def test_sumo_that_cannot_be_copied_is_held_once_alone(tiny, paths, tmp_path):
    runs = tmp_path / "threads" / "runs"
    assert done(runs, ["many threads", *paths()], tiny) == (3, 1)
    assert len(list(runs.glob("at-*"))) == 3


def test_traffic_that_breaks_off_is_said_by_the_run(tiny, tmp_path):
    routes = tiny_network.ROUTES.replace(
        "</routes>", '<vehicle id="lost" depart="400"><route edges="nowhere"/></vehicle></routes>'
    )
    (tiny / "broken.rou.xml").write_text(routes)
    config = tiny_network.CONFIG.replace("tiny.rou.xml", "broken.rou.xml")
    (tiny / "broken.sumocfg").write_text(config)
    source = "{{network: broken.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
    paths = [
        tiny_network.spec(tiny, f"at {start}", source=source.format(start))
        for start in (2.0, 500.0)
    ]
    runs = tmp_path / "broken" / "runs"
    assert done(runs, paths, tiny) == (2, 0)
    error = json.loads(next(runs.glob("at-500*/result.json")).read_text())["error"]
    assert "SUMO refused" in error
    assert "nowhere" in error


@pytest.mark.parametrize(
    ("planner", "said"),
    [
        ("Crash", "planner_error: the planner ended its process (SIGSEGV;"),
        ("Leave", "planner_error: the planner ended its process (exit code 0;"),
        ("Hang", "longer than 8 s"),
        ("Hungry", "more than 1500 MB of memory"),
    ],
)
def test_what_goes_wrong_in_a_copy_costs_its_run_alone(
    tiny, paths, tmp_path, monkeypatch, planner, said
):
    monkeypatch.syspath_prepend(tiny)
    limit = 8.0 if planner == "Hang" else 20.0
    wanted = batch.Options(out=tmp_path / "out", jobs=1, timeout_s=limit, memory_mb=1500.0)
    specs = paths(f"late_planners:{planner}")
    results = batch.run([spec.load(path) for path in specs], wanted)
    assert [one["status"] for one in results][::2] == ["ok", "ok"]
    assert said in results[1]["error"]


def test_nobody_outlives_a_killed_sweep(tiny, paths, tmp_path):
    specs = [str(path) for path in paths("late_planners:Hang")[:2]]
    sweep = subprocess.Popen(
        [sys.executable, "-m", "deepmf_sumo.cli.main", "run", *specs, "--out", tmp_path / "out"],
        env={**os.environ, "PYTHONPATH": str(tiny)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    one_done = tmp_path / "out" / "runs" / "at-2-0--tiny--0"
    wait_until(one_done.is_dir)
    wait_until(lambda: len(list(system._family(sweep.pid))) > 3)  # the worker and its copy
    family = list(system._family(sweep.pid))
    sweep.kill()
    sweep.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in family))


def wait_until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_order_is_that_of_the_moments_within_a_passage(tiny, tmp_path):
    def task(name, start, planner="idm"):
        source = f"{{network: tiny.sumocfg, start_s: {start}, av: {{vehicle: av}}}}"
        path = tiny_network.spec(tiny, name, source=source, planner=planner)
        return tasks.plan([spec.load(path)], Path(tmp_path))[0]

    planned = [task("a", 5), task("b", 4, "sumo"), task("c", 3), task("d", 1, "sumo")]
    assert [one.spec.name for one in fork.in_order(planned)] == ["c", "a", "d", "b"]


def test_sumo_is_started_in_copies_alone(tiny, tmp_path):
    """A second SUMO of one process need not move vehicles as the first did."""
    started = tmp_path / "started"
    watched = COUNTED.replace(
        "planned =",
        "import os\nfrom deepmf_sumo.sumo.simulation import sumo_config\n"
        "running = sumo_config.running\n"
        "def noted(arguments, backend='libsumo', *, runs_already=False, **more):\n"
        f"    runs_already or open({str(started)!r}, 'a').write(f'{{os.getpid()}} ')\n"
        "    return running(arguments, backend, runs_already=runs_already, **more)\n"
        "sumo_config.running = noted\nprint(os.getpid(), flush=True)\nplanned =",
    )
    source = "{{network: tiny.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
    specs = [  # each is a passage of its own, for time does not go back
        tiny_network.spec(
            tiny, f"{planner} {start}", source=source.format(start), planner=planner,
            adversary="none",
        )
        for planner, start in (("idm", 3.0), ("idm", 2.0), ("sumo", 3.0), ("idm", 3.5))
    ]  # fmt: skip
    out = str(tmp_path / "out" / "runs")
    said = forked_workers.program(watched, [out, *map(str, specs)], tiny)
    processes = started.read_text().split()
    assert len(processes) == len(set(processes)) == 4  # one SUMO each
    assert said.split()[0] not in processes  # the worker's


def test_episodes_of_one_run_begin_from_one_sumo_and_do_what_others_do(tiny, tmp_path):
    """SUMO gets to the moment once for all of them."""
    source = "{{network: tiny.sumocfg, start_s: {}, av: {{vehicle: av}}}}"
    specs = [
        tiny_network.spec(
            tiny, f"search {start}", source=source.format(start), planner="idm",
            adversary="{name: bga, opponent: leader}", budget="{simulations: 5}",
        )
        for start in (2.0, 3.0)
    ]  # fmt: skip
    started = tmp_path / "started"
    watched = COUNTED.replace(
        "planned =",
        "from deepmf_sumo.sumo.simulation import sumo_config\nrunning = sumo_config.running\n"
        "def noted(arguments, backend='libsumo', *, runs_already=False, **more):\n"
        f"    open({str(started)!r}, 'a').write('held ' if runs_already else 'anew ')\n"
        "    return running(arguments, backend, runs_already=runs_already, **more)\n"
        "sumo_config.running = noted\nplanned =",
    )
    here = COUNTED.replace(
        "planned =", "fork.tried = lambda task, simulate, case: simulate()\nplanned ="
    )
    for program, name in ((watched, "copies"), (here, "one process")):
        out = tmp_path / name / "runs"
        forked_workers.program(program, [str(out), *map(str, specs)], tiny)
    # an episode without attack comes first, and tells the vehicle model; then SUMO is held
    assert started.read_text().split() == ["anew", "anew", *["held"] * 5, "anew", *["held"] * 6]
    assert same_bytes.same(tmp_path / "copies" / "runs", tmp_path / "one process" / "runs")


def test_the_index_of_the_road_is_made_once_for_all_runs(tiny, paths, tmp_path):
    """On the network of a town it takes seconds."""
    made = tmp_path / "made"
    watched = COUNTED.replace(
        "planned =",
        "from deepmf_sumo.deepmf.networks import lanes\npixels = lanes._pixels\n"
        "def noted(*of):\n"
        f"    open({str(made)!r}, 'a').write('made ')\n"
        "    return pixels(*of)\n"
        "lanes._pixels = noted\nplanned =",
    )
    specs = paths(adversary="{name: deepmf, version: S1, opponent: leader}")
    out = str(tmp_path / "out" / "runs")
    forked_workers.program(watched, [out, *map(str, specs)], tiny)
    assert made.read_text().split() == ["made"]
