"""What the operating system can do, and an interpreter that lacks most of it."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from deepmf_sumo import system

from tests.support import bare_python, same_bytes, tiny_network, tiny_plan

IN_A_BARE_INTERPRETER = """
import os, signal, socket, subprocess, sys, time
from pathlib import Path

from deepmf_sumo import system
from deepmf_sumo.cli import _leaving
from deepmf_sumo.errors import OutputError, PlannerError, ReaderError
from deepmf_sumo.planners.remote.process import ThreadedProcess, started
from deepmf_sumo.results import folder
from deepmf_sumo.scene.readers import _bounded

there = {one.name for one in system.abilities() if one.there}
assert there == {"locks of files"}, there
assert not hasattr(os, "fork") and not hasattr(signal, "SIGKILL")

here = Path(sys.argv[1])
if len(sys.argv) > 2:  # the other one
    try:
        with folder.held(here):
            pass
    except OutputError as error:
        print(error)
    sys.exit()
with folder.held(here):
    again = [sys.executable, *sys.orig_argv[1:], "other"]
    said = subprocess.run(again, capture_output=True, text=True)
    assert f"is being written by process {os.getpid()} of" in said.stdout, said
with folder.held(here):
    pass
assert not (here / folder.FILE).exists()

left, right = socket.socketpair()
assert not system.hung_up(left)
right.close()
assert system.hung_up(left)

def broken():
    yield 1
    raise ReaderError("bad")
items = _bounded.each(broken)
assert next(items) == 1
try:
    next(items)
except ReaderError as error:
    assert str(error) == "bad"

ECHO = "import sys; print(input()[::-1], flush=True); sys.stdin.read()"
program = started("program", [sys.executable, "-c", ECHO])
assert isinstance(program, ThreadedProcess)
assert program.ask("", b"abc\\n", 20.0, "it") == b"cba"
try:
    program.ask("", b"", 0.1, "it")
    raise AssertionError
except PlannerError as error:
    assert error.kind == "hung", error
program.close()

_leaving._IDLE_S, _leaving._LOOK_S = 0.05, 0.01
try:
    with _leaving.leaving() as asked:
        os.kill(os.getpid(), signal.SIGTERM)
        assert asked() and asked.terminated
        time.sleep(20.0)
    raise AssertionError
except KeyboardInterrupt:
    pass
