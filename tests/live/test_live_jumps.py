"""Time that does not go on from where it was: a script loads a state, or steps by itself."""

import json

import pytest

import deepmf_sumo
from deepmf_sumo.errors import UsageError
from deepmf_sumo.live import attacker as attacker_module

from tests.support.live_doubles import OPTIONS, Brake, session_on, step
from tests.support.live_policies import Keep
from tests.support.tiny_network import build

pytestmark = pytest.mark.sumo

libsumo = pytest.importorskip("libsumo")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tiny")).parent


@pytest.fixture
def api(folder, monkeypatch):
    monkeypatch.chdir(folder)
    # without chance: SUMO does not load the state of its random numbers
    calm = '<additional><vType id="DEFAULT_VEHTYPE" sigma="0" speedDev="0"/></additional>'
    (folder / "calm.add.xml").write_text(calm)
    more = ("--step-length", "0.1", "--additional-files", "calm.add.xml")
    libsumo.start(["sumo", "-c", "tiny.sumocfg", *OPTIONS, *more])
    yield libsumo
    libsumo.close()


def places(api):
    return {one: api.vehicle.getPosition(one) for one in sorted(api.vehicle.getIDList())}


def test_a_state_that_is_loaded_ends_the_attack_and_attacks_go_on(api, folder, tmp_path):
    """What comes after is what comes after it without us, up to the next attack."""
    session, fought = session_on(api, folder, Brake(), pause_s=100.0)
    jumps = []
    session.jumped = jumps.append
    step(api, session, 5)
    state = str(tmp_path / "state.xml")
    api.simulation.saveState(state)
    expected = []
    for _ in range(8):
        api.simulationStep()
        expected.append(places(api))
    api.simulation.loadState(state)
    step(api, session, 10)
    assert session.attacking == "leader"
    for _ in range(2):
        api.simulation.loadState(state)
        seen = []
        for _ in range(8):
            step(api, session, 1)
            seen.append(places(api))
        assert seen == expected
        assert (session.attacking, session.time_s) == (None, pytest.approx(1.3))
        step(api, session, 12)
        assert session.attacking == "leader"
    assert [(one.from_s, one.to_s) for one in jumps] == [
        (pytest.approx(1.5), 0.5),
        (pytest.approx(2.5), 0.5),
    ]
    assert (len(fought), session.undriven) == (0, 2)
    step(api, session, 30)
    assert [one.rollout.ended for one in fought] == ["plan_ended"]


def test_a_trigger_fires_again_where_its_time_comes_again(api, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(attacker_module, "policy_of", lambda spec: Keep())
    state = str(tmp_path / "state.xml")
    with deepmf_sumo.Attacker(
        libsumo, "av", trigger="time=2", duration_s=3.0, out=tmp_path / "live"
    ) as attacker:
        for _ in range(2):
            for count in range(60):
                attacker.before_step()
                api.simulationStep()
                attacker.after_step()
                if count == 0 and not attacker.attacks:
                    api.simulation.saveState(state)
            api.simulation.loadState(state)
    assert [one["begin_s"] for one in attacker.attacks] == [2.0, 2.0]
    session = json.loads((tmp_path / "live/session.json").read_text())
    assert session["jumps"] == [
        {"simulation": 1, "from_s": 6.0, "to_s": 0.1, "attacks": 1},
    ]


def test_a_state_of_a_later_time_may_be_loaded_but_steps_are_not_missed_twice(api, folder):
    session, _ = session_on(api, folder, Brake(opponent="nobody"))
    step(api, session, 3)
    api.simulationStep(5.0)
    step(api, session, 1)
    assert session.time_s == pytest.approx(5.1)
    api.simulationStep(8.0)
    with pytest.raises(UsageError, match="belong around every single step"):
        session.before_step()


@pytest.mark.parametrize("when", [0, 20])
def test_points_that_the_script_removes_come_back(api, folder, when):
    session, fought = session_on(api, folder, Brake(), pause_s=100.0)
    for count in range(60):
        step(api, session, 1)
        if count >= when:
            for point in api.poi.getIDList():
                api.poi.remove(point)
    assert [one.rollout.ended for one in fought] == ["plan_ended"]
    session.close()


def test_a_vehicle_of_a_state_saved_in_an_attack_is_sumos_again(folder, tmp_path, monkeypatch):
    """What an attack changes of a vehicle's type is in the state, too."""
    monkeypatch.chdir(folder)
    more = ("--step-length", "0.1", "--lanechange.duration", "2")
    libsumo.start(["sumo", "-c", "tiny.sumocfg", *OPTIONS, *more])
    session, _ = session_on(libsumo, folder, Brake(), pause_s=100.0)
    before = libsumo.vehicletype.getVehicleClass("DEFAULT_VEHTYPE")
    step(libsumo, session, 15)
    assert libsumo.vehicle.getVehicleClass("leader") != before
    state = str(tmp_path / "state.xml")
    libsumo.simulation.saveState(state)
    step(libsumo, session, 2)
    libsumo.simulation.loadState(state)
    step(libsumo, session, 1)
    assert libsumo.vehicle.getVehicleClass("leader") == before
    libsumo.close()
