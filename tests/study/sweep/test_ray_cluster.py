"""Sweeps on a real Ray cluster of two machines, both of them this one."""

import importlib.util
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import UsageError
from deepmf_sumo.study.sweep import batch

from tests.support import same_bytes, tiny_network

if importlib.util.find_spec("ray") is None:
    pytest.skip("Ray is not installed: pip install deepmf-sumo[cluster]", allow_module_level=True)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1200),
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning"),
]

MACHINES = 2
"""Of `ray_machines`."""

START_TRIES = 2
"""Ray's agents must start within 15 s of its daemon, which a busy machine does not grant."""

ENDED = "planner_error: the planner ended its process (SIGSEGV; see log.txt)."


class Machines:
    """The program `ray_machines`, while it runs."""

    def __init__(self, log, **environment):
        self.process = subprocess.Popen(
            [sys.executable, Path(__file__).parents[2] / "support" / "ray_machines.py"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True,
            env={**os.environ, "RAY_AUTH_MODE": "disabled", **environment},
        )  # fmt: skip
        self.port = self._heard("up")

    def tell(self, what):
        """``lose`` or ``complete``."""
        print(what, file=self.process.stdin, flush=True)
        self._heard("done")

    def end(self):
        self.process.communicate(timeout=60)

    @property
    def name(self):
        return f"ray://127.0.0.1:{self.port}"

    def _heard(self, word):
        for line in self.process.stdout:
            first, *rest = line.split() or [""]
            if first == word:
                return rest[0] if rest else None
        self.end()
        raise ChildProcessError("Ray's own processes do not start here")


@pytest.fixture(scope="module")
def machines(tmp_path_factory):
    os.environ["DEEPMF_SUMO_HOME"] = str(tmp_path_factory.mktemp("home"))
    log = tmp_path_factory.mktemp("ray") / "log.txt"
    for number in range(START_TRIES):
        try:
            with log.open("w") as file:
                started = Machines(file)
            break
        except ChildProcessError as error:
            if number == START_TRIES - 1:
                pytest.skip(f"{error}: {log.read_text().splitlines()[-1]}")
    yield started
    started.end()


@pytest.fixture(scope="module")
def specs(tiny):
    return [
        spec.load(tiny_network.spec(tiny, f"far {number}", seed=str(number))) for number in range(9)
    ]


@pytest.fixture(scope="module")
def here(machines, specs, tmp_path_factory):
    """Result folder of the same runs without a cluster."""
    out = tmp_path_factory.mktemp("here") / "out"
    run(specs, out)
    return out


def run(specs, out, report=lambda _: None, **options):
    return batch.run(specs, batch.Options(out=out, **options), report)


def test_results_are_those_of_this_machine(machines, specs, here, tmp_path):
    run(specs, tmp_path / "far", executor=machines.name)
    assert same_bytes.differences(here, tmp_path / "far") == []


def test_a_lost_machine_costs_its_run_a_second_try(machines, tiny, tmp_path, monkeypatch):
    """It is lost while both machines wait in the middle of a run."""
    own = tmp_path / "own"
    shutil.copytree(tiny, own)
    monkeypatch.syspath_prepend(str(own))
    planner = "{name: 'bad_planners:Wait'}"
    waiting = [
        spec.load(tiny_network.spec(own, f"waits {number}", seed=str(number), planner=planner))
        for number in range(4)
    ]
    said = own.with_suffix(".said")
    said.mkdir()
    go = said / "go"
    go.touch()
    run(waiting, tmp_path / "here")
    go.unlink()

    def lose():
        while len(list(said.glob("waits-*"))) < MACHINES:
            time.sleep(0.1)
        machines.tell("lose")
        while not any(progress.lost for progress in seen):  # Ray's processes take their time to die
            time.sleep(0.1)
        go.touch()

    seen = []
    for old in said.glob("waits-*"):
        old.unlink()
    threading.Thread(target=lose, daemon=True).start()
    results = run(waiting, tmp_path / "lost", seen.append, executor=machines.name)
    machines.tell("complete")
    assert [one["status"] for one in results] == ["ok"] * len(waiting)
    assert seen[-1].lost == 1
    assert seen[-1].done == len(waiting)
    assert same_bytes.differences(tmp_path / "here", tmp_path / "lost") == []


def test_bad_runs_are_rows_there_too(machines, tiny, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tiny))
    names = {"Crash": "crash", "Hang": "hang", "Raise": "bug"}
    paths = [
        tiny_network.spec(tiny, name, planner=f"{{name: 'bad_planners:{cls}'}}")
        for cls, name in names.items()
    ]
    results = run(
        [spec.load(path) for path in paths], tmp_path, executor=machines.name, timeout_s=15.0
    )
    found = {one["spec"]: (one["status"], one["error"]) for one in results}
    assert found["crash"] == ("failed", ENDED)
    assert found["hang"] == ("timeout", "longer than 15 s")
    assert found["bug"][1].startswith("planner_error: ZeroDivisionError")
    assert "Traceback" in (tmp_path / "runs" / "bug--tiny--0" / "log.txt").read_text()


def test_an_interrupt_keeps_what_came_home(machines, specs, here, tmp_path):
    def interrupt(progress):
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(specs, tmp_path / "out", interrupt, executor=machines.name)
    run(specs, tmp_path / "out", executor="local", resume=True)
    assert same_bytes.differences(here, tmp_path / "out") == []


def test_files_that_differ_are_refused(machines, tiny, tmp_path, monkeypatch):
    """The machines are all this one: a file is changed after it was looked at here."""
    from deepmf_sumo.study.sweep import ray_cluster

    own = tmp_path / "own"
    shutil.copytree(tiny, own)
    one = spec.load(tiny_network.spec(own, "changed"))
    inputs_of = ray_cluster.inputs_of

    def and_change(tasks):
        found = inputs_of(tasks)
        (own / "tiny.rou.xml").write_text("<routes/>")
        return found

    monkeypatch.setattr(ray_cluster, "inputs_of", and_change)
    with pytest.raises(UsageError, match=r"has another .*tiny\.rou\.xml: all machines"):
        run([one], tmp_path / "out", executor=machines.name)


def test_a_head_that_wants_a_token_gets_that_of_this_machine(tiny, tmp_path):
    home, nobody = tmp_path / "home", tmp_path / "nobody"
    token = home / ".ray" / "auth_token"
    token.parent.mkdir(parents=True)
    nobody.mkdir()
    token.write_text("3f" * 32)
    path = tiny_network.spec(tiny, "with a token")
    free = {key: value for key, value in os.environ.items() if not key.startswith("RAY_AUTH")}

    def call(home):
        command = [sys.executable, "-m", "deepmf_sumo.cli.main", "run", path, "--no-pictures"]
        return subprocess.run(
            [*command, "--out", home / "out", "--set", f"sweep.executor={machines.name}"],
            env={**free, "HOME": str(home)}, capture_output=True, text=True, check=False,
        )  # fmt: skip

    with (tmp_path / "log.txt").open("w") as log:
        machines = Machines(log, RAY_AUTH_MODE="token", RAY_AUTH_TOKEN_PATH=str(token))
        try:
            refused, done = call(nobody), call(home)
        finally:
            machines.end()
    assert refused.returncode == 2
    assert "no token is here" in refused.stderr.splitlines()[-1]
    assert done.returncode == 0, done.stderr
