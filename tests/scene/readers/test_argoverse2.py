"""Scenarios of Argoverse 2: a folder with a table and a map."""

import json
import shutil
import sys

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import Refusal, argoverse2, read_by
from deepmf_sumo.training.samples.feature_cache import digest_of

from tests.support import argoverse_by_hand as by_hand
from tests.support import recordings_by_hand as others


def needs_pyarrow():
    pytest.importorskip("pyarrow", reason="pyarrow reads tables of Argoverse 2; not installed here")


@pytest.fixture
def folder(tmp_path):
    needs_pyarrow()
    return by_hand.scenario(tmp_path / "abc")


def only(folder):
    (found,) = read_by(argoverse2, folder)
    return found


def said(folder):
    found = only(folder)
    assert isinstance(found, Refusal), found.repairs
    return found.reason


def row(scene, agent):
    return scene.tracks.row(agent)


def test_the_scene_is_the_last_91_steps_as_pandas_reads_them(folder):
    import pandas as pd

    scene = only(folder)
    assert (scene.name, scene.now, scene.tracks.steps, scene.av_id) == ("abc", 10, 91, "AV")
    assert scene.source.dataset == "argoverse2"
    assert scene.timestamps_s == pytest.approx(0.1 * np.arange(91), abs=1e-6)
    table = pd.read_parquet(folder / "scenario_abc.parquet")
    later = table[table.timestep >= 19]
    assert scene.tracks.valid.sum() == len(later)
    for one in later.itertuples():
        at = row(scene, one.track_id), one.timestep - 19
        assert scene.tracks.position_m[at].tolist() == [one.position_x, one.position_y]
        assert scene.tracks.velocity_mps[at].tolist() == [one.velocity_x, one.velocity_y]
        assert scene.tracks.heading_rad[at] == pytest.approx(one.heading)
    assert "The first 19 of 110 steps were left out; a scene has 91." in scene.repairs


def test_kinds_sizes_and_targets(folder):
    scene = only(folder)
    kinds = dict(zip(scene.tracks.ids, scene.tracks.kinds, strict=True))
    assert kinds == {
        "7": "vehicle", "8": "cyclist", "9": "pedestrian", "10": "vehicle", "11": "vehicle",
        "12": "other", "AV": "vehicle",
    }  # fmt: skip
    length = dict(zip(scene.tracks.ids, scene.tracks.size_m[:, 0], strict=True))
    assert length == {
        "7": 4.7, "8": 1.8, "9": 0.9, "10": 12.0, "11": 2.2, "12": 1.0, "AV": 4.9,
    }  # fmt: skip
    assert scene.to_predict == ("7", "8", "11")  # the focal track first
    assert any("those typical of their types" in one for one in scene.repairs)


def test_road_users_stand_on_the_road(folder):
    scene = only(folder)
    for agent in ("7", "11", "AV"):
        at = row(scene, agent)
        valid = scene.tracks.valid[at] & (scene.tracks.position_m[at, :, 0] < 100)
        x = scene.tracks.position_m[at, valid, 0]
        # points of lanes are at most 1 m apart
        assert scene.tracks.z_m[at, valid] == pytest.approx(by_hand.ground_m(x), abs=0.011)


def test_lanes_lie_between_their_boundaries(folder):
    lanes = only(folder).road.lanes
    assert lanes["100"].centre_m[:, 1] == pytest.approx(0.0)
    assert lanes["100"].centre_m[[0, -1], 0].tolist() == [0.0, 100.0]
    assert np.diff(lanes["100"].centre_m[:, 0]).max() <= 1.0
    assert lanes["100"].z_m == pytest.approx(by_hand.ground_m(lanes["100"].centre_m[:, 0]))
    assert (lanes["100"].width_m, lanes["104"].width_m) == (3.5, 2.5)
    assert (lanes["100"].kind, lanes["104"].kind) == ("street", "bike")
    assert (lanes["100"].interpolating, lanes["102"].interpolating) == (False, True)
    assert lanes["100"].speed_limit_mps is None
    assert lanes["103"].centre_m[[0, -1], 0].tolist() == [100.0, 0.0]


def test_a_centre_line_of_the_map_is_taken_with_the_heights_of_the_boundaries(folder):
    lane = only(folder).road.lanes["102"]
    assert lane.centre_m.tolist() == [[100.0, 0.1], [150.0, 0.1]]
    assert lane.z_m.tolist() == [22.0, 23.0]


