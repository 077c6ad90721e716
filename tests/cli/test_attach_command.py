"""``deepmf-sumo attach`` beside another client, and what can go wrong with it."""

import csv
import json
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
import sumo

from deepmf_sumo.cli import main
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.live import attacker
from deepmf_sumo.live.connection import Port, connect

from tests.support.live_policies import Keep

CLIENT = """
import sys, time, traci
port, steps, ends = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
for _ in range(200):
    try:
        api = traci.connect(port, numRetries=0)
        break
    except traci.exceptions.FatalTraCIError:
        time.sleep(0.05)
if ends == "idles":
    print("is first", flush=True)
api.setOrder(1)  # answered when all clients have connected
if ends == "idles":
    time.sleep(600)
for step in range(1, steps + 1):
    api.simulationStep()
    assert abs(api.simulation.getTime() - 0.1 * step) < 1e-6
    if "av" in api.vehicle.getIDList():
        api.vehicle.setSpeed("av", 6.0)
    if ends == "breaks" and step == steps:
        sys.exit(1)
    if ends == "removes" and step == 30:
        api.vehicle.remove("av")
print("AV at", api.vehicle.getSpeed("av") if "av" in api.vehicle.getIDList() else "-", flush=True)
api.close()
"""


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


@pytest.fixture
def simulation(tiny, port, monkeypatch):
    """SUMO and the user's script, which ``ends`` in one way or another after some steps."""
    monkeypatch.chdir(tiny)
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    processes = []

    def start(steps, ends="closes", step_length="0.1"):
        binary = Path(sumo.SUMO_HOME) / "bin" / "sumo"
        options = ["--step-length", step_length, "--no-step-log", "--no-warnings"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        clients = ["--remote-port", str(port), "--num-clients", "2"]
        processes.append(
            subprocess.Popen([binary, "-c", "tiny.sumocfg", *options, *clients], **quiet)
        )
        script = [sys.executable, "-c", CLIENT, str(port), str(steps), ends]
        processes.append(subprocess.Popen(script, stdout=subprocess.PIPE, text=True))
        return processes

    yield start
    for process in processes:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def attach(port, out, *more):
    return main.run(["attach", "--port", str(port), "--out", str(out), *map(str, more)])


def test_steps_with_the_script_and_leaves_it_alone(simulation, port, tmp_path, capsys):
    server, script = simulation(80)
    assert attach(port, tmp_path / "live", "--av", "av", "--until", 5, "--duration", 3) == 0
    assert script.communicate()[0].strip() == "AV at 6.0"
    assert (script.returncode, server.wait()) == (0, 0)
    shown = capsys.readouterr().out
    assert "1  av  leader" in shown
    assert "left at 5.0 s, as asked" in shown
    (line,) = (tmp_path / "live" / "attacks.jsonl").read_text().splitlines()
    row = json.loads(line)
    assert (row["opponent"], row["begin_s"], row["ended"]) == ("leader", 1.1, "too_long")
    assert row["events"][-1]["kind"] == "handed_back"
    session = json.loads((tmp_path / "live" / "session.json").read_text())
    assert (session["ended"], session["attacks"]) == ("until", 1)
    assert (tmp_path / "live" / "runs" / "attack-001" / "tracks.csv.gz").is_file()
    with (tmp_path / "live" / "runs.csv").open() as table:
        (run,) = csv.DictReader(table)
    assert (run["run_id"], run["scene"], run["status"]) == ("attack-001", "av-1.1s", "ok")


def test_an_av_that_leaves_ends_the_session(simulation, port, tmp_path, capsys):
    _, script = simulation(60, "removes")
    assert attach(port, tmp_path / "live", "--av", "av") == 0
    assert script.wait() == 0
    assert "1 attack, 0 contacts; vehicle 'av' left the traffic at 3.1 s" in capsys.readouterr().out


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it cannot be seen")
def test_a_script_that_leaves_ends_the_session_and_its_last_attack_is_not_counted(
    simulation, port, tmp_path, capsys
):
    server, script = simulation(80)
    assert (
        attach(port, tmp_path / "live", "--av", "av", "--duration", 3, "--set", "live.pause_s=0")
        == 0
    )
    assert (script.wait(), server.wait()) == (0, 0)
    shown = " ".join(capsys.readouterr().out.split())
    assert "2 attacks, 0 contacts; the script left at" in shown
    assert "before the attack under way was over, which is not counted" in shown
    lines = (tmp_path / "live" / "attacks.jsonl").read_text().splitlines()
    rows = [json.loads(one) for one in lines]
    assert [row["ended"] for row in rows] == ["too_long", "too_long"]
    assert max(row["end_s"] for row in rows) <= 8.0
    session = json.loads((tmp_path / "live" / "session.json").read_text())
    assert session["ended"] == "script_left"
    assert 8.0 <= session["time_s"] <= 9.1
    with (tmp_path / "live" / "runs.csv").open() as table:
        assert {run["planner"] for run in csv.DictReader(table)} == {"script"}


def test_without_a_script_sumo_is_the_planner(simulation, port, tmp_path, capsys, monkeypatch):
    for seen, planner in ((0, "sumo"), (None, "script")):
        monkeypatch.setattr(attacker, "others", lambda api, seen=seen: seen)
        simulation(30)
        out = tmp_path / planner
        assert attach(port, out, "--av", "av", "--duration", 3, "--until", 4.5) == 0
        with (out / "runs.csv").open() as table:
            assert {run["planner"] for run in csv.DictReader(table)} == {planner}
        assert ("cannot be seen from here" in capsys.readouterr().out) == (seen is None)


def test_a_lost_connection_is_one_line_and_loses_nothing(simulation, port, tmp_path, capsys):
    simulation(60, "breaks")
    assert (
        attach(port, tmp_path / "live", "--av", "av", "--duration", 3, "--set", "live.pause_s=60")
        == 3
    )
    (line,) = [one for one in capsys.readouterr().err.splitlines() if "deepmf-sumo:" in one]
    assert "The connection was lost at 6.0" in line or "The connection was lost at 5.9" in line
    assert len((tmp_path / "live" / "attacks.jsonl").read_text().splitlines()) == 1
    assert json.loads((tmp_path / "live" / "session.json").read_text())["ended"] == "failed"


def test_an_av_that_never_comes(simulation, port, tmp_path, capsys):
    _, script = simulation(60)
    assert attach(port, tmp_path / "live", "--av", "avv", "--set", "live.patience_s=2") == 3
    assert "Vehicle 'avv' has not appeared in 2 s" in (shown := capsys.readouterr().err)
    assert "Nearest: av." in shown
    assert script.wait() == 0


def test_steps_of_one_second_are_refused_without_harm(simulation, port, tmp_path, capsys):
    server, _ = simulation(0, step_length="1")
    assert attach(port, tmp_path / "live", "--av", "av") == 2
    assert "steps by 1 s" in capsys.readouterr().err
    assert server.wait() == 0


def test_a_number_that_the_other_client_has(simulation, port, tmp_path, capsys):
    simulation(10)
    assert attach(port, tmp_path / "live", "--av", "av", "--set", "live.order=1") == 3
    assert "live.order" in capsys.readouterr().err


def test_a_number_that_the_other_client_has_while_that_one_does_nothing(simulation, port):
    server, script = simulation(10, "idles")
    assert script.stdout.readline() == "is first\n"
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(connect, Port(number=port, order=1))
        try:
            with pytest.raises(SimulationError, match="refused client 1"):
                asked.result(timeout=20)
        finally:
            server.kill()  # else a connection that waits for an answer keeps the test


def test_a_port_nobody_listens_on(port, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    assert attach(port, tmp_path / "live", "--av", "av", "--set", "live.wait_s=0.3") == 3
    shown = capsys.readouterr().err
    assert f"No SUMO listens on localhost:{port} (waited 0.3 s)" in shown
    assert "--num-clients 2" in shown


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--trigger", "speed=3"], "trigger 'speed=3': must be time=SECONDS"),
        (["--set", "planner=idm"], "only profile, adversary, weights and seed"),
        (["--set", "adversary=bbo"], "only deepmf attacks"),
        (["--set", "adversary.opponnt=x"], "Did you mean 'opponent'?"),
        (["--set", "adversary.opponent=labelled"], "only recordings label"),
        (["--set", "adversary.tries=3"], "cannot be tried again"),
        (["--duration", "1"], "--duration"),
    ],
)
def test_a_wrong_command_is_told_before_anybody_waits(port, tmp_path, capsys, options, said):
    assert attach(port, tmp_path / "live", "--av", "av", "--set", "live.wait_s=0", *options) == 2
    assert said in capsys.readouterr().err


