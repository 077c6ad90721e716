"""What becomes of opponents in somebody else's simulation when their attack is over."""

import libsumo
import numpy as np
import pytest

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


def motion(sumo, session, steps):
    """(steps, 3) x, y, speed of the leader after each step of the script."""
    rows = []
    for _ in range(steps):
        step(sumo, session, 1)
        x, y = sumo.vehicle.getPosition("leader")
        rows.append((x, y, sumo.vehicle.getSpeed("leader")))
    return np.array(rows)


@pytest.mark.parametrize("sideways", [1.0, -3.0, -9.0], ids=["beside", "off", "far off"])
def test_who_is_not_on_the_middle_of_a_lane_drives_there_in_the_users_simulation(
    folder, sumo, sideways
):
    session, fought = session_on(sumo, folder, Brake(sideways=sideways), pause_s=100.0)
    rows = motion(sumo, session, 100)
    assert abs(sumo.vehicle.getLateralLanePosition("leader")) <= 0.1
    assert sumo.vehicle.getLaneID("leader")
    assert sumo.vehicle.getSpeed("leader") > 7.0  # SUMO has driven on
    moved = np.hypot(*np.diff(rows[:, :2], axis=0).T)
    assert moved.max() < 0.1 * rows[:, 2].max() + 0.2
    assert np.abs(np.diff(rows[31:, 1])).max() < 0.4  # the front, as it turns
    assert handed_back(fought) == []  # it was still on its way when the attack was told of
    assert session.driving == set()


def test_a_vehicle_on_the_middle_of_its_lane_is_sumos_in_the_next_step(folder, sumo):
    session, fought = session_on(sumo, folder, Brake(), pause_s=100.0)
    step(sumo, session, 35)
    assert handed_back(fought) == ["SUMO drives on along the route"]


def test_a_session_that_ends_leaves_no_vehicle_where_sumo_cannot_drive_it(folder, sumo):
    session, _ = session_on(sumo, folder, Brake(sideways=-9.0), pause_s=100.0)
    step(sumo, session, 33)
    assert session.driving == {"leader"}
    session.close()
    assert session.driving == set()
    sumo.simulationStep()
    assert sumo.vehicle.getLaneID("leader")


def test_a_vehicle_on_its_way_back_attacks_nobody(folder, sumo):
    policy = Brake(sideways=-9.0)
    session, fought = session_on(sumo, folder, policy, pause_s=0.0)
    step(sumo, session, 40)
    assert session.driving == {"leader"}
    assert len(fought) == 1
    assert all("leader" not in view.history.ids for view in policy.views[1:])


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