def test_links_of_lanes(folder):
    scene = only(folder)
    lanes = scene.road.lanes
    assert (lanes["100"].next, lanes["102"].previous) == (("102",), ("100",))
    assert any("lane 100 to 99" in one for one in scene.repairs)  # outside of the map
    (left,), (right,) = lanes["100"].left, lanes["101"].right
    assert (left.lane_id, right.lane_id) == ("101", "100")
    assert (left.self_start, left.other_start) == (0, 0)
    assert left.self_end == len(lanes["100"].centre_m) - 1
    assert left.other_end == len(lanes["101"].centre_m) - 1
    # what leads the other way, or is for others, is no neighbour to change lanes to
    assert lanes["101"].left == lanes["103"].left == lanes["104"].left == lanes["100"].right == ()
    assert "2 neighbours that lead the other way were left out." in scene.repairs


def test_marks_crossings_and_the_drivable_area(folder):
    road = only(folder).road
    assert [(line.kind, line.points_m[0].tolist()) for line in road.lines] == [
        (1, [0.0, 1.75]),
        (7, [0.0, 5.25]),
    ]
    (shared,), (double,) = road.lanes["100"].left_boundaries, road.lanes["101"].left_boundaries
    assert (shared.kind, double.kind) == (1, 7)
    assert road.lanes["101"].right_boundaries[0].feature_id == shared.feature_id
    (crossing,) = road.polygons
    assert crossing.points_m.tolist() == [[60, -2], [60, 9], [63, 9], [63, -2]]
    (edge,) = road.edges
    assert edge.points_m[0].tolist() == edge.points_m[-1].tolist()
    assert only(folder).signals.lane_ids == ()


def test_a_line_that_is_written_twice_is_one_in_either_direction(tmp_path):
    needs_pyarrow()
    lanes = by_hand.road()["lane_segments"]
    lanes["103"]["left_lane_boundary"] = lanes["101"]["left_lane_boundary"][::-1]
    lanes["103"]["left_lane_mark_type"] = "DOUBLE_SOLID_YELLOW"
    road = only(by_hand.scenario(tmp_path / "abc", lane_segments=lanes)).road
    assert len(road.lines) == 2
    assert road.lanes["103"].left_boundaries[0].feature_id == "101 left"


def test_the_test_split_has_what_it_has(tmp_path):
    needs_pyarrow()
    scene = only(by_hand.scenario(tmp_path / "abc", steps=50))
    assert (scene.now, scene.tracks.steps) == (10, 50)
    assert scene.tracks.position_m[row(scene, "AV"), 0].tolist() == [0.0, 0.0]
    assert "It has 50 steps; nothing is known of the 41 after them." in scene.repairs


def test_types_that_are_new_are_other_road_users(tmp_path):
    needs_pyarrow()
    new = by_hand.track("20", "scooter", 0, (9, 9), (1, 0), range(110))
    scene = only(by_hand.scenario(tmp_path / "abc", tracks=[*by_hand.usual(), new]))
    assert scene.tracks.kinds[row(scene, "20")] == "other"
    assert "Road users of unknown types were read as 'other': scooter." in scene.repairs


def without(column):
    def change(folder):
        import pandas as pd

        file = folder / "scenario_abc.parquet"
        pd.read_parquet(file).drop(columns=column).to_parquet(file)

    return change


def with_value(column, value):
    def change(folder):
        import pandas as pd

        file = folder / "scenario_abc.parquet"
        table = pd.read_parquet(file)
        table.loc[5, column] = value
        table.to_parquet(file)

    return change


def in_file(name, content):
    return lambda folder: (folder / name).write_bytes(content)


def in_lane(key, value):
    def change(folder):
        described = by_hand.road()
        described["lane_segments"]["100"][key] = value
        by_hand.write_map(folder, "abc", described)

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (without("heading"), "scenario_abc.parquet is incomplete: it lacks 'heading'"),
        (without("object_category"), "lacks 'object_category'"),
        (with_value("timestep", 110), "'timestep' is not below 'num_timestamps', which is 110"),
        (with_value("timestep", -1), "'timestep' is not below"),
        (in_file("scenario_abc.parquet", b"PAR1 cut off"), "the table cannot be read"),
        (in_file("log_map_archive_abc.json", b"{"), "abc.json is no part of a valid scenario"),
        (
            in_file("log_map_archive_abc.json", b"{}"),
            "json is incomplete: it lacks 'lane_segments'",
        ),
        (lambda folder: (folder / "log_map_archive_abc.json").unlink(), "abc.json cannot be read"),
        (in_lane("left_lane_boundary", []), "lane 100 has a boundary of less than two points"),
        (in_lane("left_lane_boundary", [{"x": 1}] * 2), "lacks 'y'"),
        (in_lane("successors", [["a"]]), "an id is neither text nor a number"),
        (in_lane("right_lane_boundary", by_hand.line(0, 1e7, 0, 0)), "a lane is 1e+07 m long"),
    ],
)
def test_what_is_damaged_is_refused_with_the_file(folder, change, reason):
    change(folder)
    found = said(folder)
    assert reason in found
    assert str(folder) in found


