"""The same made-up recording in every format is the same scene, as far as the format holds it."""

import copy
import json
import pickle

import numpy as np
import pytest

from deepmf_sumo.scene.readers import Refusal, gpudrive, read_by, scenarionet, womd

from tests.support import recordings_by_hand as by_hand


@pytest.fixture
def original(tmp_path):
    (scene,) = read_by(womd, by_hand.shard(tmp_path / "one.tfrecord", by_hand.scenario()))
    return scene


@pytest.fixture
def described():
    return by_hand.scenarionet(by_hand.scenario())


@pytest.fixture
def drive():
    return by_hand.gpudrive(by_hand.scenario())


@pytest.fixture
def unpickled(tmp_path):
    def read(description):
        file = tmp_path / "scene.pkl"
        file.write_bytes(pickle.dumps(description))
        assert any(scenarionet.recordings(file))
        (found,) = read_by(scenarionet, file)
        return found

    return read


@pytest.fixture
def parsed(tmp_path):
    def read(content):
        file = tmp_path / "scene.json"
        file.write_text(json.dumps(content))
        assert any(gpudrive.recordings(file))
        (found,) = read_by(gpudrive, file)
        return found

    return read


def assert_same_motion(scene, original, *, flat=False):
    assert scene.tracks.kinds == original.tracks.kinds
    assert np.array_equal(scene.tracks.valid, original.tracks.valid)
    for name in ("position_m", "heading_rad", "velocity_mps"):
        assert getattr(scene.tracks, name) == pytest.approx(
            getattr(original.tracks, name), abs=1e-4
        )
    axes = 2 if flat else 3
    assert scene.tracks.size_m[:, :axes] == pytest.approx(original.tracks.size_m[:, :axes])


def assert_same_lanes(scene, original):
    assert list(scene.road.lanes) == list(original.road.lanes)
    for lane in scene.road.lanes.values():
        twin = original.road.lanes[lane.id]
        assert lane.centre_m == pytest.approx(twin.centre_m)
        assert (lane.kind, lane.next, lane.previous) == (twin.kind, twin.next, twin.previous)
        assert [one.lane_id for one in lane.left] == [one.lane_id for one in twin.left]
        assert [one.lane_id for one in lane.right] == [one.lane_id for one in twin.right]


def assert_same_signals(scene, original):
    assert scene.signals.lane_ids == original.signals.lane_ids
    assert np.array_equal(scene.signals.seen, original.signals.seen)
    assert np.array_equal(scene.signals.state, original.signals.state)
    assert np.array_equal(scene.signals.stop_m, original.signals.stop_m)


def test_scenarionet_is_the_same_scene(original, described, unpickled):
    scene = unpickled(described)
    assert_same_motion(scene, original)
    assert_same_lanes(scene, original)
    assert_same_signals(scene, original)
    assert scene.tracks.ids == original.tracks.ids
    assert scene.road.lanes["100"].left_boundaries == original.road.lanes["100"].left_boundaries
    assert scene.road.lanes["100"].left == original.road.lanes["100"].left
    assert scene.road.lanes["100"].speed_limit_mps == original.road.lanes["100"].speed_limit_mps
    assert [one.kind for one in scene.road.lines] == [1]
    assert [one.kind for one in scene.road.edges] == [2]
    assert scene.road.stop_signs[0].lane_ids == ("102",)
    assert (scene.name, scene.av_id, scene.now) == (original.name, original.av_id, original.now)
    assert (scene.interest, scene.to_predict) == (original.interest, original.to_predict)
    assert scene.repairs == ()


def test_scenarionet_sizes_in_one_array_or_as_columns(original, described, unpickled):
    for track in described["tracks"].values():
        state = track["state"]
        parts = [state.pop(name) for name in ("length", "width", "height")]
        state["size"] = np.column_stack(parts)
    assert_same_motion(unpickled(described), original)
    for track in described["tracks"].values():
        size = track["state"].pop("size").astype("float64")
        for axis, name in enumerate(("length", "width", "height")):
            track["state"][name] = size[:, axis : axis + 1]
    assert_same_motion(unpickled(described), original)