def test_an_earlier_session_is_kept_until_another_begins(port, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    (tmp_path / "manifest.json").write_text('{"tool": "deepmf-sumo", "runs": {"attack-001": ""}}')
    (tmp_path / "attacks.jsonl").write_text("earlier\n")
    assert attach(port, tmp_path, "--av", "av", "--set", "live.wait_s=0") == 2
    assert "--overwrite deletes them, another folder for --out" in capsys.readouterr().err
    assert attach(port, tmp_path, "--av", "av", "--set", "live.wait_s=0", "--overwrite") == 3
    assert (tmp_path / "attacks.jsonl").read_text() == "earlier\n"


def test_a_connection_lost_before_the_first_step_is_one_line(port, tmp_path, capsys, monkeypatch):
    gone = type("FatalTraCIError", (Exception,), {})

    def lost(*_):
        raise gone("connection closed by SUMO")

    api = SimpleNamespace(close=lost)
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    monkeypatch.setattr(attacker, "sessions", lost)
    monkeypatch.setattr(attacker, "connect", lambda *_: api)
    assert attach(port, tmp_path / "live", "--av", "av") == 3
    assert "lost before the first step (connection closed by SUMO)" in capsys.readouterr().err


def test_who_waits_for_a_port_can_be_stopped(port):
    with pytest.raises(KeyboardInterrupt):
        connect(Port(number=port, wait_s=60.0), stopped=lambda: True)


def test_a_folder_with_other_files_is_left_alone(port, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    (tmp_path / "mine.txt").write_text("mine")
    assert attach(port, tmp_path, "--av", "av", "--set", "live.wait_s=0") == 2
    assert "holds other files" in capsys.readouterr().err
