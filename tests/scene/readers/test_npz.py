import dataclasses
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepmf_sumo.scene import Polygon, Polyline, RoadMap, Scene
from deepmf_sumo.scene.readers import Refusal, npz, read_by, womd
from deepmf_sumo.scene.readers.raw import repair

from tests.support import recordings_by_hand as by_hand


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    file = tmp_path_factory.mktemp("native") / "one.tfrecord"
    (scene,) = read_by(womd, by_hand.shard(file, by_hand.scenario()))
    return dataclasses.replace(scene, repairs=("Something was mended.",))


def assert_same(one, other, where="scene"):
    assert type(one) is type(other), where
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            name = field.name
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}[{key}]")
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for index, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{where}[{index}]")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        assert np.array_equal(one, other), where
        assert not other.flags.writeable, where
    else:
        assert one == other, where


def test_nothing_is_lost(scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    assert any(npz.recordings(file))
    (back,) = read_by(npz, file)
    assert_same(scene, back)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.npz"]


def test_priorities_at_crossings_are_kept(scene, tmp_path):
    """As SUMO networks tell it."""
    lane = dataclasses.replace(scene.road.lanes["100"], gives_way_to=("a", "b"))
    road = dataclasses.replace(scene.road, lanes=scene.road.lanes | {"100": lane})
    npz.write(dataclasses.replace(scene, road=road), tmp_path / "scene.npz")
    (back,) = read_by(npz, tmp_path / "scene.npz")
    assert back.road.lanes["100"].gives_way_to == ("a", "b")


@pytest.mark.parametrize("footways", [None, (), ("footway", "track")])
def test_what_is_beside_the_road_is_kept(scene, tmp_path, footways):
    """An empty list says that the map has no sidewalks, none that nobody knows."""

    def area(kind):
        return Polygon(id=kind, kind=kind, points_m=np.eye(3, 2), z_m=np.arange(3.0))

    walked = None if footways is None else tuple(map(area, footways))
    road = replace(scene.road, buildings=(area("building"),), footways=walked)
    changed = replace(scene, road=road)
    npz.write(changed, tmp_path / "scene.npz")
    (back,) = read_by(npz, tmp_path / "scene.npz")
    assert_same(changed, back)


@pytest.mark.parametrize("beside", ["buildings", "footways", "water"])
@pytest.mark.parametrize(
    ("points", "name", "told"),
    [
        (np.array([[0.0, np.nan], [1, 1], [0, 1]]), "a", "points out of range"),
        (np.array([[0.0, 1e12], [1, 1], [0, 1]]), "a", "points out of range"),
        (np.eye(3, 2), "a\0b", "characters that cannot be shown"),
    ],
)
def test_what_is_beside_the_road_is_checked(scene, tmp_path, beside, points, name, told):
    kind = {"buildings": "building", "footways": "footway", "water": "water"}[beside]
    area = Polygon(id=name, kind=kind, points_m=points, z_m=np.zeros(3))
    road = replace(scene.road, **{beside: (area,)})
    npz.write(replace(scene, road=road), tmp_path / "scene.npz")
    (found,) = read_by(npz, tmp_path / "scene.npz")
    assert isinstance(found, Refusal)
    assert told in found.reason


@pytest.mark.parametrize("beside", ["buildings", "footways", "water"])
def test_what_is_beside_the_road_counts_for_the_size_of_a_map(scene, tmp_path, monkeypatch, beside):
    road = scene.road
    known = len(road.lanes) + len(road.lines) + len(road.edges) + len(road.polygons)
    monkeypatch.setattr(repair, "MOST_FEATURES", known + len(road.stop_signs))
    area = Polygon(id="a", kind="building", points_m=np.eye(3, 2), z_m=np.zeros(3))
    for file, one in (("small.npz", road), ("large.npz", replace(road, **{beside: (area,)}))):
        npz.write(replace(scene, road=one), tmp_path / file)
    small, large = (next(read_by(npz, tmp_path / file)) for file in ("small.npz", "large.npz"))
    assert isinstance(small, Scene)
    assert "features" in large.reason


def test_maps_without_it_are_written_as_before(scene, tmp_path):
    npz.write(scene, tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as found:
        road = json.loads(found["description"].tobytes())["road"]
    assert set(road) == {"lanes", "lines", "edges", "polygons", "stop_signs"}


def test_the_same_scene_is_the_same_file(scene, tmp_path):
    npz.write(scene, tmp_path / "a.npz")
    npz.write(scene, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.slow_unit
@given(
    width=st.none() | st.floats(0.1, 10),
    limit=st.none() | st.floats(0.1, 50),
    name=st.text(min_size=1).filter(lambda text: text.isprintable()),
    interest=st.lists(st.sampled_from(["7", "9"]), unique=True),
)
@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_value_comes_back(scene, tmp_path, width, limit, name, interest):
    lane = dataclasses.replace(scene.road.lanes["100"], width_m=width, speed_limit_mps=limit)
    road = dataclasses.replace(scene.road, lanes=scene.road.lanes | {"100": lane})
    changed = dataclasses.replace(scene, name=name, interest=tuple(interest), road=road)
    npz.write(changed, tmp_path / "scene.npz")
    (back,) = read_by(npz, tmp_path / "scene.npz")
    assert_same(changed, back)


def test_another_version_is_refused(scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(file, **(arrays | {"format_version": np.array(99)}))
    (refusal,) = read_by(npz, file)
    assert "format version 99" in refusal.reason


def test_a_scene_without_lanes_is_refused(scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(dataclasses.replace(scene, road=RoadMap(lanes={})), file)
    (refusal,) = read_by(npz, file)
    assert "no lanes" in refusal.reason


@pytest.mark.parametrize("name", ["position_m", "heading_rad", "velocity_mps", "z_m"])
def test_a_number_that_is_not_finite_is_refused_where_a_road_user_is_seen(name, scene, tmp_path):
    values = getattr(scene.tracks, name).copy()
    values[0, 5] = np.nan
    tracks = dataclasses.replace(scene.tracks, **{name: values})
    npz.write(dataclasses.replace(scene, tracks=tracks), tmp_path / "scene.npz")
    (refusal,) = read_by(npz, tmp_path / "scene.npz")
    assert f"record 0: {name} of 7 at step 5 is not finite." in refusal.reason


def test_pickled_objects_are_refused(scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(file, **(arrays | {"description": np.array([{}], dtype=object)}))
    (refusal,) = read_by(npz, file)
    assert isinstance(refusal, Refusal)


@pytest.mark.slow_unit
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damage_gives_the_scene_or_a_refusal(scene, data, tmp_path_factory):
    file = tmp_path_factory.getbasetemp() / "damaged.npz"
    npz.write(scene, file)
    content = bytearray(file.read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        for _ in range(data.draw(st.integers(1, 3))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(content)
    if any(npz.recordings(file)):
        (found,) = read_by(npz, file)
        assert isinstance(found, Scene | Refusal)


def test_a_zip_bomb_is_refused_unread(scene, tmp_path, monkeypatch):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    monkeypatch.setattr(npz, "LARGEST_FILE", 1000)
    (refusal,) = read_by(npz, file)
    assert "unpacks to" in refusal.reason


def test_another_zip_is_not_accepted(tmp_path):
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("a.txt", "text")
    assert not any(npz.recordings(tmp_path / "other.zip"))


def changed(file, **changes):
    """The native file with arrays, or keys of its description, replaced."""
    with np.load(file) as stored:
        arrays = dict(stored)
    described = json.loads(arrays["description"].tobytes())
    for name, value in changes.items():
        if name in arrays:
            arrays[name] = value
        else:
            described[name] = value
    arrays["description"] = np.frombuffer(json.dumps(described).encode(), "uint8")
    np.savez(file, **arrays)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"name": True}, "'name'"),
        ({"name": "a\x1b[2J"}, "the name of the scene"),
        ({"now": "10"}, "'now'"),
        ({"now": [10]}, "'now'"),
        ({"now": 90}, "no future was recorded"),
        ({"dt_s": '"'}, "'dt_s'"),
        ({"dt_s": -2147483648}, "'dt_s'"),
        ({"dt_s": 0.2}, "'dt_s' is 0.2"),
        ({"ids": [{}, "7", "9"]}, "'ids.0'"),
        ({"ids": ["7", "7", "12"]}, "two tracks have the id 7"),
        ({"ids": ["7", "12"]}, "'kinds' has 3 items"),
        ({"kinds": ["vehicle", "tank", "vehicle"]}, "'kinds.1'"),
        ({"av_id": "none"}, "'av_id' is 'none'"),
        ({"interest": ["none"]}, "names none, which is not there"),
        ({"source": {}}, "'source.dataset'"),
        ({"signal_lane_ids": ["102", "100"]}, "array 'signals_state' has shape"),
        ({"signal_lane_ids": []}, "array 'signals_state' has shape"),
        ({"extra": 1}, "'extra'"),
        ({"tracks_valid": np.ones((3, 91, 1), bool)}, "array 'tracks_valid' has shape"),
        ({"tracks_valid": np.ones((3, 91))}, "array 'tracks_valid' contains float64"),
        (
            {"tracks_position_m": np.zeros((3, 91, 2), complex)},
            "array 'tracks_position_m' contains",
        ),
        ({"tracks_z_m": np.zeros((3, 90))}, "array 'tracks_z_m' has shape"),
        ({"timestamps_s": np.zeros((91, 1))}, "array 'timestamps_s' has shape"),
        ({"timestamps_s": np.arange(91.0)[::-1]}, "runs backwards"),
        ({"road_points_m": np.zeros((3, 2))}, "array 'road_points_m' has shape"),
        ({"signals_state": np.full((1, 91), 9, "uint8")}, "unknown state 9"),
        ({"format_version": np.array([1, 1])}, "format version"),
    ],
    ids=str,
)
def test_a_wrong_field_is_a_refusal_that_names_file_and_field(changes, field, scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    changed(file, **changes)
    (refusal,) = read_by(npz, file)
    assert isinstance(refusal, Refusal)
    assert str(file) in refusal.reason
    assert field in refusal.reason, refusal.reason


@pytest.mark.parametrize(("part", "first_unknown"), [("lines", 9), ("edges", 3)])
def test_kinds_of_lines_are_those_that_exporters_know(part, first_unknown, scene, tmp_path):
    file = tmp_path / "scene.npz"
    one = Polyline(id="l", kind=first_unknown - 1, points_m=np.eye(2), z_m=np.zeros(2))
    scene = replace(scene, road=replace(scene.road, **{part: (one,)}))
    npz.write(scene, file)
    (read,) = read_by(npz, file)
    assert read.name == scene.name
    wrong = replace(scene.road, **{part: (replace(one, kind=first_unknown),)})
    npz.write(replace(scene, road=wrong), file)
    (refusal,) = read_by(npz, file)
    assert isinstance(refusal, Refusal)
    assert "kind" in refusal.reason
    assert str(first_unknown) in refusal.reason


def test_links_to_what_is_not_there_are_refused(scene, tmp_path):
    lane = dataclasses.replace(scene.road.lanes["100"], next=("nowhere",))
    road = dataclasses.replace(scene.road, lanes=scene.road.lanes | {"100": lane})
    npz.write(dataclasses.replace(scene, road=road), tmp_path / "scene.npz")
    (refusal,) = read_by(npz, tmp_path / "scene.npz")
    assert "links to lanes" in refusal.reason


def test_an_array_that_claims_more_than_it_has_is_not_made(scene, tmp_path):
    file = tmp_path / "scene.npz"
    npz.write(scene, file)
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    told = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }"
    header = b"\x93NUMPY\x01\x00\x76\x00" + told
    members["road_z_m.npy"] = header.ljust(127) + b"\n" + bytes(80)
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    (refusal,) = read_by(npz, file)
    assert "shape (99999999999,), but has 80 bytes" in refusal.reason