def test_scenarionet_early_signals_are_numbers_over_time(original, described, unpickled):
    light = described["dynamic_map_states"]["102"]
    numbers = np.array(
        [
            {"LANE_STATE_STOP": 4, "LANE_STATE_GO": 6, None: 0}[one]
            for one in light["state"]["object_state"]
        ]
    )
    there = numbers[:, None] > 0
    light["state"] = {
        "object_state": numbers,
        "lane": np.where(there[:, 0], 102, 0),
        "stop_point": np.where(there, light.pop("stop_point"), 0.0),
    }
    assert_same_signals(unpickled(described), original)


def test_scenarionet_0_3_writes_missing_signals_as_unknown(original, described, unpickled):
    states = described["dynamic_map_states"]["102"]["state"]
    states["object_state"] = [one or "LANE_STATE_UNKNOWN" for one in states["object_state"]]
    assert unpickled(described).signals.seen.all()
    described["version"] = "MetaDrive v0.3.0.1"
    assert_same_signals(unpickled(described), original)


def test_scenarionet_early_crosswalks_and_unknown_types(original, described, unpickled):
    features = described["map_features"]
    features["202"] = {"type": "CROSS_WALK", "polyline": features["202"]["polygon"]}
    features["100"]["type"] = "UNKNOWN"
    features["200"]["type"] = "UNKNOWN"
    features["300"] = {"type": "FOUNTAIN"}
    scene = unpickled(described)
    assert scene.road.polygons[0].kind == "crosswalk"
    assert np.array_equal(scene.road.polygons[0].points_m, original.road.polygons[0].points_m)
    assert scene.road.lanes["100"].kind == "unknown"
    assert [(one.id, one.kind) for one in scene.road.lines] == [("200", 0)]
    assert scene.repairs == ("Map features of unknown kinds were dropped: FOUNTAIN.",)


def test_scenarionet_without_labels_and_names(described, unpickled):
    for key in ("objects_of_interest", "tracks_to_predict", "sdc_id"):
        del described["metadata"][key]
    scene = unpickled(described)
    assert (scene.interest, scene.to_predict, scene.av_id) == ((), (), "12")


def test_scenarionet_of_20_s(unpickled):
    scene = unpickled(by_hand.scenarionet(by_hand.scenario(steps=198, now=0)))
    assert (scene.tracks.steps, scene.now, scene.signals.state.shape) == (198, 10, (1, 198))


class Harm:
    def __reduce__(self):
        return (print, ("harm",))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda d: d.update(extra=Harm()), "names 'builtins.print'"),
        (lambda d: d.pop("tracks"), "no 'tracks'"),
        (lambda d: d.update(tracks={}), "no tracks"),
        (
            lambda d: d["metadata"].pop("sdc_id") and d["metadata"].pop("sdc_track_index"),
            "sdc_track",
        ),
        (lambda d: d["tracks"]["7"]["state"].pop("heading"), "lacks the key 'heading'"),
        (lambda d: d["tracks"]["7"]["state"].update(heading=np.zeros(5)), "5 values, not 91"),
        (lambda d: d["tracks"]["7"].update(state=None), "not a valid scene"),
        (lambda d: d.update(map_features={}), "no lanes"),
    ],
)
def test_unusable_pickles_are_refused(described, unpickled, damage, said, capsys):
    damage(described)
    refusal = unpickled(described)
    assert isinstance(refusal, Refusal)
    assert said in refusal.reason
    assert "scene.pkl" in refusal.reason
    assert capsys.readouterr().out == ""


def test_gpudrive_is_the_same_scene_but_for_what_it_lacks(original, drive, parsed):
    scene = parsed(drive)
    assert_same_motion(scene, original)
    assert_same_lanes(scene, original)
    assert_same_signals(scene, original)
    assert (scene.tracks.ids, scene.name, scene.av_id) == (original.tracks.ids, "abc123", "12")
    assert (scene.interest, scene.to_predict) == (original.interest, original.to_predict)
    assert [one.kind for one in scene.road.lines] == [1]
    assert [one.kind for one in scene.road.edges] == [2]
    assert scene.road.lanes["100"].speed_limit_mps is None
    assert scene.repairs == ()


