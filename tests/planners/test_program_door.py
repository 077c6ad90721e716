"""A program as the planner: what it is told, what it may answer, and what is left of it."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo import plugins, system
from deepmf_sumo.errors import PlannerError, PluginError, SimulationError
from deepmf_sumo.planners import idm, isolated, program
from deepmf_sumo.planners.remote.process import Process
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support.tiny_network import build

pytestmark = pytest.mark.sumo

HOSTILE = Path(__file__).parents[1] / "support" / "hostile_planner.py"

WRONG = {
    "raise": "ended with exit code 1 (see log.txt) before it answered step 12",
    "hang": "did not answer step 12 within 0.8 s",
    "nan": "'speed_mps' is nan: Input should be a finite number",
    "wrong_length": "[5.0, 0.0, 0.0], which is not a JSON object",
    "fast": "'speed_mps' is 1000000000.0: Input should be less than or equal to 150",
    "exit": "ended with exit code 3",
    "gigabyte": "answered step 12 with a line of more than 65536 bytes",
    "gigabyte_of_lines": "answered 'hello', which is not JSON; write everything but answers to std",
    "gigabyte_of_complaints": "did not answer step 12 within 0.8 s",
    "fork": "ended with exit code 0",
    "close_stdin": "did not answer step 12 within 0.8 s",
    "close_stdout": "closed its stdout before it answered step 12",
    "not_json": "answered 'planning...', which is not JSON",
    "huge_line": "answered step 12 with a line of more than 65536 bytes",
    "wrong_types": "'speed_mps' is 'fast': Input should be a valid number",
    "unknown_key": "unknown key 'sped_mps'. Did you mean 'speed_mps'?",
    "other_step": "answered for step 11 when asked for step 12",
    "other_kind": "answered kind 'fly' at step 12; known: sumo, speed, leader, pose",
    "other_protocol": "speaks protocol 2, this is 1",
    "teleport": "(0, 5000) at step 12 is 5005.05 m from the AV",
    "deep": "which is not JSON",
    "kill_parent": "was ended by signal 9",
}


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tiny"))


def settings(**values):
    return plugins.settings("planners", "program", values)


def drive(config, planner, steps=20):
    case = network_case(config, 3.0, "av", steps, seed=0)
    return simulate(case, planner, None, rng=np.random.default_rng(0))


def running(tag: str) -> list[str]:
    """Processes with a text in their command line."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                line = (folder / "cmdline").read_bytes().decode(errors="replace")
                state = (folder / "stat").read_text().rpartition(") ")[2][0]
            except OSError:
                continue
            if tag in line and state != "Z":
                found.append(line)
    return found


@pytest.mark.parametrize("how", WRONG)
def test_a_hostile_program_is_a_clear_error_and_leaves_nobody(config, tmp_path, how, capfd):
    copy = tmp_path / f"{how}.py"
    copy.write_text(HOSTILE.read_text())
    budget = 0.8 if "did not answer" in WRONG[how] else 5.0
    planner = program.build(settings(file=str(copy), arguments=[how], step_budget_s=budget))
    begin = time.monotonic()
    with pytest.raises(PlannerError) as found:
        drive(config, planner)
    assert time.monotonic() - begin < 10.0
    assert str(found.value).startswith("planner_error: ")
    assert WRONG[how] in str(found.value)
    assert len(str(found.value)) < 500
    assert running(str(copy)) == []
    err = capfd.readouterr().err
    assert len(err) < 1_100_000
    assert ("ZeroDivisionError: a bug of the program" in err) == (how == "raise")


@pytest.mark.parametrize("how", ["raise", "hang", "exit", "close_stdout", "not_json", "huge_line"])
def test_threads_tell_of_a_program_what_polling_tells(config, tmp_path, how, monkeypatch, capfd):
    monkeypatch.setattr(system, "POLLS", False)
    test_a_hostile_program_is_a_clear_error_and_leaves_nobody(config, tmp_path, how, capfd)


def test_the_step_after_a_failed_episode_is_a_new_program(config):
    planner = program.build(settings(file=str(HOSTILE), arguments=["exit"]))
    with pytest.raises(PlannerError):
        drive(config, planner, steps=4)
    rollout = drive(config, planner, steps=2)
    assert rollout.ended == "time"
    assert running(str(HOSTILE)) == []