print("all")
"""


@pytest.mark.sumo
def test_locks_pipes_timers_and_readers_without_posix(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(IN_A_BARE_INTERPRETER, "utf-8")
    out = tmp_path / "out"
    out.mkdir()
    done = subprocess.run(
        [sys.executable, script, out], env=bare_python.environment(tmp_path), check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("all\n", "")


def command(*arguments):
    return [sys.executable, "-m", "deepmf_sumo.cli.main", *map(str, arguments)]


def both(tmp_path, *arguments, code=0):
    """Result folders of a command with this interpreter, and with a bare one."""
    plain, bare = tmp_path / "plain" / "out", tmp_path / "bare" / "out"
    site = tmp_path / "site"
    site.mkdir()
    bare_env = bare_python.environment(site)
    bare_env["PYTHONPATH"] += f"{os.pathsep}{tmp_path}"  # with planners of the test
    plain_env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    for out, env in ((plain, plain_env), (bare, bare_env)):
        done = subprocess.run(
            command(*arguments, "--out", out), env=env, check=False, capture_output=True, text=True
        )
        assert done.returncode == code, done.stderr
    return plain, bare


@pytest.mark.sumo
def test_a_run_on_a_network_has_the_same_bytes_without_posix(tmp_path):
    tiny_network.build(tmp_path)
    poses = f"{{name: trajectory, agent: leader, poses: [{tiny_plan.POSES}]}}"
    spec = tiny_network.spec(tmp_path, "fixed", adversary=poses, duration_s="0.5")
    plain, bare = both(tmp_path, "run", spec, "--no-pictures")
    assert same_bytes.differences(plain, bare) == []


@pytest.mark.sumo
@pytest.mark.skipif(not system.COPIES, reason="no copies of processes")
def test_memory_is_measured_while_processes_end():
    """A race: with the list of threads read without care one of 100 ends was an error."""
    for _ in range(60):
        if (child := os.fork()) == 0:
            os._exit(0)
        waiting = threading.Thread(target=os.waitpid, args=(child, 0))
        waiting.start()
        while waiting.is_alive():
            assert not system.holds_more_than(1e6, child)
        waiting.join()


def test_endings_in_words():
    assert system.ending(3) == "exit code 3"
    assert system.ending(-signal.SIGSEGV) == "SIGSEGV"
    assert system.ending(-99) == "signal 99"
    assert system.ending(0xC0000005) == "exit code 3221225477"  # Windows: access violation


@pytest.mark.sumo
@pytest.mark.parametrize("code", [0, 3, -signal.SIGSEGV, 2**32 - 1])
def test_a_process_ends_as_another_one_did(code):
    ending = f"from deepmf_sumo import system; system.end_as({code})"
    done = subprocess.run([sys.executable, "-c", ending], check=False)
    assert done.returncode == (code if code < 256 else 255)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "arguments",
    [
        ["attack", "suite/four_way.sumocfg", "-n", "2", "--tries", "2", "--no-pictures"],
        ["run", "scenarios/cut_in.yaml", "scenarios/red_light_runner.yaml"],
        ["run", "suite/rural.yaml", "--set", "source.moments.count=2", "--jobs", "2"],
    ],
    ids=lambda arguments: arguments[1],
)
def test_commands_have_the_same_bytes_without_posix(tmp_path, arguments):
    plain, bare = both(tmp_path, *arguments)
    assert same_bytes.differences(plain, bare) == []


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_kills_lose_nothing_without_posix(tmp_path):
    tiny_network.build(tmp_path)
    plan = tiny_plan.write(tmp_path)
    whole, env = tmp_path / "whole", bare_python.environment(tmp_path)
    subprocess.run(command("run", plan, "--out", whole), check=True, capture_output=True)
    out, kills = tmp_path / "out", 0
    while True:
        line = command("run", plan, "--out", out, "--resume", "--jobs", "2")
        before = len(list(out.glob("runs/*/result.json")))
        process = subprocess.Popen(line, env=env, stdout=-3, stderr=-3)
        while process.poll() is None and len(list(out.glob("runs/*/result.json"))) < before + 2:
            if process.poll() is None:
                _pause(process)
        if process.poll() is not None:
            break
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        kills += 1
    assert process.returncode == 0
    assert kills >= 2
    assert same_bytes.differences(whole, out) == []


def _pause(process):
    try:
        process.wait(0.05)
    except subprocess.TimeoutExpired:
        return


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_planners_that_crash_and_hang_end_their_runs_alone_without_posix(tmp_path):
    tiny_network.build(tmp_path)
    specs = [
        tiny_network.spec(tmp_path, name.lower(), planner=f"bad_planners:{name}")
        for name in ("Crash", "Hang", "Raise")
    ]
    limits = ["--set", "sweep.timeout_s=15", "--no-pictures"]
    plain, bare = both(tmp_path, "run", *specs, *limits, code=3)
    assert same_bytes.differences(plain, bare) == []


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_quick_tests_of_rooms_that_use_the_system_pass_without_posix(tmp_path):
    rooms = ["results", "scene", "spec", "study", "planners", "exporters", "judge"]
    folders = [f"tests/{room}" for room in rooms]
    # they name `fcntl`, `resource` and `os.mkfifo` themselves
    folders += ["--ignore=tests/results/test_locks.py"]
    folders += ["--ignore=tests/scene/readers/test_bounded.py"]
    folders += ["--ignore=tests/spec/test_spec_limits.py"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m",
         "not sumo and not slow and not slow_unit", *folders],
        env=bare_python.environment(tmp_path), check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-5000:]
