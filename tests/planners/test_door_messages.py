"""What is said to planners outside the simulation: nothing lost, nothing of the future."""

import codecs
import json
import math

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote import client, serve
from deepmf_sumo.planners.remote.protocol import PROTOCOL, Reset, ViewMessage, schema
from deepmf_sumo.scene import (
    Command,
    RecordedCase,
    SignalState,
    SumoNet,
    TrafficCase,
    VehicleModel,
    View,
)

from tests.support import simulated_worlds as worlds


@pytest.fixture(scope="module")
def scene():
    motions = {
        "av": worlds.straight_motion(0.1, 1 / 3, math.pi / 7, 9.87654321),
        "walker": worlds.straight_motion(20.0, 5.0, 1.0, 1.2),
    }
    return worlds.scene_of(worlds.crossing_road(), motions, kinds={"walker": "pedestrian"})


@pytest.fixture(scope="module")
def case(scene, tmp_path_factory):
    net = SumoNet(file=tmp_path_factory.mktemp("net") / "none.net.xml")
    return RecordedCase(
        name="a case", road=scene.road, av_id="av", duration_steps=80, traffic="log", seed=7,
        scene=scene, net=net,
    )  # fmt: skip


@pytest.fixture(scope="module")
def view(scene):
    return View(
        step=10,
        dt_s=0.1,
        av_id="av",
        history=scene.tracks.window(0, 11),
        road=scene.road,
        signals={"west": SignalState.STOP},
        steps_left=80,
        av_path_m=np.array([[1 / 3, 2 / 3], [5.0, 1e-9]]),
    )


def test_a_view_arrives_bit_for_bit(view):
    told = serve.read(client.view_message("e", view, 11))
    assert isinstance(told, ViewMessage)
    heard = serve.view_of(told, view.road)
    for name in ("position_m", "z_m", "heading_rad", "velocity_mps", "size_m", "valid"):
        sent, came = getattr(view.history, name), getattr(heard.history, name)
        assert sent.tobytes() == came.tobytes(), name
    assert (heard.history.ids, heard.history.kinds) == (view.history.ids, view.history.kinds)
    assert heard.av_path_m.tobytes() == view.av_path_m.tobytes()
    assert heard.signals == view.signals
    assert (heard.step, heard.dt_s, heard.av_id, heard.steps_left) == (10, 0.1, "av", 80)


def test_a_shorter_history_ends_with_now(view):
    heard = serve.view_of(serve.read(client.view_message("e", view, 2)), view.road)
    assert heard.history.steps == 2
    assert (heard.history.position_m == view.history.position_m[:, -2:]).all()


def test_the_road_arrives_and_the_recording_does_not(case):
    line = client.reset_message(case, road=True)
    told = serve.read(line)
    assert isinstance(told, Reset)
    assert (told.case, told.seed, told.steps, told.own_lane) == ("a case", 7, 80, False)
    heard = serve.case_of(told)
    assert list(heard.road.lanes) == list(case.road.lanes)
    for name, lane in case.road.lanes.items():
        there = heard.road.lanes[name]
        assert there.centre_m.tobytes() == lane.centre_m.tobytes()
        assert (there.next, there.previous) == (lane.next, lane.previous)
        assert (there.kind, there.speed_limit_mps) == (lane.kind, lane.speed_limit_mps)
    assert heard.road.stop_signs[0].lane_ids == ("south",)
    assert isinstance(heard, TrafficCase)
    assert b"walker" not in line
    assert serve.read(client.reset_message(case, road=False)).road is None


def test_a_lane_of_its_own_is_told(case):
    from dataclasses import replace

    alone = replace(case, net=replace(case.net, ghost_edge="ghost"))
    heard = serve.case_of(serve.read(client.reset_message(alone, road=False)))
    assert isinstance(heard, RecordedCase)
    assert heard.net.ghost_edge is not None
    assert heard.scene.tracks.ids == ("av",)


@pytest.mark.parametrize(
    "command",
    [
        Command(kind="sumo"),
        Command(kind="speed", speed_mps=1 / 3),
        Command(kind="leader", gap_m=-0.1, leader_mps=-2.5, leader_id="walker"),
        Command(kind="pose", x_m=1 / 7, y_m=-2.0, heading_rad=3.1, speed_mps=-0.5),
    ],
)
def test_a_command_comes_back_as_it_was(command):
    text = json.dumps(serve.command_answer(command, 12)).encode()
    assert client.read_command("it", text, 12) == command


def test_a_byte_order_mark_before_an_answer_is_skipped():
    text = codecs.BOM_UTF8 + b'{"type": "command", "step": 12, "kind": "sumo"}'
    assert client.read_command("it", text, 12) == Command(kind="sumo")
    ready = codecs.BOM_UTF8 + b'{"type": "ready", "protocol": 1}'
    assert client.read_ready("it", ready) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'{"type": "command", "step": 3}', "it answered kind None at step 3; known: sumo, speed"),
        (b'{"step": 3, "kind": "sumo"}', "it at step 3 answered wrongly: 'type' is"),
        (b"\xff", "which is not JSON"),
        (
            b'{"type": "command", "step": 3, "kind": "speed", "speed_mps": 1e999}',
            "'speed_mps' is inf",
        ),
        (b"null", "it answered None, which is not a JSON object"),
    ],
)
def test_an_answer_that_is_not_a_command_is_refused(text, message):
    with pytest.raises(PlannerError) as found:
        client.read_command("it", text, 3)
    assert message in str(found.value)


def test_a_vehicle_model_comes_back_as_it_was():
    model = VehicleModel(
        accel_mps2=1.5, decel_mps2=2, emergency_mps2=8, headway_s=1.5, gap_m=2, exponent=4
    )
    for told in (model, None):
        text = json.dumps(serve.ready_answer(told)).encode()
        assert client.read_ready("it", text) == told


def test_a_model_that_sumo_would_refuse_is_refused():
    model = dict.fromkeys(VehicleModel.__dataclass_fields__, 1.0) | {"accel_mps2": -1.0}
    text = json.dumps({"type": "ready", "protocol": 1, "model": model}).encode()
    with pytest.raises(PlannerError, match=r"'model.accel_mps2' is -1.0"):
        client.read_ready("it", text)


def test_a_question_of_another_kind_is_refused():
    with pytest.raises(PlannerError, match=f"not a message of protocol {PROTOCOL}"):
        serve.read(b'{"type": "dance"}')


def test_the_schema_is_printed_and_names_every_message(capsys):
    assert main.run(["schema", "--planner"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(json.dumps(schema()))
    names = {"Reset", "Ready", "ViewMessage", "SumoAnswer", "SpeedAnswer", "LeaderAnswer"}
    assert names | {"PoseAnswer"} <= set(printed["$defs"])
