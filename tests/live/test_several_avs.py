"""Several AVs in one simulation: each has its opponent, and none is one."""

import json
import re
import subprocess
import sys

import pytest

import deepmf_sumo
from deepmf_sumo.errors import UsageError
from deepmf_sumo.live import attacker as attacker_module
from deepmf_sumo.live.connection import shared
from deepmf_sumo.live.lockstep import Lockstep, Stay
from deepmf_sumo.scene import Plan

from tests.support.forked_workers import Command

pytestmark = pytest.mark.sumo

libsumo = pytest.importorskip("libsumo")

OPTIONS = ("--step-length", "0.1", "--no-step-log", "--no-warnings", "--collision.action", "none")
CLIENT = """
import sys, traci
api = traci.connect(int(sys.argv[1]), numRetries=50, waitBetweenRetries=0.1)
while api.simulation.getTime() < 8.0:
    api.simulationStep()
api.close()
"""


class Nearest:
    """The vehicle nearest to the AV goes on as it does."""

    period_steps = 10

    def __init__(self):
        self.opponent = None

    def reset(self, view, rng):
        history = view.history
        distance = {
            one: abs(history.position_m[row, -1, 0] - history.position_m[0, -1, 0])
            for row, one in enumerate(history.ids)
            if one != view.av_id
        }
        if not distance:
            return ()
        self.opponent = min(distance, key=distance.get)
        return (self.opponent,)

    def plan(self, view):
        row = view.history.row(self.opponent)
        x, y = view.history.position_m[row, -1]
        speed = float(view.history.speed_mps[row, -1])
        return {
            self.opponent: Plan(
                agent_id=self.opponent,
                first_step=view.step + 1,
                position_m=[(x + 0.1 * speed * step, y) for step in range(1, 81)],
                heading_rad=[0.0] * 80,
                speed_mps=[speed] * 80,
            )
        }


@pytest.fixture
def traffic(tiny, tmp_path):
    """Two AVs behind each other, and a number of others ahead of them."""

    def write(others):
        ids = ["rear", "front", *(f"other{row}" for row in range(others))]
        rows = [
            f'<vehicle id="{one}" depart="0" departPos="{20 + 25 * row}" departLane="0"'
            ' departSpeed="8"><route edges="ab"/></vehicle>'
            for row, one in enumerate(ids)
        ]
        (tmp_path / "two.rou.xml").write_text(f"<routes>{''.join(rows)}</routes>")
        config = tmp_path / "two.sumocfg"
        config.write_text(
            f'<configuration><input><net-file value="{tiny / "tiny.net.xml"}"/>'
            '<route-files value="two.rou.xml"/></input></configuration>'
        )
        return config

    return write


@pytest.fixture
def attacked(traffic, monkeypatch):
    """The opponents of each AV, step by step, and the attacks."""
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: Nearest())

    def run(others, steps=60):
        libsumo.start(["sumo", "-c", str(traffic(others)), *OPTIONS])
        seen = []
        try:
            with deepmf_sumo.Attacker(
                libsumo, ["rear", "front"], duration_s=3.0, pause_s=1.0
            ) as attacker:
                for _ in range(steps):
                    attacker.before_step()
                    libsumo.simulationStep()
                    attacker.after_step()
                    seen.append(attacker.opponents)
        finally:
            libsumo.close()
        return seen, attacker.attacks

    return run


def test_each_has_an_opponent_of_its_own_and_none_is_one(attacked):
    seen, attacks = attacked(others=2)
    assert {"front": "other1", "rear": "other0"} in seen or {
        "front": "other0",
        "rear": "other1",
    } in seen
    assert all(len({*one.values()}) == len(one) for one in seen)
    assert not {"rear", "front"} & {row["opponent"] for row in attacks}
    assert {row["av"] for row in attacks} == {"rear", "front"}
    assert [row["number"] for row in attacks] == [*range(1, len(attacks) + 1)]


def test_with_one_other_vehicle_one_of_them_is_attacked(attacked):
    seen, attacks = attacked(others=1)
    assert max(map(len, seen)) == 1
    assert {row["opponent"] for row in attacks} == {"other0"}


def test_with_none_nobody_attacks(attacked):
    assert attacked(others=0) == ([{}] * 60, [])


def test_no_more_attacks_begin_than_are_asked_for(traffic, monkeypatch):
    """Also while another is under way, and without a pause."""
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: Nearest())
    libsumo.start(["sumo", "-c", str(traffic(2)), *OPTIONS])
    wish = attacker_module.AttackRequest(avs=("rear", "front"), duration_s=3.0, pause_s=0.0)
    done = []
    api = shared(libsumo)
    own = attacker_module.sessions(api, wish, attacker_module.spec_of(wish), done.append)
    assert Lockstep(api, own, Stay(attacks=3), lambda: False).run() == "attacks"
    assert len(done) == 3
    assert all(one.end_s > one.begin_s for one in done)


def test_an_av_that_is_named_twice_is_refused():
    with pytest.raises(UsageError, match="AV 'a' is named 2 times"):
        attacker_module.triggers_of(attacker_module.AttackRequest(avs=("a", "b", "a")))


def test_serve_attacks_both(traffic, tmp_path):
    """With the networks of the package."""
    process = Command(
        "serve", traffic(2), "--port", "0", "--av", "rear", "--av", "front", "--duration", "3",
        "--out", tmp_path / "live", "--", *OPTIONS,
    )  # fmt: skip
    port = re.search(r"port (\d+)", process.stderr.readline())[1]
    subprocess.run([sys.executable, "-c", CLIENT, port], check=True, timeout=120)
    shown, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    rows = [
        json.loads(one)
        for one in (tmp_path / "live" / "attacks.jsonl").read_text().split("\n")
        if one
    ]
    assert {row["av"] for row in rows} == {"rear", "front"}
    assert all(f"{row['av']}" in shown for row in rows)
    session = json.loads((tmp_path / "live" / "session.json").read_text())
    assert session["avs"] == ["rear", "front"]
