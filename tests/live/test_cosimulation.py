"""An AV that another simulator moves, in steps of 0.05 s, attacked through SUMO's port.

This is what co-simulations do: one program drives the AV with its own dynamics and sets its pose in
SUMO (``moveToXY``), SUMO drives the traffic. ``DEEPMF_SUMO_OTHER`` may name more ``sumo`` programs,
of other versions, separated by colons.
"""

import csv
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sumo

from deepmf_sumo.cli import main
from deepmf_sumo.live import attacker
from deepmf_sumo.results import tracks

from tests.support.live_policies import Keep

pytestmark = pytest.mark.sumo

SUMO = Path(sumo.SUMO_HOME) / "bin" / "sumo"
PROGRAMS = [SUMO, *map(Path, filter(None, os.environ.get("DEEPMF_SUMO_OTHER", "").split(":")))]
STEPS = 180
SIMULATOR = """
import json, math, sys, time, traci
port, steps, file = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
for _ in range(200):
    try:
        api = traci.connect(port, numRetries=0)
        break
    except traci.exceptions.FatalTraCIError:
        time.sleep(0.05)
api.setOrder(1)
api.simulationStep()
x, y = api.vehicle.getPosition("av")
speed, poses = 8.0, []
for step in range(steps):
    x += 0.05 * speed
    side = 0.3 * math.sin(0.05 * step)  # a physical vehicle does not follow the middle
    api.vehicle.moveToXY("av", "", -1, x, y + side, angle=90.0, keepRoute=2)
    api.vehicle.setSpeed("av", speed)
    api.simulationStep()
    seen = api.vehicle.getPosition("av")
    poses.append([api.simulation.getTime(), x, y + side, *seen])
json.dump(poses, open(file, "w"))
api.close()
"""


@pytest.mark.parametrize("program", PROGRAMS, ids=str)
def test_an_av_of_another_simulator_is_attacked_and_never_moved(
    tiny, program, tmp_path, monkeypatch
):
    monkeypatch.chdir(tiny)
    monkeypatch.setattr(attacker, "policy_of", lambda spec: Keep())
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = str(probe.getsockname()[1])
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ["--step-length", "0.05", "--remote-port", port, "--num-clients", "2"]
    options += ["--collision.action", "none", "--no-step-log", "--no-warnings"]
    server = subprocess.Popen([program, "-c", "tiny.sumocfg", *options], **quiet)
    file = tmp_path / "poses.json"
    script = subprocess.Popen([sys.executable, "-c", SIMULATOR, port, str(STEPS), str(file)])
    out = tmp_path / "live"
    try:
        arguments = ["attach", "--port", port, "--av", "av", "--until", "8", "--out", str(out)]
        assert main.run([*arguments, "--duration", "3", "--set", "live.pause_s=0"]) == 0
        assert (script.wait(timeout=60), server.wait(timeout=60)) == (0, 0)
    finally:
        for process in (script, server):
            process.kill()
            process.wait()
    poses = np.array(json.loads(file.read_text()))
    assert len(poses) == STEPS
    assert np.abs(poses[:, 1:3] - poses[:, 3:5]).max() < 1e-6  # nothing else has moved it
    with (out / "runs.csv").open() as table:
        runs = list(csv.DictReader(table))
    assert len(runs) == 3
    assert {run["status"] for run in runs} == {"ok"}
    recorded = tracks.read_tracks(out / "runs" / "attack-001" / tracks.FILE)
    av = recorded.tracks.row(recorded.av_id)
    begin_s = float(runs[0]["scene"].removeprefix("av-").removesuffix("s"))
    times = begin_s + 0.1 * (np.arange(recorded.tracks.steps) - recorded.now)
    known = recorded.tracks.valid[av] & (times > poses[0, 0])
    expected = np.interp(times[known], poses[:, 0], poses[:, 2])
    assert recorded.tracks.position_m[av, known, 1] == pytest.approx(expected, abs=0.01)
