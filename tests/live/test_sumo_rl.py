"""sumo-rl as packaged, which starts `serve` in place of SUMO and steps by seconds."""

import json
import shlex
import sys
from pathlib import Path

import pytest
import sumo

pytestmark = [pytest.mark.slow, pytest.mark.sumo]

EPISODES, SECONDS = 2, 40


def test_it_trains_against_attacks(tmp_path, monkeypatch):
    monkeypatch.setenv("SUMO_HOME", sumo.SUMO_HOME)
    sumo_rl = pytest.importorskip("sumo_rl", reason="not installed: pip install sumo-rl")
    program = tmp_path / "sumo-attacked"
    serve = "from deepmf_sumo.cli.main import main; main()"
    command = [sys.executable, "-c", serve, "serve", "--av", "flow_ns.0", "--av", "flow_we.0"]
    program.write_text(
        f"#!/bin/sh\nexec {shlex.join(command)} --out '{tmp_path}/out/'$$ -- \"$@\"\n"
    )
    program.chmod(0o755)
    (tmp_path / "out").mkdir()
    monkeypatch.setenv("SUMO_BINARY", str(program))
    nets = Path(sumo_rl.__file__).parent / "nets" / "2way-single-intersection"
    env = sumo_rl.SumoEnvironment(
        net_file=str(nets / "single-intersection.net.xml"),
        route_file=str(nets / "single-intersection-vhvh.rou.xml"),
        single_agent=True,
        num_seconds=SECONDS,
    )
    for _ in range(EPISODES):
        env.reset()
        steps, over = 0, False
        while not over:
            *_, terminated, truncated, info = env.step(steps % env.action_space.n)
            steps, over = steps + 1, terminated or truncated
        assert (steps, info["step"]) == (SECONDS / 5, SECONDS)
    env.close()
    sessions = [json.loads(one.read_text()) for one in tmp_path.glob("out/*/session.json")]
    assert sorted(one["attacks"] > 0 for one in sessions) == [False] + [True] * EPISODES
    assert {one["client_step_s"] for one in sessions} == {1.0}
