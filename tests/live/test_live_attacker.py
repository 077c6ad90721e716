"""``deepmf_sumo.Attacker`` around the steps of a script."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sumo

import deepmf_sumo
from deepmf_sumo.errors import OutputError, SpecError, UsageError
from deepmf_sumo.live import attacker as attacker_module
from deepmf_sumo.live import record
from deepmf_sumo.live.connection import shared
from deepmf_sumo.report import side_by_side
from deepmf_sumo.results import gate, risk
from deepmf_sumo.results.reader import Results

from tests.support.live_policies import Keep

pytestmark = pytest.mark.sumo

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
        return ()


@pytest.fixture
def policy(monkeypatch):
    nobody = Nobody()
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: nobody)
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


@pytest.fixture
def settings_of_the_script():
    """What a script may set for its own numbers."""
    torch = pytest.importorskip("torch")
    torch.set_default_dtype(torch.float64)
    with np.errstate(all="raise"):
        yield
        assert np.geterr()["under"] == "raise"
    assert torch.get_default_dtype() == torch.float64
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("settings_of_the_script")
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
    out = tmp_path / "live"
    assert len((out / "attacks.jsonl").read_text().splitlines()) == 1
    result = json.loads((out / "runs" / "attack-001" / "result.json").read_text())
    assert (result["planner"], result["network"], result["settings"]["planner"]) == (
        "script", "tiny", {},
    )  # fmt: skip
    assert result["metrics"]["min_gap"]["value"] == pytest.approx(row["min_gap_m"], abs=1e-3)
    assert result["metrics"]["red_light"]["value"] == 0.0  # there are no lights
    # an episode that another program steps cannot be repeated without the attack
    assert result["counterfactual"] == "lane"
    assert result["metrics"]["path_sspd"]["value"] is None
    (kept,) = Results.open(out).runs
    np.testing.assert_allclose(
        kept.unattacked().position_m[11:, 1], kept.rollout.tracks.position_m[1, 11:, 1], atol=0.1
    )
    (line,) = side_by_side.compare(side_by_side.groups([out])).to_dict("records")
    assert (line["planner"], line["runs"], line["version"]) == ("script", 1, "S1")
    (network,) = risk.read([out])
    (attacked,) = network.attacks
    assert (network.name, attacked.decided.edge, attacked.hit) == ("tiny", "ab", False)
    runs = gate.read(out).runs.set_index("run_id")
    assert runs.loc["attack-001", "judged"]


def test_attacks_share_one_copy_of_the_network_and_a_new_session_begins_anew(
    started, tmp_path, monkeypatch
):
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: Keep())

    started.simulationStep()
    for one in ("av", "leader"):
        started.vehicle.setMaxSpeed(one, 6.0)

    def session():
        with deepmf_sumo.Attacker(
            started, av="av", duration_s=3.0, pause_s=0.0, out=tmp_path / "live", overwrite=True
        ) as attacker:
            drive(started, attacker, 90)
        return len(attacker.attacks)

    attacks, runs = session(), tmp_path / "live" / "runs"
    assert len(list(runs.iterdir())) == attacks > 1
    nets = list(runs.glob("*/sumo/net.net.xml"))
    assert len({net.stat().st_ino for net in nets}) == 1
    again = session()
    assert len(list(runs.iterdir())) == again
    assert len(json.loads((tmp_path / "live" / "manifest.json").read_text())["runs"]) == again


def test_two_sessions_do_not_write_into_one_folder(started, policy, tmp_path):
    out = tmp_path / "live"
    with deepmf_sumo.Attacker(started, av="av", out=out):
        with pytest.raises(OutputError, match="is being written by process"):
            deepmf_sumo.Attacker(started, av="leader", out=out)
        assert json.loads((out / "session.json").read_text())["avs"] == ["av"]
    with deepmf_sumo.Attacker(started, av="leader", out=out):
        assert json.loads((out / "session.json").read_text())["avs"] == ["leader"]


def test_an_earlier_session_is_deleted_only_where_that_is_asked_for(started, policy, tmp_path):
    out = tmp_path / "live"
    (out / "runs" / "attack-001").mkdir(parents=True)
    about = {"tool": "deepmf-sumo", "runs": {"attack-001": "key"}}
    (out / "manifest.json").write_text(json.dumps(about))
    with pytest.raises(OutputError, match="results of an earlier command: overwrite=True"):
        deepmf_sumo.Attacker(started, av="av", out=out)
    assert (out / "runs" / "attack-001").is_dir()
    with deepmf_sumo.Attacker(started, av="av", out=out, overwrite=True):
        assert list((out / "runs").iterdir()) == []


def test_an_attack_that_cannot_be_measured_is_a_row(started, tmp_path, monkeypatch):
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: Keep())

    def broken(*_):
        raise ZeroDivisionError("of a metric")

    monkeypatch.setattr(record, "measured", broken)
    with deepmf_sumo.Attacker(started, av="av", duration_s=3.0, out=tmp_path / "live") as attacker:
        drive(started, attacker, 60)
    with (tmp_path / "live" / "runs.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == len(attacker.attacks) == 1
    assert (rows[0]["status"], rows[0]["planner"]) == ("failed", "script")
    assert rows[0]["error"] == "not measured: ZeroDivisionError: of a metric"


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


def test_the_exceptions_are_those_of_the_connection_though_libsumo_replaces_one(tiny):
    assert traci.exceptions.TraCIException is libsumo.TraCIException
    program = Path(sumo.SUMO_HOME) / "bin" / "sumo"
    traci.start([str(program), "-c", str(tiny / "tiny.sumocfg")], stdout=subprocess.DEVNULL)
    api = shared(traci.getConnection())
    with pytest.raises(api.TraCIException, match="not known"):
        api.vehicle.getSpeed("nobody")
    traci.close()
    with pytest.raises(api.FatalTraCIError):
        api.simulationStep()


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        ({"trigger": "soon"}, UsageError, "must be time=SECONDS"),
        ({"trigger": ["ttc=3", "edge=abb"]}, UsageError, "no such edge. Did you mean 'ab'?"),
        ({"duration_s": 1.0}, UsageError, "must be 3 s at least"),
        ({"duration_s": float("nan")}, UsageError, "duration is nan s"),
        ({"pause_s": -1.0}, UsageError, "pause is -1 s; it must be 0 s at least"),
        ({"sets": ["adversary.period_s=x"]}, SpecError, "period_s"),
        ({"sets": "adversary.period_s=x"}, SpecError, "period_s"),
        ({"net": "nowhere.net.xml"}, UsageError, "nowhere.net.xml"),
    ],
)
def test_wrong_settings(started, policy, wrong, error, said):
    with pytest.raises(error, match=said):
        deepmf_sumo.Attacker(started, av="av", **wrong)


def test_what_is_no_simulation():
    with pytest.raises(UsageError, match="A dict is not a simulation; give the module libsumo"):
        deepmf_sumo.Attacker({}, av="av")


def test_lights_are_kept_as_sumo_has_them(tmp_path):
    """Of each step of an attack beside lights; what SUMO says is asked apart."""
    config = Path(__file__).parents[2] / "sumo_nets/four_way/four_way.sumocfg"
    libsumo.start(["sumo", "-c", str(config), *OPTIONS, "--remote-port", "0"])
    try:
        for _ in range(300):
            libsumo.simulationStep()
        av = max(libsumo.vehicle.getIDList(), key=libsumo.vehicle.getSpeed)
        wish = {"trigger": "call", "duration_s": 6.0, "out": tmp_path / "live"}
        told = []
        with deepmf_sumo.Attacker(libsumo, av=av, **wish) as attacker:
            drive(libsumo, attacker, 12)
            attacker.attack()
            while not attacker.attacks and len(told) < 200:
                (light,) = libsumo.trafficlight.getIDList()
                state = libsumo.trafficlight.getRedYellowGreenState(light)
                told.append((round(libsumo.simulation.getTime(), 1), state))
                drive(libsumo, attacker, 1)
            (row,) = attacker.attacks
        links = libsumo.trafficlight.getControlledLinks(light)
    finally:
        libsumo.close()
    run = tmp_path / "live/runs/attack-001"
    (found,) = Results.open(tmp_path / "live").runs
    rollout = found.rollout
    assert len(rollout.signals) == rollout.tracks.steps - 1 - rollout.now
    assert (run / "signals.csv.gz").is_file()
    states, colour = dict(told), {"g": "GO", "G": "GO", "y": "CAUTION", "r": "STOP"}
    first = {via: number for number, ((_, _, via), *_) in reversed(list(enumerate(links)))}
    checked = 0
    for number, lights in enumerate(rollout.signals):
        state = states[round(row["begin_s"] + number * 0.1, 1)]
        for lane, seen in lights.items():
            assert seen.name == colour[state[first[lane]]], (number, lane)
            checked += 1
    assert checked > 100
