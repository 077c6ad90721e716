"""What becomes of opponents in somebody else's simulation when their attack is over."""

import libsumo
import pytest

from deepmf_sumo.simulation.free_positions import FreePositions

from tests.support.live_doubles import OPTIONS, Brake, session_on, step
from tests.support.tiny_network import build

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tiny")).parent


@pytest.fixture
def sumo(folder):
    libsumo.start(["sumo", "-c", str(folder / "tiny.sumocfg"), *OPTIONS, "--step-length", "0.1"])
    yield libsumo
    libsumo.close()


def handed_back(fought):
    (one,) = fought
    return [event.detail for event in one.rollout.events if event.kind == "handed_back"]


@pytest.mark.parametrize("sideways", [1.0, -3.0], ids=["beside the middle", "off the road"])
def test_who_is_not_on_the_middle_of_a_lane_is_put_there(folder, sumo, sideways):
    session, fought = session_on(sumo, folder, Brake(sideways=sideways), pause_s=100.0)
    step(sumo, session, 34)
    assert sumo.vehicle.getLateralLanePosition("leader") == 0.0
    assert sumo.vehicle.getSpeed("leader") == pytest.approx(4.3, abs=0.6)  # 4.0 at the end
    (detail,) = handed_back(fought)
    assert detail.startswith("put on lane ab_")


def test_a_vehicle_stays_in_the_simulation_where_no_place_is_free(folder, sumo, monkeypatch):
    monkeypatch.setattr(FreePositions, "nearest", lambda *_, **__: None)
    session, fought = session_on(sumo, folder, Brake(sideways=-3.0), pause_s=100.0)
    step(sumo, session, 35)
    assert sumo.vehicle.getLaneID("leader") == "ab_0"
    assert handed_back(fought) == ["put on the nearest lane, where SUMO drives on"]


def test_an_attack_is_told_of_even_if_the_connection_is_lost_in_it(folder, sumo, monkeypatch):
    session, fought = session_on(sumo, folder, Brake())
    step(sumo, session, 20)
    assert session.attacking == "leader"

    def lost():
        raise libsumo.FatalTraCIError("connection closed by SUMO")

    with monkeypatch.context() as patch:
        patch.setattr(libsumo.vehicle, "getIDList", lost)
        with pytest.raises(libsumo.FatalTraCIError):
            session.close()
    assert [one.rollout.ended for one in fought] == ["time"]
    assert fought[0].rollout.tracks.valid.shape[1] == 20


def test_the_occupancy_reaches_farther_than_the_av_sees(folder, sumo):
    sumo.simulationStep()
    sumo.route.add("again", ["ab"])
    sumo.vehicle.add("far", "again", departPos="150", departSpeed="0")
    session, _ = session_on(sumo, folder, Brake(sideways=1.0))
    step(sumo, session, 15)
    attack = session._attack
    assert "far" not in attack._record.frame.ids
    around = attack._around("leader")
    assert set(around.frame.ids) == {"far", "av", "leader"}
    assert around.size_m.shape == (3, 2)
    assert sumo.poi.getIDCount() == 1