def test_a_scenario_without_the_av_is_refused(tmp_path):
    needs_pyarrow()
    folder = by_hand.scenario(tmp_path / "abc", tracks=by_hand.usual()[:-1])
    assert "the AV is 'AV', but there is no such track" in said(folder)


@pytest.mark.sumo
def test_folders_of_scenarios_beside_other_recordings(tmp_path):
    needs_pyarrow()
    data = tmp_path / "data"
    for name in ("one", "two"):
        by_hand.scenario(data / "val" / name, name=name)
    others.shard(data / "a.tfrecord", others.scenario(name="x"))
    (data / "val" / "one" / "notes.json").write_text('{"tracks": 1}')
    assert [root.name for root in readers.find([data])] == ["a.tfrecord", "one", "two"]
    assert readers.ids(data, tmp_path / "cache") == ["x", "one", "two"]
    assert [scene.name for scene in readers.scenes([data])] == ["x", "one", "two"]
    refs = list(readers.records(data, tmp_path / "cache"))
    assert (refs[2].file, refs[2].reader) == (data / "val" / "two", "argoverse2")
    assert readers.read(refs[2]).name == "two"


@pytest.mark.sumo
def test_scenarios_in_one_folder_and_a_table_alone(tmp_path):
    needs_pyarrow()
    for name in ("one", "two"):
        by_hand.scenario(tmp_path / "both", name=name)
    assert readers.ids(tmp_path / "both") == ["one", "two"]
    assert readers.scene(tmp_path / "both", "two").source.record == 1
    table = tmp_path / "both" / "scenario_two.parquet"
    assert [scene.name for scene in readers.scenes([table])] == ["two"]
    for _ in range(2):  # listed, and then from the index
        (ref,) = readers.records(table, tmp_path / "cache")
        assert readers.read(ref).name == "two"


def test_a_change_of_the_map_is_another_data_set(folder):
    before = digest_of("opponent", "", folder)
    moved = shutil.copytree(folder, folder.parent / "elsewhere" / folder.name)
    assert digest_of("opponent", "", moved) == before
    described = json.loads((folder / "log_map_archive_abc.json").read_text())
    described["lane_segments"]["100"]["is_intersection"] = True
    by_hand.write_map(folder, "abc", described)
    assert digest_of("opponent", "", folder) != before
    assert only(folder).source.sha256 != only(moved).source.sha256


def test_without_pyarrow_it_is_said_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "scenario_abc.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r'need pyarrow, .*pip install "deepmf-sumo\[argoverse\]"'):
        readers.scenes([tmp_path])


@pytest.mark.sumo
def test_a_scenario_is_converted_and_attacked(tmp_path):
    needs_pyarrow()
    import deepmf_sumo

    by_hand.scenario(tmp_path / "abc")
    # The motorcyclist brakes and moves over to the lane of the AV, which goes on at 10 m/s.
    times = 0.1 * np.arange(1, 81)
    x = 30.0 + 2.9 * 12.0 + 12.0 * times - 2.0 * np.minimum(times, 3.0) ** 2
    x[times > 3.0] = x[times <= 3.0][-1]
    y = 3.5 - 3.5 * np.minimum(times / 3.0, 1.0)
    poses = [[float(one), float(other), 0.0] for one, other in zip(x, y, strict=True)]
    (tmp_path / "spec.yaml").write_text(
        "version: 3\nname: av2\nsource: {recording: abc}\nplanner: constant_velocity\n"
        f"traffic: log\nadversary: {{name: trajectory, agent: '11', poses: {poses}}}\n"
    )
    (run,) = deepmf_sumo.run([tmp_path / "spec.yaml"], out=tmp_path / "out").runs
    assert (run.row["status"], run.row["scene"], run.outcome) == ("ok", "abc", "av_opponent")
    assert run.contact.step - run.rollout.now == pytest.approx(50, abs=3)  # by hand: 4.97 s