@pytest.mark.parametrize("polls", [True, False])
def test_the_same_idm_through_the_door_drives_the_same(config, polls, monkeypatch):
    monkeypatch.setattr(system, "POLLS", polls)
    values = {"perception": "corridor"}
    direct = drive(config, idm.build(idm.Settings(**values)), 60)
    door = isolated.Settings(planner="idm", settings=values, history_steps=1, step_budget_s=10.0)
    through = drive(config, isolated.build(door), 60)
    assert direct.tracks.position_m.tobytes() == through.tracks.position_m.tobytes()
    assert direct.tracks.velocity_mps.tobytes() == through.tracks.velocity_mps.tobytes()
    assert direct.leaders == through.leaders
    assert (direct.driver == through.driver).all()


def test_a_planner_that_needs_the_recording_says_so_behind_the_door(config, capfd):
    with pytest.raises(PlannerError, match=r"planner 'replay' ended .* before it answered the r"):
        drive(config, isolated.build(isolated.Settings(planner="replay")))
    assert "needs a recording" in capfd.readouterr().err


def test_a_class_that_hangs_in_its_own_process_is_late(config, monkeypatch):
    monkeypatch.syspath_prepend(str(config.parent))
    hanging = isolated.Settings(planner="bad_planners:Hang", step_budget_s=2.0)
    with pytest.raises(PlannerError, match="did not answer step 12 within 2 s"):
        drive(config, isolated.build(hanging))


def test_settings_of_the_planner_in_its_own_process_are_checked():
    values = {"planner": "idm", "settings": {"headway": 1.0}}
    with pytest.raises(PluginError, match="Did you mean 'headway_s'"):
        plugins.settings("planners", "isolated", values)


def test_a_program_that_never_reads_is_late_however_much_it_is_told():
    process = Process("program 'sleep'", ["sleep", "600"])
    begin = time.monotonic()
    with pytest.raises(PlannerError, match=r"the reset within 0\.3 s"):
        process.ask("reset", b"x" * 10_000_000 + b"\n", 0.3, "the reset")
    process.close()
    assert time.monotonic() - begin < 5.0


def test_a_program_that_answers_late_is_not_heard(config, tmp_path):
    file = tmp_path / "slow.py"
    file.write_text(
        "import json, sys, time\n"
        "for line in sys.stdin:\n"
        "    asked = json.loads(line)\n"
        "    if asked['type'] == 'reset':\n"
        "        print(json.dumps({'type': 'ready', 'protocol': 1}), flush=True)\n"
        "        continue\n"
        "    time.sleep(1.0)\n"
        "    print(json.dumps({'type': 'command', 'step': asked['step'], 'kind': 'sumo'}),"
        " flush=True)\n"
    )
    with pytest.raises(PlannerError, match=r"step 10 within 0\.5 s"):
        drive(config, program.build(settings(file=str(file), step_budget_s=0.5)))
    rollout = drive(config, program.build(settings(file=str(file), step_budget_s=20.0)), steps=1)
    assert rollout.ended == "time"


def test_all_ends_when_the_simulation_is_killed(tmp_path):
    copy = tmp_path / "orphan.py"
    copy.write_text(HOSTILE.read_text())
    hold = (
        "import sys, time\n"
        "from deepmf_sumo.planners.remote.process import Process\n"
        "one = Process('orphan', sys.argv[1:])\n"
        'one.ask("reset", b\'{"type": "reset"}\\n\', 30, "the reset")\n'
        "print('ready', flush=True)\ntime.sleep(600)\n"
    )
    command = [sys.executable, "-c", hold, sys.executable, str(copy), "hang"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as simulation:
        assert simulation.stdout.readline() == b"ready\n"
        assert len(running(str(copy))) >= 2
        simulation.kill()
    deadline = time.monotonic() + 5.0
    while running(str(copy)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert running(str(copy)) == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "needs 'file' or 'command'"),
        ({"file": "none.py"}, "there is no file 'none.py'"),
        ({"command": ["no-such-program"]}, "'no-such-program' is not a program on the path"),
        ({"command": ["sh"], "step_budget_s": 0.0}, "'step_budget_s' is 0.0"),
        ({"command": ["sh"], "step_budget": 1.0}, "Did you mean 'step_budget_s'"),
    ],
)
def test_settings_that_cannot_work_are_refused_before_the_run(values, message):
    with pytest.raises(PluginError, match=message):
        settings(**values)


def test_a_file_that_cannot_be_executed_is_refused(tmp_path):
    (tmp_path / "planner").write_text("#!/bin/sh\n")
    with pytest.raises(PluginError, match="is not executable"):
        settings(file=str(tmp_path / "planner"))


def test_an_error_of_ours_is_no_error_of_the_planner(config):
    case = network_case(config, 3.0, "nobody", 5, seed=0)
    with pytest.raises(SimulationError, match="'nobody' is not there"):
        simulate(case, idm.build(idm.Settings()), None, rng=np.random.default_rng(0))