def test_gpudrive_v2_finds_the_av_by_its_size(drive, parsed):
    del drive["metadata"]
    scene = parsed(drive)
    assert (scene.av_id, scene.interest, scene.to_predict) == ("12", (), ())


@pytest.mark.parametrize("form", [by_hand.nocturne_v1, by_hand.nocturne_early])
def test_early_forms_have_degrees_and_no_ids(original, drive, parsed, form):
    scene = parsed(form(drive))
    assert_same_motion(scene, original, flat=True)
    assert (scene.tracks.ids, scene.av_id) == (("0", "1", "2"), "2")
    assert list(scene.road.lanes) == ["0", "1", "2"]
    assert scene.road.lanes["0"].next == ("2",)
    assert scene.road.lanes["0"].left[0].lane_id == "1"
    assert scene.name == "scene"
    assert not scene.tracks.z_m.any()


def test_signals_without_lane_ids_go_to_the_lane_at_their_stop_point(original, drive, parsed):
    early = by_hand.nocturne_v1(drive)
    early["tl_states"]["977"] = copy.deepcopy(early["tl_states"]["102"])
    scene = parsed(early)
    assert scene.signals.lane_ids == ("2",)
    assert np.array_equal(scene.signals.state, original.signals.state)
    assert "1 signals were assigned to the lanes" in scene.repairs[0]
    assert "977" in scene.repairs[1]


def test_radians_and_degrees_are_told_apart_by_motion(drive, parsed):
    for thing in drive["objects"]:
        thing["heading"] = [one if one < -100 else np.degrees(one) for one in thing["heading"]]
    heading = parsed(drive).tracks.heading_rad
    assert heading[1, 5] == pytest.approx(np.pi / 2)


def test_a_scene_at_rest_takes_the_unit_of_its_form(drive, parsed):
    for thing in drive["objects"]:
        thing["velocity"] = [{"x": 0.0, "y": 0.0}] * 91
        thing["position"] = [thing["position"][0]] * 91
    scene = parsed(drive)
    assert scene.tracks.heading_rad[1, 5] == pytest.approx(np.pi / 2)
    assert "radians" in scene.repairs[0]


def test_markers_in_valid_states_and_zero_sizes_are_mended(drive, parsed):
    drive["objects"][0]["position"][40] = {"x": -10000.0, "y": -10000.0, "z": -10000.0}
    drive["objects"][0].update(length=0.0, width=0.0)
    scene = parsed(drive)
    assert not scene.tracks.valid[0, 40]
    assert scene.tracks.size_m[0].tolist() == [4.7, 2.0, 1.7]
    assert [" ".join(one.split()[:3]) for one in scene.repairs] == [
        "1 valid states",
        "Agent 7 has",
    ]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda d: d.update(objects=[]), "maps without a recording"),
        (lambda d: d.pop("roads"), "lacks the key 'roads'"),
        (lambda d: d.update(ego_idx=3), "re-sampled"),
        (lambda d: d["objects"][2].update(length=4.0) or d.pop("metadata"), "the AV is not named"),
        (lambda d: d["metadata"].update(sdc_track_index=9), "sdc_track_index is 9"),
        (lambda d: d["objects"][0].update(heading=[0.0]), "not a valid scene"),
        (lambda d: d["roads"][1].update(id=100), "two lanes have the id 100"),
        (lambda d: d["objects"][0].update(position=None), "not a valid scene"),
    ],
)
def test_unusable_json_is_refused(drive, parsed, damage, said):
    damage(drive)
    refusal = parsed(drive)
    assert isinstance(refusal, Refusal)
    assert said in refusal.reason
    assert "scene.json" in refusal.reason


@pytest.mark.parametrize(
    "content", ['{"objects": [', '{"roads": ' + "[" * 100000, '{"objects": 3}']
)
def test_json_that_is_cut_or_nested_too_deep_is_refused(tmp_path, content):
    file = tmp_path / "cut.json"
    file.write_text(content)
    (refusal,) = read_by(gpudrive, file)
    assert isinstance(refusal, Refusal)
