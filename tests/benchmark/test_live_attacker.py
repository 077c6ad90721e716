"""``deepmf_sumo.Attacker`` around the steps of a script."""

import subprocess
import sys
from pathlib import Path

import pytest
import sumo

import deepmf_sumo
from deepmf_sumo.benchmark.live import assembly
from deepmf_sumo.errors import SpecError, UsageError

libsumo = pytest.importorskip("libsumo")
traci = pytest.importorskip("traci")

OPTIONS = ("--step-length", "0.1", "--no-step-log", "--no-warnings", "--collision.action", "none")


class Nobody:
    """Chooses nobody, and counts how often it was asked."""

    period_steps = 10

    def __init__(self):
        self.asked = 0

    def reset(self, view, rng):
        self.asked += 1


@pytest.fixture
def policy(monkeypatch):
    nobody = Nobody()
    monkeypatch.setattr(assembly, "policy_of", lambda spec: nobody)
    return nobody


@pytest.fixture
def started(tiny):
    """libsumo in this process."""
    libsumo.start(["sumo", "-c", str(tiny / "tiny.sumocfg"), *OPTIONS, "--remote-port", "0"])
    yield libsumo
    libsumo.close()


def drive(conn, attacker, steps):
    for _ in range(steps):
        attacker.before_step()
        conn.simulationStep()
        attacker.after_step()


def test_the_package_offers_it_without_importing_it():
    check = (
        "import sys, deepmf_sumo; assert 'numpy' not in sys.modules; deepmf_sumo.Attacker;"
        "assert 'torch' not in sys.modules and 'libsumo' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", check], check=True)
    with pytest.raises(AttributeError, match="no attribute 'Atacker'"):
        _ = deepmf_sumo.Atacker


def test_it_asks_the_policy_once_a_second_while_nobody_can(started, policy, tmp_path):
    with deepmf_sumo.Attacker(started, av="av", out=tmp_path / "live") as attacker:
        drive(started, attacker, 40)
    # after the first second and then every second
    assert policy.asked == 3
    assert attacker.attacks == []
    assert attacker.opponent is None
    assert (tmp_path / "live" / "session.json").is_file()
    assert started.poi.getIDCount() == 0


def test_deepmf_attacks_and_the_vehicle_is_sumos_again(started, tmp_path):
    with deepmf_sumo.Attacker(
        started, av="av", trigger="call", duration_s=3.0, out=tmp_path / "live"
    ) as attacker:
        drive(started, attacker, 12)
        assert attacker.opponent is None
        attacker.attack()
        drive(started, attacker, 35)
        drive(started, attacker, 15)
        (row,) = attacker.attacks
    assert (row["opponent"], row["plans"]) == ("leader", 3)
    assert row["events"][-1]["kind"] == "handed_back"
    route = started.vehicle.getRoute("leader")
    started.simulationStep()
    assert route == started.vehicle.getRoute("leader") == ("ab",)
    assert len((tmp_path / "live" / "attacks.jsonl").read_text().splitlines()) == 1


def test_a_traci_connection_will_do_and_an_error_of_the_script_is_the_scripts(tiny, policy):
    program = [
        str(Path(sumo.SUMO_HOME) / "bin" / "sumo"),
        "-c",
        str(tiny / "tiny.sumocfg"),
        *OPTIONS,
    ]
    traci.start(program, stdout=subprocess.DEVNULL)
    conn = traci.getConnection()

    def script():
        with deepmf_sumo.Attacker(conn, av="av") as attacker:
            drive(conn, attacker, 20)
            raise ZeroDivisionError

    try:
        with pytest.raises(ZeroDivisionError):
            script()
        assert policy.asked == 1
        assert conn.poi.getIDCount() == 0
    finally:
        traci.close()


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        ({"trigger": "soon"}, UsageError, "must be time=SECONDS"),
        ({"trigger": ["ttc=3", "edge=abb"]}, UsageError, "no such edge. Did you mean 'ab'?"),
        ({"duration_s": 1.0}, UsageError, "must be 3 s at least"),
        ({"sets": ["adversary.period_s=x"]}, SpecError, "period_s"),
        ({"net": "nowhere.net.xml"}, UsageError, "nowhere.net.xml"),
    ],
)
def test_wrong_settings(started, policy, wrong, error, said):
    with pytest.raises(error, match=said):
        deepmf_sumo.Attacker(started, av="av", **wrong)


def test_what_is_no_simulation():
    with pytest.raises(UsageError, match="A dict is no simulation; give the module libsumo"):
        deepmf_sumo.Attacker({}, av="av")
