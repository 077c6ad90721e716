"""AlpaSim's traffic service, asked by a client made of its public protocol."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from shapely import box
from shapely.affinity import rotate, translate

from deepmf_sumo.errors import UsageError
from deepmf_sumo.live.alpasim import AlpasimServer
from deepmf_sumo.live.alpasim_messages import CALLS, MESSAGES, SERVICE
from deepmf_sumo.results.reader import Results

from tests.support.alpasim_client import TICK_US, Client, generated, pose, way
from tests.support.live_doubles import Brake

grpc = pytest.importorskip("grpc", reason="not installed: pip install deepmf-sumo[alpasim]")
pytestmark = pytest.mark.sumo

CAR = (5.0, 1.8, 1.6)
BEGIN_US, HANDOVER_US, END_US = 7_000_000, 8_500_000, 16_000_000
LANE_Y = -4.8
STARTS = {"EGO": 20.0, "leader": 45.0, "other": 70.0}
"""Metres at the beginning; all drive 8 m/s, along x."""


def moving(x, y=LANE_Y, begin_us=BEGIN_US, end_us=END_US, every_us=TICK_US):
    times = np.arange(begin_us, end_us + 1, every_us)
    return way(times, [pose(x + 8e-6 * (time - BEGIN_US), y) for time in times])


def scene(**changes):
    """The objects of a session."""
    cars = {name: (moving(x), CAR, "automobile", False) for name, x in STARTS.items()}
    cars["EGO"] = (moving(20.0), CAR, "", False)
    parked = way([BEGIN_US], [pose(30.0, -8.0, np.pi / 2)])
    late = moving(150.0, begin_us=9_050_000, end_us=12_000_000, every_us=50_000)
    return {
        **cars,
        "parked": (parked, CAR, "automobile", True),
        "late": (late, CAR, "heavy_truck", False),
        **changes,
    }


@pytest.fixture
def served(tiny, tmp_path, monkeypatch):
    """A server on the tiny network, and clients of it."""
    policy = Brake()
    monkeypatch.setattr("deepmf_sumo.live.alpasim.policy_of", lambda spec: policy)
    clients = []
    with AlpasimServer(tiny, address="localhost:0", out=tmp_path / "live") as server:

        def client(uuid="session"):
            clients.append(Client(server.port, uuid))
            return clients[-1]

        client.server, client.policy = server, policy
        yield client
        for one in clients:
            one.leave()


def braked_m(seconds):
    """How far the leader gets after the handover: 8 m/s, and -3 m/s2 for two seconds."""
    speeds = np.maximum(8.0 - 0.3 * np.arange(1, 21), 0.0)
    return float(0.1 * speeds[: round(seconds * 10)].sum())


def ego_at(time_us):
    return pose(20.0 + 8e-6 * (time_us - BEGIN_US), LANE_Y)


def test_all_are_in_the_log_up_to_the_handover_then_the_opponent_on_its_plan(served):
    client = served()
    client.start("tiny", scene(), HANDOVER_US)
    for time_us in (BEGIN_US, 8_040_000, HANDOVER_US):
        found = client.simulate(time_us, ego_at(time_us))
        assert list(found) == ["leader", "other", "parked"]
        for name in ("leader", "other"):
            expected = (STARTS[name] + 8e-6 * (time_us - BEGIN_US), LANE_Y, 0.8, 0.0)
            assert found[name] == pytest.approx(expected, abs=1e-4)
        assert found["parked"] == pytest.approx((30.0, -8.0, 0.8, np.pi / 2), abs=1e-4)
    at_handover = 45.0 + 8.0 * 1.5
    for tick in range(1, 16):
        time_us = HANDOVER_US + tick * TICK_US
        found = client.simulate(time_us, ego_at(time_us))
        assert found["leader"][0] == pytest.approx(at_handover + braked_m(tick / 10), abs=1e-3)
        assert found["other"][0] == pytest.approx(70.0 + 8e-6 * (time_us - BEGIN_US), abs=1e-3)
    assert found["late"][0] == pytest.approx(150.0 + 8.0 * 3.0, abs=1e-3)
    assert list(found) == ["leader", "other", "parked", "late"]


def test_longer_ticks_give_the_same(served):
    short, long = served("short"), served("long")
    for client in (short, long):
        client.start("tiny", scene(), HANDOVER_US)
    for tick in range(1, 9):
        time_us = HANDOVER_US + tick * TICK_US
        last = short.simulate(time_us, ego_at(time_us))
        if tick % 4 == 0:
            assert long.simulate(time_us, ego_at(time_us)) == last


def test_the_ego_is_where_it_is_told_to_be(served, tmp_path):
    client = served()
    client.start("tiny", scene(), HANDOVER_US)
    touched_s = None
    for tick in range(1, 60):
        time_us = HANDOVER_US + tick * TICK_US
        x = 20.0 + 8.0 * 1.5 + 1.6 * tick  # 16 m/s
        found = client.simulate(time_us, pose(x, LANE_Y))
        if touched_s is None and found["leader"][0] - x < CAR[0]:
            touched_s = time_us / 1e6
    client.close()
    assert served.server.attacks[0]["opponent"] == "leader"
    (run,) = Results.open(tmp_path / "live").runs
    rollout = run.rollout
    assert not rollout.signals
    assert run.result["metrics"]["red_light"]["value"] is None, "nobody told what lights show"
    contact = rollout.first("av_opponent")
    begin_s = served.server.attacks[0]["begin_s"]
    assert begin_s + 0.1 * (contact.step - rollout.now) == pytest.approx(touched_s, abs=1e-6)
    row = rollout.tracks.row("EGO")
    told = [32.0 + 1.6 * tick for tick in range(1, rollout.tracks.steps - rollout.now)]
    np.testing.assert_allclose(
        rollout.tracks.position_m[row, rollout.now + 1 :, 0], told[: len(told)], atol=1e-4
    )
    assert rollout.tracks.speed_mps[row, -1] == pytest.approx(16.0, abs=1e-3)


def test_objects_that_are_static_do_not_attack(served):
    served.policy.opponent = "parked"
    client = served()
    client.start("tiny", scene(), HANDOVER_US)
    for tick in range(1, 30):
        time_us = HANDOVER_US + tick * TICK_US
        found = client.simulate(time_us, ego_at(time_us))
    client.close()
    assert found["parked"] == pytest.approx((30.0, -8.0, 0.8, np.pi / 2), abs=1e-4)
    assert served.server.attacks == []
    assert all("parked" not in view.history.ids for view in served.policy.views)


def test_sessions_of_one_service_have_a_result_folder_together(served, tmp_path):
    for uuid in ("one", "two"):
        client = served(uuid)
        client.start("tiny", scene(), HANDOVER_US)
        for tick in range(1, 12):
            client.simulate(HANDOVER_US + tick * TICK_US, ego_at(HANDOVER_US + tick * TICK_US))
        client.close()
    runs = Results.open(tmp_path / "live").runs
    assert [run.result["status"] for run in runs] == ["ok", "ok"]
    assert [run.result["planner"] for run in runs] == ["alpasim", "alpasim"]


def test_it_says_which_scenes_and_how_much_log_it_needs(served):
    client = served()
    empty = client.common.Empty()
    assert list(client.stub.get_available_scenes(empty).scene_ids) == ["tiny"]
    said = client.stub.get_metadata(empty)
    assert said.minimum_history_length_us == 1_000_000
    assert said.version_id.version_id.startswith("deepmf-sumo ")


@pytest.mark.parametrize(
    ("how", "status", "words"),
    [
        (lambda one: one.start("tiny/../tiny", scene(), HANDOVER_US), "NOT_FOUND", "tiny/../tiny"),
        (lambda one: one.start("tiny", {}, HANDOVER_US), "INVALID_ARGUMENT", "need 'EGO'"),
        (lambda one: one.start("tiny", scene(), END_US + 1), "INVALID_ARGUMENT", "handover_"),
        (
            lambda one: one.start("tiny", scene(a=(way([], []), CAR, "car", False)), HANDOVER_US),
            "INVALID_ARGUMENT", "'a' is empty",
        ),
        (
            lambda one: one.start(
                "tiny", scene(a=(moving(float("nan")), CAR, "car", False)), HANDOVER_US
            ),
            "INVALID_ARGUMENT", "'a' is empty, out of order, or has no valid poses",
        ),
        (
            lambda one: one.start(
                "tiny", scene(a=(moving(9), (0, 1, 1), "car", False)), HANDOVER_US
            ),
            "INVALID_ARGUMENT", "aabb",
        ),
        (
            lambda one: one.start(
                "tiny", scene(EGO=(moving(20, 500.0), CAR, "", False)), HANDOVER_US
            ),
            "FAILED_PRECONDITION", "the scene's local frame",
        ),
        (lambda one: one.simulate(HANDOVER_US, ego_at(HANDOVER_US)), "NOT_FOUND", "no session"),
        (lambda one: one.close(), "NOT_FOUND", "no session"),
    ],
)  # fmt: skip
def test_what_is_wrong_has_a_status_and_a_sentence(served, how, status, words):
    with pytest.raises(grpc.RpcError) as caught:
        how(served())
    assert (caught.value.code().name, words in caught.value.details()) == (status, True)


def test_times_that_no_step_leads_to_are_refused(served):
    client = served()
    client.start("tiny", scene(), HANDOVER_US)
    client.simulate(HANDOVER_US + TICK_US, ego_at(HANDOVER_US + TICK_US))
    for time_us, words in ((HANDOVER_US + 150_000, "multiple"), (HANDOVER_US, "past")):
        with pytest.raises(grpc.RpcError, match=words):
            client.simulate(time_us, ego_at(time_us))
    with pytest.raises(grpc.RpcError, match="open already"):
        client.start("tiny", scene(), HANDOVER_US)
    # without the ego there is no next step
    request = client.traffic.TrafficRequest(
        session_uuid="session", time_query_us=HANDOVER_US + 3 * TICK_US
    )
    with pytest.raises(grpc.RpcError, match="no pose of 'EGO'"):
        client.stub.simulate(request)


def test_messages_and_calls_are_those_of_the_public_protocol():
    common, traffic, _ = generated()
    public = {**common.DESCRIPTOR.message_types_by_name, **traffic.DESCRIPTOR.message_types_by_name}
    public["APIVersion"] = public["VersionId"].nested_types_by_name["APIVersion"]
    same = {"SessionRequestStatus": "Empty"}  # both have no fields
    for name, message in MESSAGES.items():
        own, theirs = message.DESCRIPTOR.fields, public[name].fields
        assert [described(field) for field in own] == [described(field) for field in theirs]
    (service,) = traffic.DESCRIPTOR.services_by_name.values()
    assert service.full_name == SERVICE
    assert {
        call.name: tuple(
            same.get(one.name, one.name) for one in (call.input_type, call.output_type)
        )
        for call in service.methods
    } == CALLS


def described(field):
    kind = field.message_type.name if field.message_type else field.type
    return field.name, field.number, kind, field.is_repeated


def test_without_networks_or_grpc_it_says_what_to_do(tmp_path, tiny, monkeypatch):
    with pytest.raises(UsageError, match=r"There is no SCENE_ID\.net\.xml in"):
        AlpasimServer(tmp_path)
    monkeypatch.setitem(sys.modules, "grpc", None)
    with pytest.raises(UsageError, match=r"install deepmf-sumo\[alpasim\]"):
        AlpasimServer(tiny)


@pytest.mark.slow
def test_deepmf_attacks_in_the_log_of_a_simulation(tmp_path):
    """The log is that of SUMO: the situation ``cut_in`` without an attack."""
    libsumo = importlib.import_module("libsumo")
    nets = Path(__file__).parents[2] / "sumo_nets" / "arterial"
    step_s = ["--step-length", "0.1", "--no-warnings", "--no-step-log"]
    libsumo.start(["sumo", "-c", str(nets / "cut_in.sumocfg"), *step_s])
    seen, sizes = {}, {}
    for _ in range(220):
        libsumo.simulationStep()
        time_us = round(libsumo.simulation.getTime() * 10) * TICK_US
        for name in libsumo.vehicle.getIDList():
            (x, y), angle = libsumo.vehicle.getPosition(name), libsumo.vehicle.getAngle(name)
            heading, length = np.radians(90.0 - angle), libsumo.vehicle.getLength(name)
            at = pose(x - length / 2 * np.cos(heading), y - length / 2 * np.sin(heading), heading)
            seen.setdefault(name, []).append((time_us, at))
            sizes[name] = (length, libsumo.vehicle.getWidth(name), 1.6)
    libsumo.close()
    objects = {
        "EGO" if name == "av" else name: (way(*zip(*one, strict=True)), sizes[name], "car", False)
        for name, one in seen.items()
    }
    (tmp_path / "nets").mkdir()
    (tmp_path / "nets" / "scene.net.xml").write_bytes((nets / "arterial.net.xml").read_bytes())
    ego = dict(seen["av"])
    begin_us = min(ego)
    handover_us = begin_us + 10 * TICK_US
    with AlpasimServer(
        tmp_path / "nets", address="localhost:0", out=tmp_path / "live", sets=["profile=any"]
    ) as server:
        client = Client(server.port)
        client.start("scene", objects, handover_us)
        touching = []
        for time_us in sorted(one for one in ego if one > handover_us):
            found = client.simulate(time_us, ego[time_us])
            at = ego[time_us]
            turn = 2 * np.arctan2(at.quat.z, at.quat.w)
            own = boxed((at.vec.x, at.vec.y, 0.0, turn), sizes["av"])
            near = [one for one in found if own.intersects(boxed(found[one], sizes[one]))]
            touching += [(time_us / 1e6, one) for one in near]
        client.close()
        client.leave()
        (row,) = server.attacks
    (run,) = Results.open(tmp_path / "live").runs
    contact = run.rollout.first("av_opponent")
    assert contact is not None
    assert touching[0][1] == row["opponent"]
    hit_s = row["begin_s"] + 0.1 * (contact.step - run.rollout.now)
    assert touching[0][0] == pytest.approx(hit_s, abs=1e-6)


def boxed(at, size_m):
    """The box of an object, by shapely."""
    length, width, _ = size_m
    own = box(-length / 2, -width / 2, length / 2, width / 2)
    return translate(rotate(own, at[3], origin=(0, 0), use_radians=True), at[0], at[1])
